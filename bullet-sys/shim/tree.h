// What stands behind a tree, see multi_body.h. C++ only.
//
// A tree lies over its bodies: each keeps its btRigidBody, which is out of the world and mirrors its link. Who reads a body reads the
// mirror, and who writes to it leaves there what the tree takes up before its next sub-step. Dynamics are TreeDynamics'; Bullet's
// multi-body shares in what the links do to others: contacts, constraints, motors and limits.
#ifndef AMB_TREE_H
#define AMB_TREE_H

#include "internal.h"
#include "tree_dynamics.h"

#include <BulletDynamics/Featherstone/btMultiBody.h>
#include <BulletDynamics/Featherstone/btMultiBodyDynamicsWorld.h>
#include <BulletDynamics/Featherstone/btMultiBodyLinkCollider.h>

class JointRows;

// What of a link collides.
struct LinkCollider : btMultiBodyLinkCollider {
  LinkCollider(AmbBody &owner, btMultiBody *multi_body, int link);

  bool checkCollideWithOverride(const btCollisionObject *other) const override;

  // Held by a joint that disables collisions.
  std::vector<const AmbObject *> parted;
};

struct AmbTree {
  struct Member {
    AmbBody *body;
    // To the parent; null for the base.
    AmbConstraint *joint;
    // Null for a fixed base.
    std::unique_ptr<LinkCollider> collider;
  };

  AmbTree(AmbWorld &owner, AmbBody &base, AmbConstraint *const *joints, int n);
  ~AmbTree();

  // Takes up poses and velocities that were set on bodies.
  void settle();
  // Motion over the next sub-step without what rows do.
  void predict(btScalar h);
  // Brings Bullet's multi-body up to date, so that rows can be made.
  void prepare_rows();
  void integrate(btScalar h);
  void clear_forces();

  // Position of a hinge or slider; 0 of others.
  btScalar coordinate(const AmbConstraint &joint);

  AmbWorld &world;
  TreeDynamics dynamics;
  std::vector<Member> members;
  std::unique_ptr<btMultiBody> multi_body;
  std::unique_ptr<JointRows> joint_rows;
  TreeDynamics::Position position;
  TreeDynamics::Rate rate;
  // Where it gets without rows.
  TreeDynamics::Position free_position;
  TreeDynamics::Rate free_rate;
  bool poses_set = false;
  bool velocities_set = false;
  // A contact or a constraint from outside holds it in this sub-step.
  bool touched = false;
  bool has_rows = false;
  int ties = 0;

 private:
  void follow_base();
  void write_mirrors();
  bool was_pushed() const;
  void remember_momenta();
  void write_feedback(btScalar h);

  btTransform base_pose;
  bool has_feedback = false;
  std::vector<btVector3> momenta, angular_momenta, velocities, angular_velocities;
  btAlignedObjectArray<btQuaternion> scratch_q;
  btAlignedObjectArray<btScalar> scratch_r;
  btAlignedObjectArray<btVector3> scratch_v;
  btAlignedObjectArray<btMatrix3x3> scratch_m;
};

// A world with trees.
class TreeWorld : public Lean<btMultiBodyDynamicsWorld> {
 public:
  TreeWorld(MotionClock &clock, btDispatcher *dispatcher, btBroadphaseInterface *broadphase,
            btMultiBodyConstraintSolver *solver, btCollisionConfiguration *configuration);

  void applyGravity() override;
  void clearForces() override;
  void predictUnconstraintMotion(btScalar h) override;
  void solveExternalForces(btContactSolverInfo &info) override;
  void integrateTransforms(btScalar h) override;

  std::vector<AmbTree *> trees;
  // Constraints that hold a link and are none of its tree.
  std::vector<AmbConstraint *> ties;
};

inline AmbBody &first_of(const AmbConstraint &c) { return *body_of(&c.constraint->getRigidBodyA()); }
inline AmbBody &second_of(const AmbConstraint &c) { return *body_of(&c.constraint->getRigidBodyB()); }

// Whether a constraint has to be a tie: one of its bodies is a link.
bool holds_link(const AmbConstraint &constraint);
void add_tie(AmbWorld &world, AmbConstraint &constraint);
void remove_tie(AmbWorld &world, AmbConstraint &constraint);

#endif

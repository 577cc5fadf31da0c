// Implementation of articulations, see articulate.h. C++ only.
//
// Each link keeps its btRigidBody as a proxy outside the world: getters read the proxy; setters write it and mark the
// articulation, and `apply_set_state` maps the poses and velocities of the proxies to generalised coordinates before
// the next sub-step. How it moves is in Rust, see articulation_tree.h; a btMultiBody represents the articulation in Bullet's
// solver, islands and colliders only.
#ifndef AMB_ARTICULATION_H
#define AMB_ARTICULATION_H

#include "engine.h"
#include "articulation_tree.h"

#include <BulletDynamics/Featherstone/btMultiBody.h>
#include <BulletDynamics/Featherstone/btMultiBodyDynamicsWorld.h>
#include <BulletDynamics/Featherstone/btMultiBodyLinkCollider.h>

class JointRows;
class LinkDrive;

// The collision object of a link.
struct LinkCollider : btMultiBodyLinkCollider {
  LinkCollider(AmbBody &owner, btMultiBody *multi_body, int link);
  // Friction and restitution of the body.
  void copy_surface(const AmbBody &owner);
};

struct AmbArticulation {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  struct Member {
    AmbBody *body;
    // The joint between the member and its parent; null for the base.
    AmbConstraint *joint;
    // Null for a fixed base.
    std::unique_ptr<LinkCollider> collider;
    // Created when the link is first driven.
    std::shared_ptr<LinkDrive> drive;
  };

  // A spring that acts on the coordinate of a joint, or that is the joint itself, or the damping of a joint.
  struct Spring {
    AmbConstraint *constraint;
    size_t link;
  };

  AmbArticulation(AmbWorld &owner, AmbBody &base, AmbConstraint *const *joints, int n, AmbConstraint *const *springs,
                  int n_springs);
  ~AmbArticulation();

  // Projects poses and velocities that were set on the bodies onto the generalised coordinates.
  void apply_set_state();
  // Computes the motion over the next sub-step of h s without constraint rows, and the rows of the joints.
  void move_freely(btScalar h);
  // Prepares the creation of rows: poses are those at the beginning of the sub-step, velocities those of the free
  // motion.
  void prepare_rows(btScalar h);
  void finish(btScalar h);
  void clear_forces();
  // Takes over the mass, moments, damping and surface of a link.
  void body_changed(const AmbBody &body);
  // Takes over the damping of a joint; whether there is place for it.
  bool damping_changed(const AmbConstraint &joint);

  // Coordinate of a hinge, slider or spring, rad or m, and its rate; 0 for other joints.
  btScalar coordinate(const AmbConstraint &joint, btScalar *speed = nullptr);
  // The drive of a link, which is created if it has none.
  LinkDrive &drive_of(AmbBody &link);
  // For the energy ledger, when it is started.
  MechanicalEnergy energy() const;
  void note_energy();

  AmbWorld &world;
  const bool has_fixed_base;
  Tree *tree = nullptr;
  Vector<Member> members;
  // In the order of those of the tree.
  Vector<Spring> springs;
  // In the order of the couplings of the tree.
  Vector<AmbCoupling *> couplings;
  std::unique_ptr<btMultiBody> multi_body;
  std::unique_ptr<JointRows> joint_rows;
  bool poses_set = false;
  bool velocities_set = false;
  // A link has contacts in this sub-step.
  bool has_contact = false;
  int external_constraint_count = 0;

 private:
  void make_tree(AmbConstraint *const *joints, int n, int n_parallel);
  void add_spring(AmbConstraint &constraint, size_t link, bool is_joint);
  void add_damper(AmbConstraint &joint, size_t link);
  void remember_coordinates();
  void close_couplings();
  void follow_base();
  void take_base_pose();
  void write_proxies();
  void give_joints(btScalar h);
  bool is_driven() const;
  void write_feedback();
  void write_wrench(const AmbConstraint &constraint, size_t member, const Tree::Wrench &wrench, const btVector3 &arm);

  // Memory of the tree.
  void *blocks = nullptr;
  btTransform base_pose;
  bool has_feedback = false;
  // A joint has limits of more than one coordinate.
  bool has_wide_limits = false;
};

// A world with articulations.
class ArticulatedWorld : public LazyWorld<btMultiBodyDynamicsWorld> {
 public:
  ArticulatedWorld(MotionClock &clock, btDispatcher *dispatcher, btBroadphaseInterface *broadphase,
                   btMultiBodyConstraintSolver *solver, btCollisionConfiguration *configuration);

  void addMultiBody(btMultiBody *body, int group = btBroadphaseProxy::DefaultFilter,
                    int mask = btBroadphaseProxy::AllFilter) override;
  void removeMultiBody(btMultiBody *body) override;
  void addMultiBodyConstraint(btMultiBodyConstraint *constraint) override;
  void removeMultiBodyConstraint(btMultiBodyConstraint *constraint) override;
  void applyGravity() override;
  void clearForces() override;
  void predictUnconstraintMotion(btScalar h) override;
  // Islands are found after the free motion, and only where there is something to solve.
  void calculateSimulationIslands() override {}
  void solveConstraints(btContactSolverInfo &info) override;
  void integrateTransforms(btScalar h) override;
  // See amb_world_restore_order.
  void restore_order(AmbConstraint *const *constraints, int n, const Vector<AmbCoupling *> &couplings);

  Vector<AmbArticulation *> articulations;
  // Constraints on links that are not joints of the link's articulation.
  Vector<AmbConstraint *> external_constraints;

 private:
  void move_freely(btContactSolverInfo &info);
  bool is_solved() const;

  Places multi_body_places, multi_body_constraint_places;
};

// Coordinate of a spring about (rad, sign as of a hinge) or along (m) z of its frames, from the present poses.
btScalar spring_coordinate(AmbConstraint &spring);

// Whether rotation about z, or translation along z, of a spring's frames is not locked.
inline bool moves_about_z(AmbConstraint &c) {
  const auto &axis = *c.as<btGeneric6DofSpring2Constraint>().getRotationalLimitMotor(2);
  return axis.m_loLimit != axis.m_hiLimit;
}
inline bool moves_along_z(AmbConstraint &c) {
  const auto &axes = *c.as<btGeneric6DofSpring2Constraint>().getTranslationalLimitMotor();
  return axes.m_lowerLimit.z() != axes.m_upperLimit.z();
}

inline AmbBody &first_of(const AmbConstraint &c) { return *body_of(&c.constraint->getRigidBodyA()); }
inline AmbBody &second_of(const AmbConstraint &c) { return *body_of(&c.constraint->getRigidBodyB()); }

// Whether one of the bodies of a constraint is a link, so that the constraint must be an external constraint.
bool acts_on_link(const AmbConstraint &constraint);
void add_external_constraint(AmbWorld &world, AmbConstraint &constraint);
void remove_external_constraint(AmbWorld &world, AmbConstraint &constraint);

#endif

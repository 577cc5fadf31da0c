// What stands behind a tree, see multi_body.h. C++ only.
//
// A tree lies over its bodies: each keeps its btRigidBody, which is out of the world and mirrors its link. Who reads a body reads the
// mirror, and who writes to it leaves there what the tree takes up before its next sub-step. Kinematics and dynamics are ArticulationDynamics'; Bullet's
// multi-body stands for the articulation in Bullet's solver, islands and colliders.
#ifndef AMB_ARTICULATION_H
#define AMB_ARTICULATION_H

#include "engine.h"
#include "articulation_dynamics.h"

#include <BulletDynamics/Featherstone/btMultiBody.h>
#include <BulletDynamics/Featherstone/btMultiBodyDynamicsWorld.h>
#include <BulletDynamics/Featherstone/btMultiBodyLinkCollider.h>

class JointRows;
class LinkDrive;

// What of a link collides.
struct LinkCollider : btMultiBodyLinkCollider {
  LinkCollider(AmbBody &owner, btMultiBody *multi_body, int link);

  bool checkCollideWithOverride(const btCollisionObject *other) const override;

  // Held by a joint that disables collisions.
  Vector<const AmbObject *> ignored;
};

struct AmbArticulation {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  struct Member {
    AmbBody *body;
    // To the parent; null for the base.
    AmbConstraint *joint;
    // Null for a fixed base.
    std::unique_ptr<LinkCollider> collider;
    // Made when it is first needed.
    std::shared_ptr<LinkDrive> drive;
  };

  // A spring beside a joint, or in it: then it is the joint.
  struct Spring {
    AmbConstraint *constraint;
    size_t link;
    // Of the coordinate.
    btScalar low, high;
  };

  AmbArticulation(AmbWorld &owner, AmbBody &base, AmbConstraint *const *joints, int n, AmbConstraint *const *springs,
          int n_springs);
  ~AmbArticulation();

  // Takes up poses and velocities that were set on bodies.
  void apply_set_state();
  // Motion over the next sub-step without what rows do.
  void integrate_free_motion(btScalar h);
  // Makes rows possible: bodies are placed where they are and move as without rows.
  void prepare_rows();
  void integrate(btScalar h);
  void clear_forces();

  // Position of a hinge, slider or spring, and its rate; 0 of others.
  btScalar coordinate(const AmbConstraint &joint, btScalar *speed = nullptr);
  // What drives a member; made if it has none.
  LinkDrive &drive_of(AmbBody &link);

  AmbWorld &world;
  ArticulationDynamics dynamics;
  Vector<Member> members;
  // In the order of those of the dynamics.
  Vector<Spring> springs;
  std::unique_ptr<btMultiBody> multi_body;
  std::unique_ptr<JointRows> joint_rows;
  ArticulationDynamics::Position position;
  ArticulationDynamics::Rate rate;
  // Where it gets without rows.
  ArticulationDynamics::Position free_position;
  ArticulationDynamics::Rate free_rate;
  // Kinetic energy of that motion, J.
  btScalar free_energy = 0;
  // Moves the articulation in this sub-step only, beside its rates.
  ArticulationDynamics::Rate correction;
  bool is_corrected = false;
  // What rows did in this sub-step.
  ArticulationDynamics::Rate change;
  bool poses_set = false;
  bool velocities_set = false;
  // A contact or a constraint from outside holds it in this sub-step.
  bool has_contact = false;
  bool has_rows = false;
  int external_constraint_count = 0;
  // For the energy ledger, which calls it when it is switched on: present energy, and time by which poses are ahead of velocities, s.
  void note_energy();
  MechanicalEnergy energy;
  btScalar pose_lead = 0;

 private:
  MechanicalEnergy energy_at_lead(btScalar by) const;
  void begin_account();
  void book_correction(btScalar h);
  void end_account(btScalar h, bool is_straight);
  void add_spring(AmbConstraint &constraint, size_t link, bool is_joint);
  void choose_springs(btScalar h);
  void follow_base();
  void write_proxies();
  bool had_impulses() const;
  bool is_driven() const;
  void limit_energy(btScalar most, const ArticulationDynamics::Momentum &momentum, const btVector3 &about);
  void remember_momenta();
  void write_feedback(btScalar h);
  void write_wrench(const AmbConstraint &constraint, size_t member, const btVector3 &force, const btVector3 &torque,
                    const btVector3 &arm);
  btScalar spring_effort(size_t index, btScalar h) const;

  // State at the beginning of the sub-step, if the ledger is on.
  struct Start {
    ArticulationDynamics::Position position;
    ArticulationDynamics::Rate rate;
    Vector<btVector3> origins, linear, angular;
    // Power of the damping of rotations, W.
    btScalar drag = 0;
    // Elastic energy that corrections gave springs whose damping follows from their rows, J.
    btScalar corrected = 0;
  };

  Start start;
  btTransform base_pose;
  bool has_feedback = false;
  Vector<btVector3> momenta, angular_momenta, velocities, angular_velocities;
};

// A world with trees.
class ArticulatedWorld : public LazyWorld<btMultiBodyDynamicsWorld> {
 public:
  ArticulatedWorld(MotionClock &clock, btDispatcher *dispatcher, btBroadphaseInterface *broadphase,
            btMultiBodyConstraintSolver *solver, btCollisionConfiguration *configuration);

  void applyGravity() override;
  void clearForces() override;
  void predictUnconstraintMotion(btScalar h) override;
  void solveExternalForces(btContactSolverInfo &info) override;
  void integrateTransforms(btScalar h) override;

  Vector<AmbArticulation *> articulations;
  // Constraints that hold a link and are none of its tree.
  Vector<AmbConstraint *> external_constraints;
};

// Coordinate of a spring about or along z of its frames, from the present poses: positive as for a hinge.
btScalar spring_coordinate(AmbConstraint &spring);

// Of such a spring: whether z of the frames is free to turn, or to move along. Locked otherwise.
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

// Whether a constraint has to be a tie: one of its bodies is a link.
bool acts_on_link(const AmbConstraint &constraint);
void add_external_constraint(AmbWorld &world, AmbConstraint &constraint);
void remove_external_constraint(AmbWorld &world, AmbConstraint &constraint);

#endif

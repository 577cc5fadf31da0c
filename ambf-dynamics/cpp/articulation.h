// Implementation of articulations, see articulate.h. C++ only.
//
// Each link keeps its btRigidBody as a proxy outside the world: getters read the proxy; setters write it and mark the
// articulation, and `apply_set_state` maps the poses and velocities of the proxies to generalised coordinates before
// the next sub-step. Kinematics and dynamics are computed by ArticulationDynamics; a btMultiBody represents the
// articulation in Bullet's solver, islands and colliders only.
#ifndef AMB_ARTICULATION_H
#define AMB_ARTICULATION_H

#include "engine.h"
#include "articulation_dynamics.h"

#include <array>

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
    // Limits of the joint coordinate by the spring's own limits, rad or m; low > high: none.
    btScalar low, high;
  };

  AmbArticulation(AmbWorld &owner, AmbBody &base, AmbConstraint *const *joints, int n, AmbConstraint *const *springs,
                  int n_springs);
  ~AmbArticulation();

  // Projects poses and velocities that were set on the bodies onto the generalised coordinates.
  void apply_set_state();
  // Computes the motion over the next sub-step of h s without constraint rows, and the rows of the joints.
  void integrate_free_motion(btScalar h);
  // Prepares the creation of rows: poses are those at the beginning of the sub-step, velocities those of the free
  // motion.
  void prepare_rows(btScalar h);
  void integrate(btScalar h);
  void clear_forces();
  // Takes over the mass, moments, damping and surface of a link.
  void body_changed(const AmbBody &body);
  // Takes over the damping of a joint; whether there is place for it.
  bool damping_changed(const AmbConstraint &joint);

  // Coordinate of a hinge, slider or spring, rad or m, and its rate; 0 for other joints.
  btScalar coordinate(const AmbConstraint &joint, btScalar *speed = nullptr);
  // The drive of a link, which is created if it has none.
  LinkDrive &drive_of(AmbBody &link);

  AmbWorld &world;
  ArticulationDynamics dynamics;
  Vector<Member> members;
  // In the order of dynamics.springs.
  Vector<Spring> springs;
  // In the order of the couplings of `dynamics`.
  Vector<AmbCoupling *> couplings;
  std::unique_ptr<btMultiBody> multi_body;
  std::unique_ptr<JointRows> joint_rows;
  ArticulationDynamics::Position position;
  ArticulationDynamics::Rate rate;
  // State at the end of the sub-step without constraint rows.
  ArticulationDynamics::Position free_position;
  ArticulationDynamics::Rate free_rate;
  // Kinetic energy of that motion, J, and its internal energy at the end and, with the same rates, at the beginning of
  // the sub-step.
  btScalar free_energy = 0, free_internal_energy = 0, unsolved_energy = 0;
  // Velocity of a free base with which rows act at the beginning of the sub-step, m/s: that of `free_rate`, such that the
  // linear momentum is that after the free motion.
  btVector3 row_velocity{0, 0, 0};
  // Rates with which rows act: those of the free motion without what the fed-forward impulses of limits changed, `fed`.
  ArticulationDynamics::Rate row_rate, fed;
  bool is_fed = false;
  // Whether the free motion of this sub-step is along the tangent.
  bool is_tangential = false;
  // Pseudo-velocity of the position correction: moves the articulation in this sub-step and does not change its rates.
  ArticulationDynamics::Rate correction;
  bool is_corrected = false;
  // Change of the rates by the constraint impulses of this sub-step.
  ArticulationDynamics::Rate change;
  // See `unexplained_energy`; velocities as ArticulationDynamics::coordinates_of.
  ArticulationDynamics::Rate mean_rate;
  Vector<btScalar> mean_velocity, changed_velocity;
  bool poses_set = false;
  bool velocities_set = false;
  // A link has contacts in this sub-step.
  bool has_contact = false;
  bool has_rows = false;
  int external_constraint_count = 0;
  // For the energy ledger, which calls note_energy when it is enabled: energy after the last sub-step, and time by
  // which the poses are ahead of the velocities, s.
  void note_energy();
  MechanicalEnergy energy;
  btScalar pose_lead = 0;

 private:
  MechanicalEnergy energy_at_lead(btScalar by) const;
  void begin_account();
  void book_correction(btScalar h);
  void end_account(btScalar h, bool is_straight);
  void add_spring(AmbConstraint &constraint, size_t link, bool is_joint);
  void add_damper(AmbConstraint &joint, size_t link);
  void take_couplings();
  void remember_coordinates();
  void close_couplings();
  void choose_springs(btScalar h);
  void follow_base();
  void take_base_velocity();
  void write_proxies();
  void return_to_limits(btScalar h);
  bool had_impulses() const;
  bool is_driven() const;
  // What a sub-step with rows leaves to be restored at the new position: the momentum of a free base about the mass
  // centre, and the largest internal energy, J; and whether the impulses act from the beginning of the sub-step.
  struct RowMotion {
    ArticulationDynamics::Momentum momentum;
    btScalar energy_limit = BT_LARGE_FLOAT;
    bool is_straight = false;
  };
  RowMotion move_by_rows(btScalar h);
  btScalar energy_limit_of_rows(btScalar solved, btScalar turn, bool is_straight) const;
  void advance_by_rows(btScalar h, btScalar followed, bool is_straight);
  void limit_energy(btScalar most, const ArticulationDynamics::Momentum &momentum);
  btScalar unexplained_energy(btScalar h);
  void remember_momenta();
  void write_feedback(btScalar h);
  void write_wrench(const AmbConstraint &constraint, size_t member, const btVector3 &force, const btVector3 &torque,
                    const btVector3 &arm);
  btScalar spring_effort(size_t index, btScalar h) const;

  // State at the beginning of the sub-step, if the energy ledger is enabled.
  struct Start {
    ArticulationDynamics::Position position;
    ArticulationDynamics::Rate rate;
    Vector<btVector3> origins, linear, angular;
    // Power of the angular damping, W.
    btScalar drag = 0;
    // Change by position corrections of the elastic energy of stiff springs, whose damping work is computed from their
    // rows, J.
    btScalar corrected = 0;
  };

  Start start;
  btTransform base_pose;
  bool has_feedback = false;
  // A joint has limits of more than one coordinate.
  bool has_wide_limits = false;
  Vector<btVector3> momenta, angular_momenta, velocities, angular_velocities;
  // Linear and angular quantities of the links while they are computed; members so that nothing is allocated in a step.
  std::array<Vector<btVector3>, 2> per_link;
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

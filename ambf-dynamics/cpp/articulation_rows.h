// Constraint rows of articulations. C++ only.
#ifndef AMB_ARTICULATION_ROWS_H
#define AMB_ARTICULATION_ROWS_H

#include "articulation.h"

#include "articulation_solver.h"

// Limits, motors, stiff springs and dampers, dry friction and largest rates of all joints of an articulation.
//
// The forces of motors and stiff springs in the last sub-step are fed forward as generalised forces in the free motion
// over the next one, and their rows solve for the change only (second order in h). An impulse alone would act at the
// position at the beginning of the sub-step, after a free motion as if no motor held the articulation.
class JointRows : public EngineRows {
 public:
  explicit JointRows(AmbArticulation &articulation);

  // Plan the rows of the next sub-step of h s: first motors and stiff springs, whose fed-forward forces are added to
  // the dynamics, and after the free motion under these forces the limits.
  void plan_motors(btScalar h);
  void plan_limits(btScalar h);
  // Instead of both, where nothing else acts on the articulation: hands motors, stiff springs and limits to its equations of
  // motion, and keeps what they did in the sub-step. There are no rows then.
  void plan_drives(btScalar h);
  void take_drives();
  bool is_geometric(int row) const override { return planned[row].source == LIMIT; }
  bool is_spring(int row) const override {
    return planned[row].source >= articulation.dynamics.coordinates && planned[row].source < friction_of(0);
  }
  btScalar bias(int row) const override { return planned[row].target; }
  btScalar guess(int row) const override { return planned[row].guess; }
  btScalar fed(int row) const override { return planned[row].feedforward; }
  bool is_angular(int row) const override { return planned[row].is_angle; }
  WorkKind work_kind(int row) const override {
    const int source = planned[row].source;
    return source < 0                                   ? WorkKind::Limit
           : source < articulation.dynamics.coordinates || source >= rotor_of(0) ? WorkKind::Motor
                                                                                 : WorkKind::Damping;
  }
  // Adds the work of the fed-forward forces over the motion since `from` and `rate` to the ledger; pose_lead as in
  // ledger.h.
  void book_feedforward(EnergyLedger &ledger, const ArticulationDynamics::Position &from,
                        const ArticulationDynamics::Rate &rate, btScalar pose_lead) const;
  bool any() const { return !are_drives && (!planned.empty() || feeds_limits); }
  // Writes the rates that the fed-forward impulses of limits give at the old position, and returns false if there are none.
  // Rows have the whole impulses and act on the motion without these. The articulated inertia must have been factored.
  bool rates_by_limits(ArticulationDynamics::Rate &fed);
  // Discards the forces of the last sub-step, after the position was set.
  void reset();
  // Whether a limit had an impulse in the last sub-step.
  bool hit_limit() const;
  // Whether a limit stopped a sliding coordinate of this link in the last sub-step.
  bool hit_sliding_limit(size_t member) const;
  // Impulse of a stiff spring in the last sub-step, N m s or N s.
  btScalar spring_impulse(size_t spring) const;

  void finalizeMultiDof() override {}
  int getIslandIdA() const override;
  int getIslandIdB() const override { return -1; }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}

 private:
  // Sources of rows that are no forces of motors, springs and friction.
  static constexpr int LIMIT = -1, LARGEST_RATE = -2;

  struct Row {
    int coordinate;
    btScalar target;     // rate, rad/s or m/s
    btScalar softness;   // change of rate per impulse
    btScalar low, high;  // bounds of the impulse
    // Motor: its coordinate; stiff spring: the number of coordinates plus the index of the spring; friction and rotor: see
    // friction_of and rotor_of.
    int source = LIMIT;
    // Impulse of the fed-forward force, which is part of the free motion.
    btScalar feedforward = 0;
    // Pseudo-velocity that corrects the position error, rad/s or m/s.
    btScalar correction = 0;
    bool is_angle = false;
    // Impulse in the last sub-step of the limit of a coordinate.
    btScalar guess = 0;
    // If not 0, the row acts between a link and its parent: force and torque about its centre of mass on the link by a
    // unit impulse of the row, world axes.
    size_t member = 0;
    btVector3 force{0, 0, 0}, torque{0, 0, 0};
  };

  // bounce: coefficient of restitution. driven: rate that a stiff spring on the coordinate would give it if nothing else
  // held it, rad/s or m/s.
  void plan_limit(int coordinate, btScalar low, btScalar high, bool is_angle, btScalar bounce, btScalar driven,
                  btScalar h);
  void plan_largest_rate(const SoftMotor &motor, int coordinate, bool is_angle);
  // Source of the friction on a coordinate: those of friction follow those of springs.
  int friction_of(int coordinate) const {
    return articulation.dynamics.coordinates + static_cast<int>(articulation.springs.size()) + coordinate;
  }
  // Source of the inertia of the rotor of a coordinate: those of rotors follow those of friction.
  int rotor_of(int coordinate) const { return friction_of(articulation.dynamics.coordinates) + coordinate; }
  // Rate without a force of the spring at the end of the sub-step, rad/s or m/s.
  btScalar target_of(const ArticulationDynamics::Spring &spring, btScalar h) const;
  void plan_limits_of(AmbConstraint &joint, size_t member, btScalar h);
  void plan_drive(int coordinate, btScalar target, btScalar softness, btScalar low, btScalar high, int source, bool is_angle);
  void plan_limit_drives(ArticulationDynamics::DistantLimits &distant, btScalar low, btScalar high, btScalar bounce, btScalar h);
  void add_drive(const ArticulationDynamics::Drive &drive, int source);
  btScalar coordinate_within(int coordinate, btScalar low, btScalar high, bool is_angle) const;
  void remember(btScalar h);
  bool motor_of(const AmbConstraint &joint, btScalar h, btScalar &target, btScalar &softness, btScalar &impulse) const;
  void plan_motor(const AmbConstraint &joint, int coordinate, btScalar h);
  void add_feedforward_row(Row row, btScalar h);
  void drop_wrong_feedforward(btScalar h);
  bool is_refuted(btScalar h);

  AmbArticulation &articulation;
  Vector<Row> planned;
  // Force of each source in the last sub-step, N m or N, and impulse of the limits of each coordinate, N m s or N s.
  Vector<btScalar> forces, limit_impulses;
  // Impulse of the fed-forward force of the limit of each coordinate, and its velocities z, see factor_inertia.
  Vector<btScalar> limit_feedforward, steady_impulses, fed_velocity;
  // Impulse with which the limit of each coordinate holds it in the free motion, also as a part of the force of its motor.
  Vector<btScalar> held_by_limits;
  bool feeds_limits = false;
  // Whether what is planned is part of the equations of motion of this sub-step.
  bool are_drives = false;
  btScalar step = 0;
  ArticulationDynamics::Rate acceleration, with_feedforward;
  Vector<btScalar> fed_forces;
  // Rates of the coordinates at the beginning of this sub-step, and their change in the last one, as if it had lasted as
  // long as this one.
  Vector<btScalar> last_rate, last_change;
};

// External constraint on a link: a fixed or point-to-point constraint between a link and a body that is not in its
// articulation.
class ExternalConstraintRows : public EngineRows {
 public:
  ExternalConstraintRows(AmbConstraint &constraint, AmbBody &link, const btTransform &frame, AmbBody &other,
                         const btTransform &other_frame, int rows);

  void finalizeMultiDof() override {}
  int getIslandIdA() const override { return link.collider->getIslandTag(); }
  int getIslandIdB() const override { return other.collider->getIslandTag(); }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}
  void reset();
  bool is_geometric(int) const override { return true; }
  btScalar error(int row) const override { return errors[row]; }
  btScalar bias(int row) const override { return biases[row]; }
  btScalar guess(int row) const override { return guesses[row]; }
  WorkKind work_kind(int) const override { return WorkKind::Joint; }
  // Writes the reaction wrenches after the solution of a sub-step of h s.
  void write_feedback(btScalar h);

 private:
  AmbConstraint &constraint;
  AmbBody &link, &other;
  btTransform frame, other_frame;
  btScalar errors[6] = {}, biases[6] = {}, guesses[6] = {};
};

// Six rows that drive a link, as BodyDrive drives a rigid body; see drive.h.
class LinkDrive : public EngineRows {
 public:
  explicit LinkDrive(AmbBody &link);

  bool is_geometric(int) const override { return false; }
  WorkKind work_kind(int) const override { return WorkKind::BodyDrive; }

  void finalizeMultiDof() override {}
  int getIslandIdA() const override { return link.collider->getIslandTag(); }
  int getIslandIdB() const override { return -1; }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}

  bool enabled = false;
  btScalar velocity[6] = {};
  // Softness of the linear (1/kg) and of the angular rows (1/(kg m^2)).
  btScalar softness[2] = {};

 private:
  AmbBody &link;
};

#endif

use std::ptr::NonNull;

use ambf_dynamics::assembly::Omission;
use ambf_dynamics::ffi as sys;
use nalgebra::{Isometry3, Vector3};

use super::{raw_pose, ArticulationHandle, BodyHandle, ConstraintHandle, World};

/// What is [read](World::observe_constraints) of all constraints, by place.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointReadings {
    /// rad or m.
    pub positions: Vec<f64>,
    /// rad/s or m/s.
    pub rates: Vec<f64>,
}

impl JointReadings {
    /// Makes place for those of so many constraints.
    pub fn make_room(&mut self, count: usize) {
        self.positions.resize(count, 0.0);
        self.rates.resize(count, 0.0);
    }
}

/// Description of a constraint between bodies A and B.
#[derive(Debug, Clone, PartialEq)]
pub struct Constraint {
    /// Type, and the parameters of that type only.
    pub kind: ConstraintKind,
    /// Joint frame in the inertial frame of A.
    pub frame_a: Isometry3<f64>,
    /// Joint frame in the inertial frame of B.
    pub frame_b: Isometry3<f64>,
    /// Bullet's parameters: parameter, value, axis (-1 for types without axes).
    pub parameters: Vec<(ConstraintParameter, f64, i32)>,
    /// Whether the reaction wrenches on both bodies are computed.
    pub feedback: bool,
    /// Whether collisions between A and B are disabled.
    pub disable_collisions: bool,
}

/// Type of a constraint. "Limits" are `[low, high]`; low above high means free where six axes are given.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "made once a joint and dropped at once")]
pub enum ConstraintKind {
    /// Rotation about z of the joint frames; limits in rad.
    Hinge {
        /// `None`: unlimited.
        limits: Option<[f64; 2]>,
    },
    /// Translation along x of the joint frames; limits in m.
    Slider {
        /// `None`: unlimited.
        limits: Option<[f64; 2]>,
    },
    /// No relative motion.
    Fixed,
    /// The origins of the joint frames coincide.
    PointToPoint,
    /// Ball joint that swings and twists within spans, rad.
    ConeTwist {
        /// Span about z.
        swing1: f64,
        /// Span about y.
        swing2: f64,
        /// Span about x.
        twist: f64,
    },
    /// Six limited axes: linear x, y, z in m, angular x, y, z in rad, in Bullet's sign.
    SixDof([[f64; 2]; 6]),
    /// Six limited axes with springs.
    SixDofSpring {
        /// As for [`SixDof`](Self::SixDof).
        limits: [[f64; 2]; 6],
        /// `None`: Bullet's defaults stay on that axis, no spring.
        springs: [Option<Spring>; 6],
    },
}

/// A spring on one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spring {
    /// Whether it acts.
    pub enabled: bool,
    /// N/m or N·m/rad.
    pub stiffness: f64,
    /// N·s/m or N·m·s/rad.
    pub damping: f64,
    /// Rest position, m or rad, in Bullet's sign.
    pub equilibrium: Option<f64>,
}

/// Bullet's parameters of a constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum ConstraintParameter {
    /// Error reduction.
    Erp = 1,
    /// Error reduction at limits.
    StopErp = 2,
    /// Constraint force mixing.
    Cfm = 3,
}

impl ConstraintKind {
    /// The scalar that is read as the position of a constraint.
    fn reading(&self) -> u8 {
        let reading = match self {
            Self::Hinge { .. } => sys::AmbReading::AmbReading_HingeAngle,
            Self::Slider { .. } => sys::AmbReading::AmbReading_SliderPosition,
            Self::SixDofSpring { springs, .. } => match springs {
                [None, None, Some(_), None, None, None] => sys::AmbReading::AmbReading_AxisDistance,
                [None, None, None, None, None, Some(_)] => sys::AmbReading::AmbReading_AxisAngle,
                _ => sys::AmbReading::AmbReading_None,
            },
            _ => sys::AmbReading::AmbReading_None,
        };
        reading as u8
    }
}

/// Below this span, rad, Bullet locks the swing of a cone-twist joint about that axis.
const CONE_TWIST_FIXED_SPAN: f64 = 0.05;

impl ConstraintKind {
    /// Whether it leaves the motion of a hinge, a slider or a ball joint, all motions, or none, apart from limits: what a
    /// joint of an articulation is.
    fn is_simple(&self) -> bool {
        match self {
            Self::Hinge { .. } | Self::Slider { .. } | Self::Fixed | Self::PointToPoint => true,
            Self::ConeTwist { swing1, swing2, .. } => swing1.min(*swing2) >= CONE_TWIST_FIXED_SPAN,
            Self::SixDof(limits) => {
                let is_open = |axes: &[[f64; 2]]| axes.iter().all(|[low, high]| low != high);
                is_open(&limits[3..]) && (limits[..3] == [[0.0; 2]; 3] || is_open(&limits[..3]))
            }
            Self::SixDofSpring { .. } => false,
        }
    }

    /// Whether it is a spring along or about z with all other axes locked.
    fn is_axis_spring(&self) -> bool {
        let Self::SixDofSpring { limits, springs } = self else { return false };
        let on_z = |axis: usize| {
            (0..6).all(|i| i == axis || (limits[i] == [0.0; 2] && springs[i].is_none())) && springs[axis].is_some()
        };
        on_z(2) || on_z(5)
    }
}

/// Makes the Bullet constraint; the caller frees it.
///
/// # Safety
/// `a` and `b` are live bodies, different from each other, that outlive the result.
unsafe fn make(a: *mut sys::AmbBody, b: *mut sys::AmbBody, constraint: &Constraint) -> *mut sys::AmbConstraint {
    let (raw_a, raw_b) = (raw_pose(&constraint.frame_a), raw_pose(&constraint.frame_b));
    let (frame_a, frame_b) = (raw_a.as_ptr(), raw_b.as_ptr());
    // SAFETY: the caller vouches for the bodies; frames are 12 doubles; each set function is called on the type it casts
    // to.
    unsafe {
        match &constraint.kind {
            ConstraintKind::Hinge { limits } => {
                let raw = sys::amb_driven_hinge_new(a, b, frame_a, frame_b);
                if let Some([low, high]) = *limits {
                    sys::amb_hinge_set_limit(raw, low, high);
                }
                raw
            }
            ConstraintKind::Slider { limits } => {
                let raw = sys::amb_driven_slider_new(a, b, frame_a, frame_b);
                if let Some([low, high]) = *limits {
                    sys::amb_slider_set_limit(raw, low, high);
                }
                sys::amb_slider_lock_rotation(raw);
                raw
            }
            ConstraintKind::Fixed => sys::amb_exact_fixed_new(a, b, frame_a, frame_b),
            ConstraintKind::PointToPoint => sys::amb_exact_point_to_point_new(a, b, frame_a, frame_b),
            &ConstraintKind::ConeTwist { swing1, swing2, twist } => {
                let raw = sys::amb_exact_cone_twist_new(a, b, frame_a, frame_b);
                sys::amb_cone_twist_set_limit(raw, swing1, swing2, twist);
                raw
            }
            ConstraintKind::SixDof(limits) => {
                let raw = sys::amb_exact_six_dof_new(a, b, frame_a, frame_b);
                for (axis, &[low, high]) in (0..).zip(limits) {
                    sys::amb_six_dof_set_limit(raw, axis, low, high);
                }
                raw
            }
            ConstraintKind::SixDofSpring { limits, springs } => {
                let raw = sys::amb_implicit_spring_new(a, b, frame_a, frame_b);
                for (axis, (&[low, high], spring)) in (0..).zip(limits.iter().zip(springs)) {
                    sys::amb_six_dof_spring_set_limit(raw, axis, low, high);
                    if let Some(spring) = spring {
                        let enabled = spring.enabled.into();
                        sys::amb_six_dof_spring_set_spring(raw, axis, enabled, spring.stiffness, spring.damping);
                        if let Some(equilibrium) = spring.equilibrium {
                            sys::amb_six_dof_spring_set_equilibrium(raw, axis, equilibrium);
                        }
                    }
                }
                raw
            }
        }
    }
}

/// Reaction of a joint on its two bodies in the last sub-step: N and N·m, world axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JointWrench {
    /// Force on A.
    pub force_a: Vector3<f64>,
    /// Torque on A.
    pub torque_a: Vector3<f64>,
    /// Force on B.
    pub force_b: Vector3<f64>,
    /// Torque on B.
    pub torque_b: Vector3<f64>,
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Motor {
    None,
    Hinge,
    Slider,
}

#[derive(Clone)]
pub(super) struct OwnedConstraint {
    pub(super) raw: NonNull<sys::AmbConstraint>,
    pub(super) bodies: [BodyHandle; 2],
    pub(super) motor: Motor,
    /// See [`ConstraintKind::is_simple`].
    pub(super) is_simple: bool,
    /// Spring about or along one axis, with all other axes locked.
    pub(super) is_axis_spring: bool,
    /// The articulation of which the constraint is a joint or parallel spring.
    pub(super) articulation: Option<ArticulationHandle>,
    /// Index in the world's lists of constraints.
    index: usize,
}

impl World {
    /// Adds a constraint from `a` to `b`; `None` when a handle is stale or both are the same. Articulations of which
    /// they are links are dissolved, unless the constraint can be an external constraint: it is fixed or
    /// point-to-point, and the bodies are not links of the same articulation.
    pub fn add_constraint(
        &mut self,
        a: BodyHandle,
        b: BodyHandle,
        constraint: &Constraint,
    ) -> Option<ConstraintHandle> {
        let _arena = self.enter();
        if a == b {
            return None;
        }
        let (raw_a, raw_b) = (self.raw_body(a)?, self.raw_body(b)?);
        self.dissolve_for(a, b, &constraint.kind);
        // SAFETY: both bodies are alive and different, and outlive the constraint: `remove_body` refuses while it
        // exists.
        let raw = unsafe { make(raw_a, raw_b, constraint) };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        // SAFETY: constraint and world are alive; the constraint is removed from the world before it is freed.
        unsafe {
            for &(parameter, value, axis) in &constraint.parameters {
                sys::amb_constraint_set_param(raw.as_ptr(), parameter as i32, value, axis);
            }
            sys::amb_world_add_constraint(self.raw.as_ptr(), raw.as_ptr(), constraint.disable_collisions.into());
            if constraint.feedback {
                sys::amb_constraint_enable_feedback(raw.as_ptr());
            }
        }
        for handle in [a, b] {
            self.bodies[handle].constraint_count += 1;
        }
        let motor = match constraint.kind {
            ConstraintKind::Hinge { .. } => Motor::Hinge,
            ConstraintKind::Slider { .. } => Motor::Slider,
            _ => Motor::None,
        };
        let is_simple = constraint.kind.is_simple();
        let is_axis_spring = constraint.kind.is_axis_spring();
        let owned =
            OwnedConstraint { raw, bodies: [a, b], motor, is_simple, is_axis_spring, articulation: None, index: 0 };
        Some(self.list_constraint(owned, constraint.kind.reading()))
    }

    /// Leaves rows out of a hinge, slider, ball joint or cone-twist joint in worlds with the accurate solver, because other
    /// joints of its loop demand the same. `frames` are its joint frames in the inertial frames of its bodies. False for
    /// other constraints and stale handles.
    pub fn omit_rows(&mut self, handle: ConstraintHandle, frames: &[Isometry3<f64>; 2], omission: &Omission) -> bool {
        let _arena = self.enter();
        let Some(raw) = self.raw_constraint(handle) else { return false };
        let mut axes = [0.0; 9];
        axes.copy_from_slice(omission.axes.as_slice());
        let rows = sys::AmbOmittedRows {
            frame_a: raw_pose(&frames[0]),
            frame_b: raw_pose(&frames[1]),
            axes,
            side: omission.side as i32,
            linear: omission.linear.map(i32::from),
            angular: omission.angular.map(i32::from),
            linear_clearance: omission.clearance.distance,
            angular_clearance: omission.clearance.angle,
        };
        // SAFETY: the constraint is alive; the rows are copied.
        unsafe { sys::amb_constraint_omit_rows(raw, &rows) != 0 }
    }

    /// Gives a constraint its place in the lists.
    fn list_constraint(&mut self, constraint: OwnedConstraint, reading: u8) -> ConstraintHandle {
        let raw = constraint.raw;
        // Indices are reused, so that constraints that come and go, such as grips, do not let the lists grow.
        let index = self.free_indices.pop().unwrap_or(self.constraint_list.len());
        let handle = self.constraints.insert(OwnedConstraint { index, ..constraint });
        if index == self.constraint_list.len() {
            self.constraint_list.push(raw.as_ptr());
            self.readings.push(reading);
            self.constraint_order.push(handle);
        } else {
            self.constraint_list[index] = raw.as_ptr();
            self.readings[index] = reading;
            self.constraint_order[index] = handle;
        }
        handle
    }

    /// Adds a grip, as for picking with a mouse: a constraint that pulls a point of a body, in its inertial frame, to
    /// the point `goal` of the world (both m), with impulses of at most `max_impulse` N·s a sub-step along each axis.
    /// `None` when the handle is stale. [`remove_constraint`](Self::remove_constraint) removes it.
    pub fn add_grip(
        &mut self,
        body: BodyHandle,
        point: &Vector3<f64>,
        goal: &Vector3<f64>,
        max_impulse: f64,
    ) -> Option<ConstraintHandle> {
        let _arena = self.enter();
        let raw_body = self.raw_body(body)?;
        // SAFETY: the body is alive and outlives the constraint: `remove_body` refuses while it exists. Three doubles
        // are read of each point.
        let raw = unsafe { sys::amb_grip_new(raw_body, point.as_ptr(), goal.as_ptr(), max_impulse) };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        // SAFETY: constraint and world are alive; the constraint is removed from the world before it is freed.
        unsafe { sys::amb_world_add_constraint(self.raw.as_ptr(), raw.as_ptr(), 0) };
        // `bodies` has the body twice, because the other end is not a body of this world; so `remove_constraint`
        // subtracts 1 twice.
        self.bodies[body].constraint_count += 2;
        let owned = OwnedConstraint {
            raw,
            bodies: [body, body],
            motor: Motor::None,
            is_simple: false,
            is_axis_spring: false,
            articulation: None,
            index: 0,
        };
        Some(self.list_constraint(owned, sys::AmbReading::AmbReading_None as u8))
    }

    /// Moves the goal of a constraint that [`add_grip`](Self::add_grip) made, m. False when it is not there.
    pub fn move_grip(&mut self, grip: ConstraintHandle, goal: &Vector3<f64>) -> bool {
        let _arena = self.enter();
        let Some(constraint) = self.constraints.get(grip) else { return false };
        let [a, b] = constraint.bodies;
        if a != b {
            return false;
        }
        // SAFETY: the constraint is alive, and only grips have one body twice; three doubles are read.
        unsafe { sys::amb_grip_set_goal(constraint.raw.as_ptr(), goal.as_ptr()) };
        true
    }

    /// Place of a constraint in [`constraints`](Self::constraints), for as long as it is there.
    pub fn constraint_index(&self, handle: ConstraintHandle) -> Option<usize> {
        Some(self.constraints.get(handle)?.index)
    }

    /// Removes a constraint and its couplings; the places of others in [`constraints`](Self::constraints) stay. An articulation
    /// of which it is a joint is dissolved. False when it is not there.
    pub fn remove_constraint(&mut self, handle: ConstraintHandle) -> bool {
        let _arena = self.enter();
        if let Some(articulation) = self.constraints.get(handle).and_then(|constraint| constraint.articulation) {
            self.dissolve(articulation);
        }
        self.uncouple(handle);
        let Some(constraint) = self.constraints.remove(handle) else { return false };
        self.trees.retain(|tree| !tree.contains(&handle));
        for body in constraint.bodies {
            self.bodies[body].constraint_count -= 1;
        }
        self.constraint_list[constraint.index] = std::ptr::null_mut();
        self.free_indices.push(constraint.index);
        // SAFETY: the constraint is in this world, and no pointer to it is left after this.
        unsafe {
            sys::amb_world_remove_constraint(self.raw.as_ptr(), constraint.raw.as_ptr());
            sys::amb_constraint_free(constraint.raw.as_ptr());
        }
        true
    }

    /// Handles of all constraints, in the order of [`read_constraints`](Self::read_constraints). In the place of a
    /// removed constraint stands its stale handle, until a new one takes the place.
    pub fn constraints(&self) -> &[ConstraintHandle] {
        &self.constraint_order
    }

    /// Reads the positions that [`read_constraints`](Self::read_constraints) gives.
    pub fn read_positions(&self, readings: &mut JointReadings) {
        readings.make_room(self.constraint_list.len());
        self.read_constraints(&mut readings.positions);
    }

    /// Reads the position of all constraints by place, as many as `out` has place for: angle of a hinge (rad), position
    /// of a slider (m), of a spring on z (m or rad), 0 for others. In the place of a removed constraint `out` stays as
    /// it is.
    pub fn read_constraints(&self, out: &mut [f64]) {
        let _arena = self.enter();
        let n = out.len().min(self.constraint_list.len());
        // SAFETY: the lists are of the same length, hold live constraints and null only, and each reading fits the
        // constraint's type.
        unsafe {
            sys::amb_constraints_read(
                self.constraint_list.as_ptr(),
                self.readings.as_ptr(),
                n as i32,
                out.as_mut_ptr(),
            );
        }
    }

    /// Reads the positions of all constraints from the present poses, as [`read_constraints`](Self::read_constraints) does
    /// after [`refresh_constraints`](Self::refresh_constraints), and the rates of hinges, rad/s, and of joints of
    /// articulations; 0 for those of other constraints.
    pub fn observe_constraints(&mut self, readings: &mut JointReadings) {
        let _arena = self.enter();
        let n = self.constraint_list.len();
        readings.make_room(n);
        // SAFETY: the lists are of the same length, for which there is room. They hold live constraints, of which hinges and
        // sliders were made by the engine, and null only; each reading fits the constraint's type.
        unsafe {
            sys::amb_constraints_observe(
                self.constraint_list.as_ptr(),
                self.readings.as_ptr(),
                n as i32,
                readings.positions.as_mut_ptr(),
                readings.rates.as_mut_ptr(),
            );
        }
    }

    /// Brings what [`read_constraints`](Self::read_constraints) gives up to the present poses: the position of a slider
    /// is otherwise that of the last solver pass. For use after poses were set.
    pub fn refresh_constraints(&mut self) {
        // SAFETY: the list holds live constraints and null only, whose bodies are alive.
        unsafe { sys::amb_constraints_refresh(self.constraint_list.as_ptr(), self.constraint_list.len() as i32) }
    }

    /// Switches the motor of a hinge (velocity in rad/s, `max` the largest impulse a sub-step, N·m·s) or slider (m/s,
    /// largest force, N). False for other constraints.
    pub fn set_motor(&mut self, handle: ConstraintHandle, enabled: bool, velocity: f64, max: f64) -> bool {
        let Some(constraint) = self.constraints.get(handle) else { return false };
        let raw = constraint.raw.as_ptr();
        // SAFETY: the constraint is alive and of the type that the call casts it to.
        unsafe {
            match constraint.motor {
                Motor::Hinge => sys::amb_hinge_set_motor(raw, enabled.into(), velocity, max),
                Motor::Slider => sys::amb_slider_set_motor(raw, enabled.into(), velocity, max),
                Motor::None => return false,
            }
        }
        true
    }

    pub(super) fn motor_of(&self, handle: ConstraintHandle) -> Option<Motor> {
        Some(self.constraints.get(handle)?.motor)
    }

    pub(super) fn raw_constraint(&self, handle: ConstraintHandle) -> Option<*mut sys::AmbConstraint> {
        Some(self.constraints.get(handle)?.raw.as_ptr())
    }

    /// Reaction of a joint with feedback in the last sub-step; zero without feedback.
    pub fn joint_wrench(&self, handle: ConstraintHandle) -> Option<JointWrench> {
        let mut out = [0.0; 12];
        // SAFETY: the constraint is alive; 12 doubles are written.
        unsafe { sys::amb_constraint_feedback(self.constraints.get(handle)?.raw.as_ptr(), out.as_mut_ptr()) }
        let vector = |i: usize| Vector3::from_column_slice(&out[i..i + 3]);
        Some(JointWrench { force_a: vector(0), torque_a: vector(3), force_b: vector(6), torque_b: vector(9) })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ball, hinge};
    use super::super::Solver;
    use super::*;

    #[test]
    fn a_motor_turns_its_hinge_and_feedback_carries_the_weight() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(2.0, 1.0)));
        let joint = world.add_constraint(a, b, &hinge()).unwrap();
        world.set_motor(joint, true, 1.0, 10.0);
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        let mut angle = [0.0];
        world.read_constraints(&mut angle);
        assert!((angle[0] - 0.5).abs() < 0.01, "{}", angle[0]);
        let wrench = world.joint_wrench(joint).unwrap();
        assert!((wrench.force_b.z - 20.0).abs() < 0.1, "{wrench:?}");
    }

    #[test]
    fn every_solver_draws_a_gripped_point_to_its_goal_and_lets_go() {
        for (name, solver) in Solver::NAMES {
            let mut world = World::new(solver);
            world.set_gravity(Vector3::new(0.0, 0.0, -9.8));
            let body = world.add_body(ball(1.0, 0.0));
            let grip = world.add_grip(body, &Vector3::zeros(), &Vector3::zeros(), 1.0).unwrap();
            let goal = Vector3::new(0.2, 0.0, 0.3);
            for step in 0..2000 {
                world.move_grip(grip, &(goal * (f64::from(step) / 1000.0).min(1.0)));
                world.step(0.001, 1, 0.001);
            }
            let off = (world.pose(body).unwrap().translation.vector - goal).norm();
            assert!(off < 1e-3, "{name}: {off} m off");
            assert!(!world.remove_body(body), "{name}: it is held");
            assert!(world.remove_constraint(grip) && !world.move_grip(grip, &goal));
            for _ in 0..100 {
                world.step(0.001, 1, 0.001);
            }
            let fallen = goal.z - world.pose(body).unwrap().translation.vector.z;
            assert!((fallen - 0.5 * 9.8 * 0.01).abs() < 2e-3, "{name}: {fallen} m fallen");
            assert!(world.remove_body(body));
        }
    }

    #[test]
    fn every_solver_holds_a_pendulum() {
        for (name, solver) in Solver::NAMES {
            let mut world = World::new(solver);
            world.set_gravity(Vector3::new(0.0, -10.0, 0.0));
            let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(1.0, 1.0)));
            world.add_constraint(a, b, &hinge()).unwrap();
            for _ in 0..300 {
                world.step(0.001, 1, 0.001);
            }
            let distance = world.pose(b).unwrap().translation.vector.norm();
            assert!((distance - 1.0).abs() < 1e-3, "{name}: {distance}");
        }
    }
}

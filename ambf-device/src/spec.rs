/// Which of its degrees of freedom a device senses, or moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Axes {
    /// Translation of the tip.
    pub position: bool,
    /// Rotation of the tip.
    pub rotation: bool,
    /// Gripper.
    pub gripper: bool,
}

/// What a device can do.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceSpec {
    /// Model name, as `hardware name` in device files.
    pub model: String,
    /// Who makes it.
    pub manufacturer: String,
    /// Largest force at the tip, N.
    pub max_force: f64,
    /// Largest torque, N·m.
    pub max_torque: f64,
    /// Largest gripper force, N.
    pub max_gripper_force: f64,
    /// Largest stiffness that it renders stably, N/m.
    pub max_stiffness: f64,
    /// The same of rotation, N·m/rad.
    pub max_angular_stiffness: f64,
    /// The same of the gripper, N/m.
    pub max_gripper_stiffness: f64,
    /// Largest damping, N·s/m.
    pub max_damping: f64,
    /// The same of rotation, N·m·s/rad.
    pub max_angular_damping: f64,
    /// The same of the gripper, N·s/m.
    pub max_gripper_damping: f64,
    /// Radius of a sphere inside the workspace, m.
    pub workspace_radius: f64,
    /// Angle of the open gripper, rad.
    pub gripper_max_angle: f64,
    /// What it senses.
    pub sensed: Axes,
    /// What it moves.
    pub actuated: Axes,
    /// Whether it serves the left hand.
    pub left_hand: bool,
    /// Whether it serves the right hand.
    pub right_hand: bool,
    /// How long the reference holds still after start-up, s: 3, for slow trackers 5.
    pub start_up_hold: f64,
}

impl DeviceSpec {
    /// An unknown device of that name: every limit 0.1, nothing sensed or moved.
    pub fn unknown(model: &str) -> Self {
        Self {
            model: model.to_owned(),
            manufacturer: String::from("unknown"),
            max_force: 0.1,
            max_torque: 0.1,
            max_gripper_force: 0.1,
            max_stiffness: 0.1,
            max_angular_stiffness: 0.1,
            max_gripper_stiffness: 0.1,
            max_damping: 0.1,
            max_angular_damping: 0.1,
            max_gripper_damping: 0.1,
            workspace_radius: 0.1,
            gripper_max_angle: 0.1,
            sensed: Axes::default(),
            actuated: Axes::default(),
            left_hand: false,
            right_hand: false,
            start_up_hold: 3.0,
        }
    }
}

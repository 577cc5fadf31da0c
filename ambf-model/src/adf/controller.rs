//! Gains of the joint and Cartesian controllers.

/// PID gains. Units follow from the output: see [`ControllerOutput`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Proportional gain. Default: 10.
    pub p: f64,
    /// Integral gain. Default: 0.
    pub i: f64,
    /// Derivative gain. Default: 1.
    pub d: f64,
}

impl Default for Gains {
    fn default() -> Self {
        Self { p: 10.0, i: 0.0, d: 1.0 }
    }
}

/// What a controller's output is applied as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerOutput {
    /// Force or torque: P in N/m or N·m/rad, D in N·s/m or N·m·s/rad.
    Force,
    /// Velocity: P in 1/s, D without unit.
    Velocity,
    /// As velocity; kept apart because it was written so.
    Position,
}

/// Gains of one controller and what its output is applied as.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controller {
    /// Default: see [`Gains`].
    pub gains: Gains,
    /// Default: velocity when the block that holds the gains is absent, force when it is present.
    pub output: ControllerOutput,
}

impl Default for Controller {
    fn default() -> Self {
        Self { gains: Gains::default(), output: ControllerOutput::Velocity }
    }
}

/// Cartesian controller of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CartesianController {
    /// Position part.
    pub linear: Controller,
    /// Orientation part.
    pub angular: Controller,
}

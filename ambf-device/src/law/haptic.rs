use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::camera::{CameraMotion, CameraMover};
use super::controls::{Buttons, GainChange, Mode, Status};
use super::feedback::Feedback;
use super::gripper::Gripper;
use super::reference::{Motion, Reference, RotationRule};
use super::rotation::unit;
use super::velocity::VelocityEstimator;
use crate::{DeviceForce, DeviceSample, DeviceSpec};
use ambf_model::adf;

/// Range of a tick's `dt`, s.
const DT: (f64, f64) = (0.1e-3, 20e-3);
/// A hand of which nothing new was measured for longer is at rest, s.
const AT_REST: f64 = 0.1;
/// The button that switches forces on.
const ENABLING_BUTTON: Option<u32> = Some(0);

/// Switches that are the same for all devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Switches {
    /// Whether devices send forces at all (`--enableforces`). Default: `false`.
    pub forces: bool,
    /// What A1 and A2 do.
    pub mode: Mode,
    /// Orientation of end-effectors.
    pub rotation: RotationRule,
    /// Whether a closing gripper holds what its proximity sensors see; counts on the physics side. Default: `true`.
    pub gripping_assist: bool,
}

impl Default for Switches {
    fn default() -> Self {
        Self { forces: false, mode: Mode::default(), rotation: RotationRule::default(), gripping_assist: true }
    }
}

/// What a device knows of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorldView {
    /// Body frame of the root link in the world; `None`: it is not there.
    pub root: Option<Isometry3<f64>>,
    /// `R_c`: rotation of the first paired camera relative to its parent; `None`: there are no cameras, which counts as
    /// no rotation.
    pub camera: Option<UnitQuaternion<f64>>,
    /// Physics is paused and no step is pending: no force, and the reference stays.
    pub paused: bool,
    /// There has been no new state for more than 50 ms: no force.
    pub stale: bool,
    /// Bodies were reset since the last tick: the reference returns to the initial pose of the root link.
    pub reset: bool,
}

/// One tick of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HapticInput {
    /// Newest sample.
    pub sample: DeviceSample,
    /// The world.
    pub view: WorldView,
    /// Wall clock since physics was started, s; for the start-up hold.
    pub time: f64,
    /// Time since the last tick, s; it is clamped to 0.1…20 ms.
    pub dt: f64,
    /// Switches.
    pub switches: Switches,
}

/// What a tick of a device gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HapticOutput {
    /// Where the hand wants the root link, world.
    pub reference: Isometry3<f64>,
    /// Opening of the gripper, 0…1.
    pub gripper: f64,
    /// For the user's hand, device frame. Zero whenever something is wrong.
    pub force: DeviceForce,
    /// The clutch is pressed.
    pub clutch: bool,
    /// The button for cameras is pressed and moves them.
    pub camera_pressed: bool,
    /// The reference does not follow the hand because this is the start-up hold, the device or the world is not valid,
    /// or physics is paused.
    pub holding: bool,
    /// Forces were switched on by the first press of button 0, or need no press.
    pub enabled: bool,
    /// Motion of all paired cameras.
    pub camera: Option<CameraMotion>,
    /// The mode of all devices is to change by so many steps, see [`Mode::stepped`]; −1, 0 or 1.
    pub mode_steps: i8,
    /// A gain of all devices is to change: [`HapticLoop::change`] and
    /// [`EndEffector::change`](super::EndEffector::change) of each.
    pub gain: Option<GainChange>,
    /// News about buttons; `None`: what was shown stays.
    pub status: Option<Status>,
}

/// The device side of a device: from a sample to the reference pose of its end-effector and to the force for the hand.
/// One per device, with a clutch of its own; nothing here allocates or waits.
///
/// A sample or world that is not valid or not finite gives no force and holds the reference as if clutched. When both
/// are good again the reference goes on from where it is, without a jump, and the force rises from zero within a
/// second.
#[derive(Debug, Clone)]
pub struct HapticLoop {
    a1: Option<u32>,
    a2: Option<u32>,
    next_mode: Option<u32>,
    prev_mode: Option<u32>,
    hold: f64,
    enabled: bool,
    buttons: Buttons,
    gripper: Gripper,
    reference: Reference,
    mover: CameraMover,
    feedback: Feedback,
    velocity: VelocityEstimator,
    sequence: Option<u64>,
    /// Time since the sample changed, s.
    age: f64,
}

impl HapticLoop {
    /// A loop at rest. `root`: initial pose of the root link's body frame in the world, to which a reset returns too.
    pub fn new(device: &adf::InputDevice, spec: &DeviceSpec, root: Isometry3<f64>) -> Self {
        let buttons = device.button_mapping;
        Self {
            a1: buttons.a1,
            a2: buttons.a2,
            next_mode: buttons.next_mode,
            prev_mode: buttons.prev_mode,
            hold: spec.start_up_hold,
            enabled: !device.enable_on_button,
            buttons: Buttons::default(),
            gripper: Gripper::new(buttons.g1, spec.sensed.gripper),
            reference: Reference::new(root, device.workspace_scaling, device.orientation_offset),
            mover: CameraMover::default(),
            feedback: Feedback::new(device, spec),
            velocity: VelocityEstimator::default(),
            sequence: None,
            age: 0.0,
        }
    }

    /// One tick, about a thousand times a second.
    pub fn tick(&mut self, input: &HapticInput) -> HapticOutput {
        let dt = if input.dt.is_nan() { DT.0 } else { input.dt.clamp(DT.0, DT.1) };
        if input.view.reset {
            self.reference.reset();
            self.feedback.silence();
        }
        let mut output = self.held();
        let Some((hand, root, camera)) = usable(input) else {
            self.interrupt();
            return output;
        };
        let sample = &input.sample;
        self.age += dt;
        if self.sequence != Some(sample.sequence) {
            self.age = 0.0;
            self.sequence = Some(sample.sequence);
            self.velocity.push(sample.stamp, hand.translation.vector, hand.rotation, sample.gripper);
        }
        self.buttons.update(sample.buttons);
        self.enabled |= self.buttons.is_pressed(ENABLING_BUTTON);

        let down = |button| i8::from(self.buttons.went_down(button));
        output.mode_steps = down(self.next_mode) - down(self.prev_mode);
        let mode = input.switches.mode.stepped(output.mode_steps);
        let steps = down(self.a1) - down(self.a2);
        let gripper_steps = if mode == Mode::GripperJaw { steps } else { 0 };
        self.gripper.update(sample, &self.buttons, gripper_steps);
        output.gripper = self.gripper.value();
        if let Some(quantity) = mode.quantity().filter(|_| steps != 0) {
            output.gain = Some(GainChange { quantity, step: quantity.button_step() * f64::from(steps) });
        }
        if mode == Mode::CameraClutch {
            output.clutch = self.buttons.is_pressed(self.a1);
            output.camera_pressed = self.buttons.is_pressed(self.a2);
        }
        output.status = self.status(mode, output.mode_steps);

        let velocity = match sample.linear_velocity {
            _ if self.age > AT_REST => Vector3::zeros(),
            Some(velocity) => velocity,
            None => self.velocity.linear(),
        };
        output.camera = self.mover.update(output.camera_pressed, input.view.camera, hand.rotation, velocity, dt);
        output.holding = input.time.is_nan() || input.time < self.hold;
        self.reference.update(&Motion {
            hand,
            camera,
            rule: input.switches.rotation,
            clutch: output.clutch,
            camera_pressed: output.camera_pressed,
            hold: output.holding,
            dt,
        });
        output.reference = self.reference.pose();
        output.enabled = self.enabled;
        if self.enabled && input.switches.forces && !input.view.stale {
            output.force = self.feedback.update(&output.reference, &root, &camera, output.clutch, dt);
        } else {
            self.feedback.silence();
            self.feedback.advance(dt);
        }
        output
    }

    /// Changes a gain if it is one of devices; the value after it, which is limited to what the device renders stably.
    pub fn change(&mut self, change: GainChange) -> Option<f64> {
        self.feedback.change(change)
    }

    /// Gains of the force feedback in use: N/m and N·m/rad.
    pub fn gains(&self) -> (f64, f64) {
        self.feedback.gains()
    }

    fn held(&self) -> HapticOutput {
        HapticOutput {
            reference: self.reference.pose(),
            gripper: self.gripper.value(),
            force: DeviceForce::zero(),
            clutch: false,
            camera_pressed: false,
            holding: true,
            enabled: self.enabled,
            camera: None,
            mode_steps: 0,
            gain: None,
            status: None,
        }
    }

    fn interrupt(&mut self) {
        self.reference.interrupt();
        self.mover.interrupt();
        self.feedback.silence();
        self.buttons.forget();
        self.velocity.clear();
    }

    fn status(&self, mode: Mode, mode_steps: i8) -> Option<Status> {
        let (a1, a2) = (self.a1, self.a2);
        if mode_steps != 0 {
            Some(Status::Cleared)
        } else if mode != Mode::CameraClutch {
            None
        } else if self.buttons.went_down(a1) {
            Some(Status::Clutch)
        } else if self.buttons.went_down(a2) {
            Some(Status::Camera)
        } else if self.buttons.went_up(a1) || self.buttons.went_up(a2) {
            Some(Status::Cleared)
        } else {
            None
        }
    }
}

/// Hand, root link and camera of a tick that can be computed with.
fn usable(input: &HapticInput) -> Option<(Isometry3<f64>, Isometry3<f64>, UnitQuaternion<f64>)> {
    let (sample, view) = (&input.sample, &input.view);
    if !sample.valid || !sample.is_finite() || view.paused {
        return None;
    }
    let hand = Isometry3::from_parts(sample.position.into(), unit(&sample.rotation)?);
    let root = view.root.filter(|root| root.translation.vector.iter().all(|x| x.is_finite()))?;
    let root = Isometry3::from_parts(root.translation, unit(&root.rotation)?);
    let camera = match &view.camera {
        Some(camera) => unit(camera)?,
        None => UnitQuaternion::identity(),
    };
    Some((hand, root, camera))
}

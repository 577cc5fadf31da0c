use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::rotation::rotation_vector;

/// How fast the orientation catches up with the hand after an interruption: the difference is gone after this time, s.
const CATCH_UP: f64 = 1.0;
/// Cameras that turn by less are at rest, rad.
const CAMERA_AT_REST: f64 = 1e-9;

/// How the orientation of the hand becomes that of the end-effector. One rule for all devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RotationRule {
    /// `R_s = R_init·R_off·R_h·R_offᵀ`: as the hand, without clutch. The default (key `c`).
    #[default]
    Absolute,
    /// `R_s = O_s·R_c·R_pᵀ·R_h·R_cᵀ`: turned as the hand has turned since the last clutch, as seen by the camera (key
    /// `w`).
    Camera,
}

/// What moves the reference in one tick.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// Hand in the device frame: position (m) and rotation.
    pub hand: Isometry3<f64>,
    /// `R_c`.
    pub camera: UnitQuaternion<f64>,
    pub rule: RotationRule,
    /// The clutch is pressed.
    pub clutch: bool,
    /// The camera button is pressed.
    pub camera_pressed: bool,
    /// The start-up hold.
    pub hold: bool,
    /// s.
    pub dt: f64,
}

/// Reference pose of an end-effector: where the hand wants its root link, world.
///
/// `x_s = o_s + s·R_c·(x_h − x_p)`; orientation: [`RotationRule`].
#[derive(Debug, Clone)]
pub(super) struct Reference {
    scale: f64,
    offset: UnitQuaternion<f64>,
    initial: Isometry3<f64>,
    /// `x_s`, `R_s`.
    pose: Isometry3<f64>,
    /// `o_s`, `O_s`.
    origin: Isometry3<f64>,
    /// `x_p`, `R_p`.
    clutched: Isometry3<f64>,
    /// What the orientation still lags behind the absolute rule, body axes, rad, and for how long, s.
    lag: (Vector3<f64>, f64),
    /// Hand, camera and rule of the last tick; `None`: the hand comes back from an interruption.
    last: Option<(Isometry3<f64>, UnitQuaternion<f64>, RotationRule)>,
    clutch_down: bool,
    camera_down: bool,
}

impl Reference {
    /// At rest at the pose of the root link. `scale`: metres of the world per metre of the device.
    pub(super) fn new(initial: Isometry3<f64>, scale: f64, offset: UnitQuaternion<f64>) -> Self {
        Self {
            scale,
            offset,
            initial,
            pose: initial,
            origin: initial,
            clutched: Isometry3::identity(),
            lag: (Vector3::zeros(), 0.0),
            last: None,
            clutch_down: false,
            camera_down: false,
        }
    }

    pub(super) fn pose(&self) -> Isometry3<f64> {
        self.pose
    }

    /// Back to the initial pose. The next tick starts from there.
    pub(super) fn reset(&mut self) {
        *self = Self::new(self.initial, self.scale, self.offset);
    }

    /// The hand is not known: the reference stays, and goes on from there when the hand is back.
    pub(super) fn interrupt(&mut self) {
        self.last = None;
        self.clutch_down = false;
        self.camera_down = false;
    }

    /// One tick. A result that is not finite leaves everything as it was.
    pub(super) fn update(&mut self, motion: &Motion) {
        let before = self.clone();
        self.step(motion);
        let pose = &self.pose;
        if !pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite()) {
            *self = before;
            self.interrupt();
        }
    }

    fn step(&mut self, motion: &Motion) {
        let hand = motion.hand;
        match self.last {
            None => self.start_from(hand, &hand),
            Some((last, _, rule)) if rule != motion.rule => self.start_from(last, &hand),
            // A camera that turns must not move the end-effector of a hand at rest.
            Some((last, camera, _)) if camera.angle_to(&motion.camera) > CAMERA_AT_REST => {
                self.origin = self.pose;
                self.clutched = last;
            }
            Some(_) => {}
        }
        if motion.hold {
            self.clutched = hand;
        }
        for (pressed, down) in [(motion.camera_pressed, &mut self.camera_down), (motion.clutch, &mut self.clutch_down)]
        {
            if pressed {
                if !*down {
                    self.origin = self.pose;
                }
                self.clutched = hand;
            }
            *down = pressed;
        }
        let moved = motion.camera * (hand.translation.vector - self.clutched.translation.vector);
        let position = self.origin.translation.vector + moved * self.scale;
        let rotation = match motion.rule {
            RotationRule::Absolute => {
                let (lag, left) = self.lag;
                self.lag.1 = (left - motion.dt).max(0.0);
                self.absolute(&hand) * UnitQuaternion::new(lag * (left / CATCH_UP))
            }
            RotationRule::Camera => {
                let turned = self.clutched.rotation.inverse() * hand.rotation;
                self.origin.rotation * motion.camera * turned * motion.camera.inverse()
            }
        };
        // Products of many rotations drift from unit length.
        let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
        self.pose = Isometry3::from_parts(Translation3::from(position), rotation);
        self.last = Some((hand, motion.camera, motion.rule));
    }

    /// The pose of now belongs to `clutched`, and the orientation catches up from now on.
    fn start_from(&mut self, clutched: Isometry3<f64>, hand: &Isometry3<f64>) {
        self.origin = self.pose;
        self.clutched = clutched;
        let lag = self.absolute(hand).inverse() * self.pose.rotation;
        self.lag = (rotation_vector(&lag), CATCH_UP);
    }

    fn absolute(&self, hand: &Isometry3<f64>) -> UnitQuaternion<f64> {
        self.initial.rotation * self.offset * hand.rotation * self.offset.inverse()
    }
}

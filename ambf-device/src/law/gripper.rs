use super::controls::Buttons;
use crate::DeviceSample;

/// Opening at which the gripping assist releases; below it, it grips.
const GRIP: f64 = 0.5;

/// What a gripper is taken for until its opening is known.
pub const UNKNOWN_OPENING: f64 = GRIP;

/// Opening of a gripper, 0 closed … 1 open: sensed, or by a button (pressed: closed), or stepped in mode
/// [`Mode::GripperJaw`](super::Mode::GripperJaw), or 0.5.
#[derive(Debug, Clone)]
pub(super) struct Gripper {
    button: Option<u32>,
    sensed: bool,
    value: f64,
}

impl Gripper {
    pub(super) fn new(button: Option<u32>, sensed: bool) -> Self {
        Self { button, sensed, value: GRIP }
    }

    pub(super) fn value(&self) -> f64 {
        self.value
    }

    /// `steps`: of 0.1, to open; they count for a gripper that is neither sensed nor has a button.
    pub(super) fn update(&mut self, sample: &DeviceSample, buttons: &Buttons, steps: i8) {
        if let Some(sensed) = sample.gripper {
            self.sensed = true;
            self.value = sensed.clamp(0.0, 1.0);
        } else if self.sensed {
            // Not measured yet, or not now: the last value stays.
        } else if self.button.is_some() {
            self.value = if buttons.is_pressed(self.button) { 0.0 } else { 1.0 };
        } else {
            self.value = (self.value + 0.1 * f64::from(steps)).clamp(0.0, 1.0);
        }
    }
}

/// What the gripping assist does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grip {
    /// Attach the nearest rigid body that a proximity sensor of the root link sees and that is not below the root link,
    /// unless one is attached.
    Attach,
    /// Release what is attached.
    Release,
    /// Leave it as it is.
    Leave,
}

impl Grip {
    /// For an opening of 0…1. Without the assist nothing new is gripped, but what is held can be released.
    pub fn of(opening: f64, assist: bool) -> Self {
        if opening >= GRIP {
            Self::Release
        } else if assist && opening < GRIP {
            Self::Attach
        } else {
            Self::Leave
        }
    }
}

/// Position command of a joint for an opening of 0…1: `lower + opening·(upper − lower)`. `None` for a joint without
/// limits.
pub fn joint_target(opening: f64, lower: f64, upper: f64) -> Option<f64> {
    let target = lower + opening.clamp(0.0, 1.0) * (upper - lower);
    target.is_finite().then_some(target)
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    fn sample(gripper: Option<f64>, buttons: u32) -> (DeviceSample, Buttons) {
        let mut pressed = Buttons::default();
        pressed.update(buttons);
        (DeviceSample { gripper, buttons, valid: true, ..DeviceSample::none(Instant::now()) }, pressed)
    }

    fn updated(gripper: &mut Gripper, (sample, buttons): (DeviceSample, Buttons), steps: i8) -> f64 {
        gripper.update(&sample, &buttons, steps);
        gripper.value()
    }

    #[test]
    fn a_sensed_gripper_counts_first() {
        let mut gripper = Gripper::new(Some(1), true);
        assert_eq!(updated(&mut gripper, sample(None, 0b10), 1), 0.5, "not measured yet");
        assert_eq!(updated(&mut gripper, sample(Some(0.25), 0b10), 1), 0.25);
        assert_eq!(updated(&mut gripper, sample(Some(1.5), 0), 0), 1.0);
        assert_eq!(updated(&mut gripper, sample(None, 0b10), -1), 1.0);
    }

    #[test]
    fn button_zero_is_a_gripper_button() {
        let mut gripper = Gripper::new(Some(0), false);
        assert_eq!(updated(&mut gripper, sample(None, 0), 0), 1.0);
        assert_eq!(updated(&mut gripper, sample(None, 1), 1), 0.0);
    }

    #[test]
    fn without_either_the_opening_is_a_state() {
        let mut gripper = Gripper::new(None, false);
        assert_eq!(updated(&mut gripper, sample(None, 1), 0), 0.5);
        assert!((updated(&mut gripper, sample(None, 0), -1) - 0.4).abs() < 1e-12);
        for _ in 0..20 {
            updated(&mut gripper, sample(None, 0), 1);
        }
        assert_eq!(gripper.value(), 1.0);
    }

    #[test]
    fn the_assist_grips_below_one_half() {
        let of = |opening| [Grip::of(opening, true), Grip::of(opening, false)];
        assert_eq!(of(0.499), [Grip::Attach, Grip::Leave]);
        assert_eq!(of(0.5), [Grip::Release, Grip::Release]);
        assert_eq!(of(f64::NAN), [Grip::Leave, Grip::Leave]);
    }

    #[test]
    fn joints_go_from_limit_to_limit() {
        let targets = [-0.5, 0.0, 0.25, 1.0, 2.0].map(|opening| joint_target(opening, -1.0, 3.0));
        assert_eq!(targets, [-1.0, -1.0, 0.0, 3.0, 3.0].map(Some));
        assert_eq!(joint_target(0.5, f64::NEG_INFINITY, f64::INFINITY), None);
    }
}

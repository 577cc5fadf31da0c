use std::fmt;

/// What the buttons A1 and A2 do. One mode for all devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Mode {
    /// A1 is the clutch, A2 moves the cameras. The default.
    #[default]
    CameraClutch,
    /// A1 opens the gripper by 0.1, A2 closes it, for devices that neither sense a gripper nor have a button for it.
    GripperJaw,
    /// A1 raises [`Quantity::EffectorLinearGain`], A2 lowers it.
    EffectorLinearGain,
    /// The same for [`Quantity::EffectorAngularGain`].
    EffectorAngularGain,
    /// The same for [`Quantity::EffectorLinearDamping`].
    EffectorLinearDamping,
    /// The same for [`Quantity::EffectorAngularDamping`].
    EffectorAngularDamping,
    /// The same for [`Quantity::DeviceLinearGain`].
    DeviceLinearGain,
    /// The same for [`Quantity::DeviceAngularGain`].
    DeviceAngularGain,
}

impl Mode {
    /// In cyclic order; a mode's number (`mode as u8`) is its index.
    pub const ALL: [Self; 8] = [
        Self::CameraClutch,
        Self::GripperJaw,
        Self::EffectorLinearGain,
        Self::EffectorAngularGain,
        Self::EffectorLinearDamping,
        Self::EffectorAngularDamping,
        Self::DeviceLinearGain,
        Self::DeviceAngularGain,
    ];

    /// Mode of that number, counted cyclically.
    pub fn from_index(index: u8) -> Self {
        Self::ALL[usize::from(index) % Self::ALL.len()]
    }

    /// The mode `steps` further on, cyclically.
    pub fn stepped(self, steps: i8) -> Self {
        let count = Self::ALL.len() as i16;
        let index = (i16::from(self as u8) + i16::from(steps)).rem_euclid(count);
        Self::ALL[index as usize]
    }

    /// Name as the C++ program shows it.
    pub fn name(self) -> &'static str {
        match self {
            Self::CameraClutch => "CAM_CLUTCH_CONTROL",
            Self::GripperJaw => "GRIPPER_JAW_CONTROL",
            Self::EffectorLinearGain => "CHANGE_CONT_LIN_GAIN",
            Self::EffectorAngularGain => "CHANGE_CONT_ANG_GAIN",
            Self::EffectorLinearDamping => "CHANGE_CONT_LIN_DAMP",
            Self::EffectorAngularDamping => "CHANGE_CONT_ANG_DAMP",
            Self::DeviceLinearGain => "CHANGE_DEV_LIN_GAIN",
            Self::DeviceAngularGain => "CHANGE_DEV_ANG_GAIN",
        }
    }

    /// The gain that A1 and A2 change in this mode.
    pub fn quantity(self) -> Option<Quantity> {
        match self {
            Self::CameraClutch | Self::GripperJaw => None,
            Self::EffectorLinearGain => Some(Quantity::EffectorLinearGain),
            Self::EffectorAngularGain => Some(Quantity::EffectorAngularGain),
            Self::EffectorLinearDamping => Some(Quantity::EffectorLinearDamping),
            Self::EffectorAngularDamping => Some(Quantity::EffectorAngularDamping),
            Self::DeviceLinearGain => Some(Quantity::DeviceLinearGain),
            Self::DeviceAngularGain => Some(Quantity::DeviceAngularGain),
        }
    }
}

/// A gain that can be changed while the simulation runs, of all devices at once. Units: see
/// [`ControllerOutput`](ambf_model::adf::ControllerOutput) for end-effectors; N/m and N·m/rad for devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// P of the end-effector's position.
    EffectorLinearGain,
    /// P of the end-effector's orientation.
    EffectorAngularGain,
    /// D of the end-effector's position.
    EffectorLinearDamping,
    /// D of the end-effector's orientation.
    EffectorAngularDamping,
    /// P of the force that the user feels.
    DeviceLinearGain,
    /// P of the torque that the user feels.
    DeviceAngularGain,
}

impl Quantity {
    /// What a press of A1 or A2 changes it by.
    pub fn button_step(self) -> f64 {
        match self {
            Self::EffectorLinearGain => 10.0,
            Self::DeviceLinearGain => 5.0,
            _ => 1.0,
        }
    }

    /// What a key changes it by.
    pub fn key_step(self) -> f64 {
        match self {
            Self::EffectorLinearGain => 50.0,
            Self::EffectorAngularGain => 1.0,
            Self::EffectorLinearDamping | Self::EffectorAngularDamping => 0.1,
            Self::DeviceLinearGain | Self::DeviceAngularGain => 0.05,
        }
    }

    /// Changes do not lead below it.
    pub fn lower_bound(self) -> f64 {
        match self {
            Self::EffectorLinearDamping => 0.01,
            _ => 0.0,
        }
    }

    /// Name in the status text of the C++ program.
    pub fn label(self) -> &'static str {
        match self {
            Self::EffectorLinearGain => "P_lc",
            Self::EffectorAngularGain => "P_ac",
            Self::EffectorLinearDamping => "D_lc",
            Self::EffectorAngularDamping => "D_ac",
            Self::DeviceLinearGain => "K_lh",
            Self::DeviceAngularGain => "K_ah",
        }
    }
}

/// A gain of all devices is to change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GainChange {
    /// Which one.
    pub quantity: Quantity,
    /// By how much.
    pub step: f64,
}

impl GainChange {
    /// The gain after the change.
    pub(super) fn applied(self, value: f64) -> f64 {
        (value + self.step).max(self.quantity.lower_bound())
    }
}

/// What is shown of the last press of a button; its text is that of the C++ program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Status {
    /// Nothing is shown any more.
    Cleared,
    /// The clutch is pressed.
    Clutch,
    /// The button for cameras is pressed.
    Camera,
    /// A gain has a new value.
    Gain(Quantity, f64),
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cleared => Ok(()),
            Self::Clutch => f.write_str("Clutch Pressed"),
            Self::Camera => f.write_str("Cam Pressed"),
            Self::Gain(quantity, value) => write!(f, "{} = {value:.4}", quantity.label()),
        }
    }
}

/// Buttons of a device with their edges, found once per tick: a button with two roles shows its edge to both. Buttons
/// that are down when the device is seen first, or again, have no edge.
#[derive(Debug, Clone, Copy, Default)]
pub struct Buttons {
    now: u32,
    before: Option<u32>,
}

impl Buttons {
    /// Takes the mask of this tick.
    pub fn update(&mut self, mask: u32) {
        self.before = Some(self.before.map_or(mask, |_| self.now));
        self.now = mask;
    }

    /// The device is away: all are released, without edges.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Whether a button is down; no button, and none beyond 31, is.
    pub fn is_pressed(&self, button: Option<u32>) -> bool {
        bit(self.now, button)
    }

    /// Whether it went down in this tick.
    pub fn went_down(&self, button: Option<u32>) -> bool {
        bit(self.now & !self.before.unwrap_or(self.now), button)
    }

    /// Whether it went up in this tick.
    pub fn went_up(&self, button: Option<u32>) -> bool {
        bit(!self.now & self.before.unwrap_or(self.now), button)
    }
}

fn bit(mask: u32, button: Option<u32>) -> bool {
    button.and_then(|button| mask.checked_shr(button)).is_some_and(|bits| bits & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_go_round() {
        let mut mode = Mode::default();
        for expected in Mode::ALL {
            assert_eq!((mode, Mode::from_index(mode as u8)), (expected, expected));
            mode = mode.stepped(1);
        }
        assert_eq!(mode, Mode::CameraClutch);
        assert_eq!(mode.stepped(-1), Mode::DeviceAngularGain);
        assert_eq!(Mode::ALL.map(|mode| mode.stepped(i8::MIN)), Mode::ALL);
    }

    #[test]
    fn edges_are_seen_by_every_role_and_for_one_tick() {
        let mut buttons = Buttons::default();
        let (one, two) = (Some(1), Some(2));
        buttons.update(0b010);
        assert!(buttons.is_pressed(one) && !buttons.went_down(one), "down from the start");
        buttons.update(0b110);
        assert!(buttons.went_down(two) && buttons.went_down(two) && !buttons.went_down(one));
        buttons.update(0b100);
        assert!(buttons.went_up(one) && !buttons.went_down(two) && buttons.is_pressed(two));
        buttons.forget();
        buttons.update(0b1);
        assert!(!buttons.went_up(two) && !buttons.went_down(Some(0)));
    }

    #[test]
    fn buttons_that_do_not_exist_are_not_pressed() {
        let mut buttons = Buttons::default();
        buttons.update(0);
        buttons.update(u32::MAX);
        for button in [None, Some(32), Some(u32::MAX)] {
            assert!(!buttons.is_pressed(button) && !buttons.went_down(button) && !buttons.went_up(button));
        }
        assert!(buttons.went_down(Some(31)));
    }

    #[test]
    fn gains_stop_at_their_lower_bound() {
        let change = |quantity, step| GainChange { quantity, step };
        assert_eq!(change(Quantity::EffectorLinearDamping, -1.0).applied(0.5), 0.01);
        assert_eq!(change(Quantity::EffectorLinearGain, 10.0).applied(200.0), 210.0);
        assert_eq!(change(Quantity::DeviceAngularGain, -1.0).applied(0.5), 0.0);
    }

    #[test]
    fn texts_of_the_cxx_program() {
        let texts = [Status::Cleared, Status::Clutch, Status::Gain(Quantity::EffectorLinearGain, 210.0)];
        assert_eq!(texts.map(|status| status.to_string()), ["", "Clutch Pressed", "P_lc = 210.0000"]);
    }
}

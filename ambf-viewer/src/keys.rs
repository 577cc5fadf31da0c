//! What keys do, as pure functions.

use ambf_core::device::law::Quantity;
use winit::keyboard::{KeyCode, ModifiersState};

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Action {
    Close,
    ResetBodies,
    ResetCameras,
    RemovePicked,
    Pause,
    Step(u32),
    NormalMaps,
    FrameOfPicked,
    ResetWorld,
    Help,
    FullScreen,
    Mirror,
    InvertMouse,
    Picking,
    Frames,
    Sensors,
    Actuators,
    Labels,
    GrippingAssist,
    NextMode,
    CameraRotation,
    WorldRotation,
    Gravity(bool),
    Gain(Quantity, f64),
    Panels,
    Panel(usize),
    FitCamera,
    Screenshot,
    Video,
    Record,
}

/// Which of the three modifiers count: exactly one, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Held {
    Control,
    Shift,
    Alt,
    Other,
}

impl Held {
    fn of(modifiers: ModifiersState) -> Self {
        match modifiers {
            ModifiersState::CONTROL => Self::Control,
            ModifiersState::SHIFT => Self::Shift,
            ModifiersState::ALT => Self::Alt,
            _ => Self::Other,
        }
    }
}

/// What a key press asks for. The modifiers Ctrl, Shift and Alt must match exactly; with other modifiers or
/// combinations the plain bindings apply.
pub(crate) fn action(key: KeyCode, modifiers: ModifiersState) -> Option<Action> {
    use KeyCode as K;
    if matches!(key, K::Escape | K::KeyQ) {
        return Some(Action::Close);
    }
    let gain = |quantity: Quantity, sign: f64| Action::Gain(quantity, sign * quantity.key_step());
    Some(match (Held::of(modifiers), key) {
        (Held::Control, K::KeyR) => Action::ResetBodies,
        (Held::Control, K::KeyV) => Action::ResetCameras,
        (Held::Control, K::KeyX) => Action::RemovePicked,
        (Held::Control, K::KeyP) => Action::Pause,
        (Held::Control, K::Space) => Action::Step(10),
        (Held::Control, K::KeyF) => Action::FitCamera,
        (Held::Control, K::KeyS) => Action::Screenshot,
        (Held::Control, K::KeyM) => Action::Video,
        (Held::Shift, K::KeyN) => Action::NormalMaps,
        (Held::Shift, K::KeyV) => Action::FrameOfPicked,
        (Held::Shift, K::KeyR) => Action::Record,
        (Held::Alt, K::KeyR) => Action::ResetWorld,
        (Held::Alt, K::Digit1) => Action::Panel(0),
        (Held::Alt, K::Digit2) => Action::Panel(1),
        (Held::Alt, K::Digit3) => Action::Panel(2),
        (Held::Alt, K::Digit4) => Action::Panel(3),
        (Held::Alt, K::Digit5) => Action::Panel(4),
        (Held::Alt, K::Digit6) => Action::Panel(5),
        (Held::Alt, K::Digit7) => Action::Panel(6),
        (Held::Alt, K::Digit8) => Action::Panel(7),
        (_, K::F1) => Action::Panels,
        (Held::Other, key) => match key {
            K::Space => Action::Step(1),
            K::KeyH => Action::Help,
            K::KeyF => Action::FullScreen,
            K::KeyM => Action::Mirror,
            K::KeyI => Action::InvertMouse,
            K::KeyP => Action::Picking,
            K::KeyV => Action::Frames,
            K::KeyS => Action::Sensors,
            K::KeyA => Action::Actuators,
            K::KeyU => Action::Labels,
            K::KeyT => Action::GrippingAssist,
            K::KeyN => Action::NextMode,
            K::KeyC => Action::CameraRotation,
            K::KeyW => Action::WorldRotation,
            K::Digit1 => Action::Gravity(true),
            K::Digit2 => Action::Gravity(false),
            K::Digit3 => gain(Quantity::DeviceLinearGain, -1.0),
            K::Digit4 => gain(Quantity::DeviceLinearGain, 1.0),
            K::Digit5 => gain(Quantity::DeviceAngularGain, -1.0),
            K::Digit6 => gain(Quantity::DeviceAngularGain, 1.0),
            K::Digit7 => gain(Quantity::EffectorLinearGain, -1.0),
            K::Digit8 => gain(Quantity::EffectorLinearGain, 1.0),
            K::Digit9 => gain(Quantity::EffectorAngularGain, -1.0),
            K::Digit0 => gain(Quantity::EffectorAngularGain, 1.0),
            K::PageDown => gain(Quantity::EffectorLinearDamping, -1.0),
            K::PageUp => gain(Quantity::EffectorLinearDamping, 1.0),
            K::End => gain(Quantity::EffectorAngularDamping, -1.0),
            K::Home => gain(Quantity::EffectorAngularDamping, 1.0),
            _ => return None,
        },
        _ => return None,
    })
}

/// Keys and mouse buttons with what they do, in the order in which they are listed.
pub(crate) const HELP: &[(&str, &str)] = &[
    ("Esc, q", "end the simulation"),
    ("Space, Ctrl+Space", "while paused: 1 step, 10 steps"),
    ("Ctrl+P", "pause, resume"),
    ("Ctrl+R", "reset all rigid bodies"),
    ("Alt+R", "reset the world"),
    ("Ctrl+V", "reset all cameras"),
    ("Ctrl+X", "remove the body that was picked last, with its joints"),
    ("1, 2", "gravity on, off"),
    ("h", "these keys"),
    ("f", "full screen"),
    ("m", "mirror the windows top to bottom"),
    ("i", "invert the vertical direction of the mouse"),
    ("p", "picking with the left button on, off"),
    ("v, Shift+V", "frames of all objects, of the body that was picked last"),
    ("s, a", "sensors, actuators"),
    ("u", "stop the texts, let them go on"),
    ("Shift+N", "normal maps"),
    ("F1, Alt+1 … Alt+8", "panels: all of them, a single one"),
    ("Ctrl+F", "camera: fit the scene into the window"),
    ("Ctrl+S, Ctrl+M", "save a picture, a video of this window"),
    ("Shift+R", "begin a recording, at the latest with the next reset of the world; end it"),
    ("n", "next mode of the device buttons"),
    ("c, w", "hands turn tools in the camera's frame, in the world's"),
    ("t", "gripping assist"),
    ("3, 4", "linear haptic gain − 0.05, + 0.05"),
    ("5, 6", "angular haptic gain − 0.05, + 0.05"),
    ("7, 8", "linear stiffness of end-effectors − 50, + 50"),
    ("9, 0", "angular stiffness of end-effectors − 1, + 1"),
    ("PageDown, PageUp", "linear damping of end-effectors − 0.1, + 0.1"),
    ("End, Home", "angular damping of end-effectors − 0.1, + 0.1"),
    ("left drag", "pan, or with picking on: pick and drag"),
    ("Ctrl + left drag", "pick and drag"),
    ("right drag", "look around"),
    ("middle drag", "orbit about the point that is looked at; with Shift: pan"),
    ("wheel", "move along the view"),
    ("left Shift", "a tenth of every motion"),
    ("drop a file", "load it as a model (.yaml, .ambf)"),
];

/// Number of a key in GLFW, which plugins know; -1 for others.
pub(crate) fn glfw_key(key: KeyCode) -> i32 {
    use KeyCode as K;
    const LETTERS: [KeyCode; 26] = [
        K::KeyA,
        K::KeyB,
        K::KeyC,
        K::KeyD,
        K::KeyE,
        K::KeyF,
        K::KeyG,
        K::KeyH,
        K::KeyI,
        K::KeyJ,
        K::KeyK,
        K::KeyL,
        K::KeyM,
        K::KeyN,
        K::KeyO,
        K::KeyP,
        K::KeyQ,
        K::KeyR,
        K::KeyS,
        K::KeyT,
        K::KeyU,
        K::KeyV,
        K::KeyW,
        K::KeyX,
        K::KeyY,
        K::KeyZ,
    ];
    const DIGITS: [KeyCode; 10] =
        [K::Digit0, K::Digit1, K::Digit2, K::Digit3, K::Digit4, K::Digit5, K::Digit6, K::Digit7, K::Digit8, K::Digit9];
    const FUNCTIONS: [KeyCode; 12] =
        [K::F1, K::F2, K::F3, K::F4, K::F5, K::F6, K::F7, K::F8, K::F9, K::F10, K::F11, K::F12];
    const NUMPAD: [KeyCode; 17] = [
        K::Numpad0,
        K::Numpad1,
        K::Numpad2,
        K::Numpad3,
        K::Numpad4,
        K::Numpad5,
        K::Numpad6,
        K::Numpad7,
        K::Numpad8,
        K::Numpad9,
        K::NumpadDecimal,
        K::NumpadDivide,
        K::NumpadMultiply,
        K::NumpadSubtract,
        K::NumpadAdd,
        K::NumpadEnter,
        K::NumpadEqual,
    ];
    for (first, keys) in [(65, &LETTERS[..]), (48, &DIGITS[..]), (290, &FUNCTIONS[..]), (320, &NUMPAD[..])] {
        if let Some(place) = keys.iter().position(|other| *other == key) {
            return first + place as i32;
        }
    }
    match key {
        K::Space => 32,
        K::Quote => 39,
        K::Comma => 44,
        K::Minus => 45,
        K::Period => 46,
        K::Slash => 47,
        K::Semicolon => 59,
        K::Equal => 61,
        K::BracketLeft => 91,
        K::Backslash => 92,
        K::BracketRight => 93,
        K::Backquote => 96,
        K::Escape => 256,
        K::Enter => 257,
        K::Tab => 258,
        K::Backspace => 259,
        K::Insert => 260,
        K::Delete => 261,
        K::ArrowRight => 262,
        K::ArrowLeft => 263,
        K::ArrowDown => 264,
        K::ArrowUp => 265,
        K::PageUp => 266,
        K::PageDown => 267,
        K::Home => 268,
        K::End => 269,
        K::CapsLock => 280,
        K::ScrollLock => 281,
        K::NumLock => 282,
        K::PrintScreen => 283,
        K::Pause => 284,
        K::ShiftLeft => 340,
        K::ControlLeft => 341,
        K::AltLeft => 342,
        K::SuperLeft => 343,
        K::ShiftRight => 344,
        K::ControlRight => 345,
        K::AltRight => 346,
        K::SuperRight => 347,
        K::ContextMenu => 348,
        _ => -1,
    }
}

/// Modifiers as GLFW numbers them: Shift 1, Ctrl 2, Alt 4, Super 8.
pub(crate) fn glfw_modifiers(modifiers: ModifiersState) -> i32 {
    i32::from(modifiers.shift_key())
        | i32::from(modifiers.control_key()) << 1
        | i32::from(modifiers.alt_key()) << 2
        | i32::from(modifiers.super_key()) << 3
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: ModifiersState = ModifiersState::empty();
    const CONTROL: ModifiersState = ModifiersState::CONTROL;
    const SHIFT: ModifiersState = ModifiersState::SHIFT;

    #[test]
    fn modifiers_must_match_exactly() {
        assert_eq!(action(KeyCode::KeyP, NONE), Some(Action::Picking));
        assert_eq!(action(KeyCode::KeyP, CONTROL), Some(Action::Pause));
        assert_eq!(action(KeyCode::KeyP, SHIFT), None);
        assert_eq!(action(KeyCode::KeyP, CONTROL | SHIFT), Some(Action::Picking), "combinations count as none");
        assert_eq!(action(KeyCode::KeyR, NONE), None);
        assert_eq!(action(KeyCode::KeyR, ModifiersState::ALT), Some(Action::ResetWorld));
        assert_eq!(action(KeyCode::KeyR, SHIFT), Some(Action::Record));
        assert_eq!(action(KeyCode::KeyR, ModifiersState::SUPER), None);
        assert_eq!(action(KeyCode::KeyV, ModifiersState::SUPER), Some(Action::Frames));
    }

    #[test]
    fn closing_needs_no_modifier_and_minds_none() {
        for modifiers in [NONE, CONTROL, SHIFT, ModifiersState::ALT | CONTROL] {
            assert_eq!(action(KeyCode::KeyQ, modifiers), Some(Action::Close));
            assert_eq!(action(KeyCode::Escape, modifiers), Some(Action::Close));
        }
    }

    #[test]
    fn gains_change_by_the_steps_of_the_cxx_program() {
        let step = |key| match action(key, NONE) {
            Some(Action::Gain(quantity, step)) => (quantity.label(), step),
            other => panic!("{other:?}"),
        };
        assert_eq!(step(KeyCode::Digit3), ("K_lh", -0.05));
        assert_eq!(step(KeyCode::Digit6), ("K_ah", 0.05));
        assert_eq!(step(KeyCode::Digit8), ("P_lc", 50.0));
        assert_eq!(step(KeyCode::Digit9), ("P_ac", -1.0));
        assert_eq!(step(KeyCode::PageUp), ("D_lc", 0.1));
        assert_eq!(step(KeyCode::End), ("D_ac", -0.1));
    }

    #[test]
    fn plugins_get_the_numbers_of_glfw() {
        let numbers = [KeyCode::KeyA, KeyCode::KeyZ, KeyCode::Digit9, KeyCode::F12, KeyCode::NumpadEqual, KeyCode::Fn];
        assert_eq!(numbers.map(glfw_key), [65, 90, 57, 301, 336, -1]);
        assert_eq!(glfw_modifiers(CONTROL | SHIFT), 3);
        assert_eq!(glfw_modifiers(ModifiersState::ALT | ModifiersState::SUPER), 12);
    }
}

//! Names of keys.

/// Name of a key of [`SimulatorPlugin::keyboard_update`](super::SimulatorPlugin::keyboard_update) on a US keyboard,
/// such as `A`, `7`, `F1`, `Space`, `LeftShift`, `Keypad0`; `None` for −1 and other numbers that GLFW gives to no key.
pub fn key_name(key: i32) -> Option<&'static str> {
    const LETTERS: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZ";
    const DIGITS: &str = "0123456789";
    const FUNCTIONS: [&str; 12] = ["F1", "F2", "F3", "F4", "F5", "F6", "F7", "F8", "F9", "F10", "F11", "F12"];
    const KEYPAD: [&str; 17] = [
        "Keypad0",
        "Keypad1",
        "Keypad2",
        "Keypad3",
        "Keypad4",
        "Keypad5",
        "Keypad6",
        "Keypad7",
        "Keypad8",
        "Keypad9",
        "KeypadDecimal",
        "KeypadDivide",
        "KeypadMultiply",
        "KeypadSubtract",
        "KeypadAdd",
        "KeypadEnter",
        "KeypadEqual",
    ];
    let from = |first: i32| usize::try_from(key - first).unwrap_or_default();
    let letter = |all: &'static str, first: i32| all.get(from(first)..=from(first));
    match key {
        32 => Some("Space"),
        39 => Some("Apostrophe"),
        44 => Some("Comma"),
        45 => Some("Minus"),
        46 => Some("Period"),
        47 => Some("Slash"),
        48..=57 => letter(DIGITS, 48),
        59 => Some("Semicolon"),
        61 => Some("Equal"),
        65..=90 => letter(LETTERS, 65),
        91 => Some("LeftBracket"),
        92 => Some("Backslash"),
        93 => Some("RightBracket"),
        96 => Some("GraveAccent"),
        256 => Some("Escape"),
        257 => Some("Enter"),
        258 => Some("Tab"),
        259 => Some("Backspace"),
        260 => Some("Insert"),
        261 => Some("Delete"),
        262 => Some("Right"),
        263 => Some("Left"),
        264 => Some("Down"),
        265 => Some("Up"),
        266 => Some("PageUp"),
        267 => Some("PageDown"),
        268 => Some("Home"),
        269 => Some("End"),
        280 => Some("CapsLock"),
        281 => Some("ScrollLock"),
        282 => Some("NumLock"),
        283 => Some("PrintScreen"),
        284 => Some("Pause"),
        290..=301 => FUNCTIONS.get(from(290)).copied(),
        320..=336 => KEYPAD.get(from(320)).copied(),
        340 => Some("LeftShift"),
        341 => Some("LeftControl"),
        342 => Some("LeftAlt"),
        343 => Some("LeftSuper"),
        344 => Some("RightShift"),
        345 => Some("RightControl"),
        346 => Some("RightAlt"),
        347 => Some("RightSuper"),
        348 => Some("Menu"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_names_and_no_two_the_same() {
        let some = [32, 65, 90, 48, 57, 290, 301, 320, 336, 340];
        let names = ["Space", "A", "Z", "0", "9", "F1", "F12", "Keypad0", "KeypadEqual", "LeftShift"];
        assert_eq!(some.map(|key| key_name(key).unwrap_or("none")), names);
        let mut all: Vec<_> = (-10..400).filter_map(key_name).collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!((all.len(), count), (105, 105));
        assert_eq!([-1, 0, 302, i32::MIN, i32::MAX].map(key_name), [None; 5]);
    }
}

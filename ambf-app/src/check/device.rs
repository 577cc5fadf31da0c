//! What is worth saying about input devices.

use std::path::Path;

use ambf_core::adf::InputDevice;
use ambf_core::scene::{read_model, NameMap};

use super::finding::Level;
use super::original;
use super::pass::Pass;

/// What the C++ program does differently with a device.
pub(super) fn differences(pass: &mut Pass<'_>, device: &InputDevice) {
    let Some(entry) = pass.entry(&device.identifier) else { return };
    let identifier = &device.identifier;
    if device.max_force.is_some() {
        pass.differs(&original::MAX_FORCE, identifier);
    }
    if entry.get("deadband").is_none() {
        pass.differs(&original::DEADBAND, identifier);
    }
    if device.haptic_gain.is_none() {
        pass.differs(&original::HAPTIC_GAIN, identifier);
    }
    let own = ["driver", "identity", "driver settings", "enable on button", "time scaled gain"];
    if own.iter().any(|key| entry.get(key).is_some()) {
        pass.differs(&original::DEVICE_KEY, identifier);
    }
    let buttons = entry.get("button mapping");
    let all = ["a1", "a2", "next mode", "prev mode"];
    if all.iter().any(|key| buttons.is_none_or(|buttons| buttons.get(key).is_none())) {
        pass.differs(&original::BUTTONS, identifier);
    }
    if device.button_mapping.g1 == Some(0) {
        pass.differs(&original::BUTTON_ZERO, identifier);
    }
}

/// The root link of a device has to be a body of its model.
pub(super) fn root_link(pass: &mut Pass<'_>, device: &InputDevice, path: &Path) {
    let Some(link) = &device.root_link else { return };
    let Ok((model, _)) = read_model(path) else { return };
    let mut names = NameMap::default();
    for (index, body) in model.bodies.iter().enumerate() {
        names.insert(&format!("{}{}", body.common.namespace, body.common.identifier), index);
    }
    let qualified = format!("{}{link}", model.namespace);
    if names.exact(&qualified).is_none() && names.find(link).id().is_none() {
        let entry = pass.entry(&device.identifier).and_then(|entry| entry.get("root link"));
        let place = entry.map_or_else(|| device.source.clone(), |entry| entry.source());
        let sentence = format!("is `{link}`, which is no body of {}, or part of several", path.display());
        pass.say(Level::Warning, "root link", place, &[&device.identifier, "root link"], &sentence);
    }
}

//! What is known of the devices that the HD library serves.

use ambf_device::{Axes, DeviceSpec};

/// A row of the table: model as the library names it, N, N·m, N/m, N·m/rad, N·s/m, N·m·s/rad, m, m along z.
struct Model {
    name: &'static str,
    max_force: f64,
    max_torque: f64,
    max_stiffness: f64,
    max_angular_stiffness: f64,
    max_damping: f64,
    max_angular_damping: f64,
    workspace_radius: f64,
    offset: f64,
}

const fn arm(name: &'static str, max_force: f64, max_stiffness: f64, max_damping: f64, workspace_radius: f64) -> Model {
    Model {
        name,
        max_force,
        max_torque: 0.0,
        max_stiffness,
        max_angular_stiffness: 0.0,
        max_damping,
        max_angular_damping: 0.0,
        workspace_radius,
        offset: 0.0,
    }
}

const fn premium(name: &'static str, max_force: f64, max_stiffness: f64, workspace_radius: f64, offset: f64) -> Model {
    Model {
        max_torque: 0.188,
        max_angular_stiffness: 0.3,
        max_angular_damping: 0.004,
        offset,
        ..arm(name, max_force, max_stiffness, 5.0, workspace_radius)
    }
}

/// Numbers of the original's table of devices.
const MODELS: [Model; 5] = [
    arm("Touch", 3.3, 400.0, 4.0, 0.075),
    arm("PHANTOM Omni", 3.3, 700.0, 5.0, 0.10),
    arm("PHANTOM Desktop", 7.9, 1000.0, 5.0, 0.10),
    premium("PHANTOM Premium 1.5 6DOF", 8.5, 800.0, 0.12, -0.10),
    premium("PHANTOM Premium 3.0 6DOF", 22.0, 1000.0, 0.25, 0.0),
];

/// Any other of the family.
const OTHER: Model = arm("", 6.0, 1000.0, 8.0, 0.0);

/// Whether a model is one that the HD library serves: those of the table, and whatever else is called Touch or Phantom.
pub(crate) fn serves(model: &str) -> bool {
    let model = model.trim().to_ascii_lowercase();
    model == "touch" || model.starts_with("touch ") || model.starts_with("phantom")
}

/// What the library says of a device.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Facts {
    pub model: String,
    pub vendor: String,
    pub serial: String,
    /// N; not finite or 0: not known.
    pub max_force: f64,
    /// Corners of the usable workspace, mm: three smallest, three largest coordinates.
    pub workspace: [f64; 6],
}

/// Specification of a device, and how far along z its origin is from that of the library, m.
pub(crate) fn spec(facts: &Facts) -> (DeviceSpec, f64) {
    let known = MODELS.iter().find(|model| model.name == facts.model);
    let row = known.unwrap_or(&OTHER);
    let diagonal = (0..3).map(|i| (facts.workspace[i + 3] - facts.workspace[i]).powi(2)).sum::<f64>().sqrt();
    let measured = 0.5 * diagonal * 1e-3;
    let six = row.max_torque > 0.0;
    let spec = DeviceSpec {
        manufacturer: if facts.vendor.is_empty() { String::from("3D Systems") } else { facts.vendor.clone() },
        // The device knows best what it cannot bear.
        max_force: if facts.max_force > 0.0 { row.max_force.min(facts.max_force) } else { row.max_force },
        max_torque: row.max_torque,
        max_gripper_force: 0.0,
        max_stiffness: row.max_stiffness,
        max_angular_stiffness: row.max_angular_stiffness,
        max_gripper_stiffness: 0.0,
        max_damping: row.max_damping,
        max_angular_damping: row.max_angular_damping,
        max_gripper_damping: 0.0,
        workspace_radius: match known {
            Some(model) => model.workspace_radius,
            None if measured > 0.0 && measured.is_finite() => measured,
            None => 0.1,
        },
        gripper_max_angle: 0.0,
        sensed: Axes { position: true, rotation: true, gripper: false },
        actuated: Axes { position: true, rotation: six, gripper: false },
        left_hand: true,
        right_hand: true,
        ..DeviceSpec::unknown(&facts.model)
    };
    (spec, row.offset)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(model: &str) -> Facts {
        let workspace = [-80.0, -60.0, -35.0, 80.0, 60.0, 35.0];
        Facts { model: model.into(), vendor: String::new(), serial: String::new(), max_force: f64::NAN, workspace }
    }

    #[test]
    fn known_models_have_the_numbers_of_the_table() {
        let (spec, offset) = spec(&facts("Touch"));
        assert_eq!((spec.max_force, spec.max_stiffness, spec.workspace_radius, offset), (3.3, 400.0, 0.075, 0.0));
        assert!(!spec.actuated.rotation && spec.sensed.rotation);
        let (premium, offset) = super::spec(&facts("PHANTOM Premium 1.5 6DOF"));
        assert_eq!((premium.max_torque, offset), (0.188, -0.10));
        assert!(premium.actuated.rotation);
    }

    #[test]
    fn other_phantoms_measure_their_workspace() {
        let (spec, _) = spec(&facts("PHANTOM Premium 1.0"));
        assert_eq!((spec.max_force, spec.max_stiffness), (6.0, 1000.0));
        assert!((spec.workspace_radius - 0.10595).abs() < 1e-5, "{}", spec.workspace_radius);
    }

    #[test]
    fn a_device_may_lower_its_limit_but_not_raise_it() {
        let limit = |max_force| spec(&Facts { max_force, ..facts("Touch") }).0.max_force;
        assert_eq!([limit(2.5), limit(9.0), limit(0.0), limit(f64::NAN)], [2.5, 3.3, 3.3, 3.3]);
    }

    #[test]
    fn the_family_is_known_by_name() {
        assert!(["Touch", "Touch X", "PHANTOM Omni", "Phantom Premium 1.5"].iter().all(|model| serves(model)));
        assert!(!["Falcon", "MTMR", "Touchpad", "Razer Hydra"].iter().any(|model| serves(model)));
    }
}

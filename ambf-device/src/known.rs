//! What is known of devices by their model names.

use super::{Axes, DeviceSpec};

/// Degrees of an open gripper of devices that sense one.
const GRIPPER_DEGREES: f64 = 30.0;

/// Numbers of one model; the rest follows from them.
struct Model {
    name: &'static str,
    manufacturer: &'static str,
    /// N, N·m.
    force: f64,
    torque: f64,
    /// N/m, N·m/rad.
    stiffness: f64,
    angular_stiffness: f64,
    /// N·s/m, N·m·s/rad.
    damping: f64,
    angular_damping: f64,
    /// m.
    radius: f64,
    senses_rotation: bool,
    senses_gripper: bool,
    moves_rotation: bool,
    /// N, N/m, N·s/m of an actuated gripper.
    gripper: Option<[f64; 3]>,
}

const BASE: Model = Model {
    name: "",
    manufacturer: "",
    force: 0.0,
    torque: 0.0,
    stiffness: 1000.0,
    angular_stiffness: 0.0,
    damping: 0.0,
    angular_damping: 0.0,
    radius: 0.1,
    senses_rotation: true,
    senses_gripper: false,
    moves_rotation: false,
    gripper: None,
};

const DVRK: Model = Model {
    manufacturer: "Intuitive Surgical",
    force: 5.0,
    torque: 0.1,
    angular_stiffness: 1.0,
    damping: 20.0,
    radius: 0.2,
    senses_gripper: true,
    ..BASE
};
const PHANTOM: Model = Model { manufacturer: "3D Systems", force: 6.0, damping: 8.0, ..BASE };
const PREMIUM: Model = Model {
    torque: 0.188,
    angular_stiffness: 0.3,
    damping: 5.0,
    angular_damping: 0.004,
    moves_rotation: true,
    ..PHANTOM
};
const OMEGA: Model =
    Model { manufacturer: "Force Dimension", force: 12.0, stiffness: 5000.0, damping: 30.0, radius: 0.075, ..BASE };
const SIGMA: Model = Model {
    torque: 0.2,
    stiffness: 4000.0,
    angular_stiffness: 1.0,
    angular_damping: 0.07,
    moves_rotation: true,
    ..OMEGA
};
const HYDRA: Model =
    Model { manufacturer: "Sixense", angular_stiffness: 1.0, radius: 0.5, senses_gripper: true, ..BASE };

const MODELS: &[Model] = &[
    Model { name: "MTMR", ..DVRK },
    Model { name: "MTML", ..DVRK },
    Model {
        name: "Falcon",
        manufacturer: "Novint",
        force: 8.0,
        stiffness: 3000.0,
        damping: 20.0,
        radius: 0.04,
        senses_rotation: false,
        ..BASE
    },
    Model { name: "Touch", force: 3.3, stiffness: 400.0, damping: 4.0, radius: 0.075, ..PHANTOM },
    Model { name: "PHANTOM Omni", force: 3.3, stiffness: 700.0, damping: 5.0, ..PHANTOM },
    Model { name: "PHANTOM Desktop", force: 7.9, damping: 5.0, ..PHANTOM },
    Model { name: "PHANTOM Premium 1.5 6DOF", force: 8.5, stiffness: 800.0, radius: 0.12, ..PREMIUM },
    Model { name: "PHANTOM Premium 3.0 6DOF", force: 22.0, radius: 0.25, ..PREMIUM },
    Model { name: "omega.3", senses_rotation: false, ..OMEGA },
    Model { name: "omega.6", ..OMEGA },
    Model { name: "omega.7", senses_gripper: true, gripper: Some([8.0, 2000.0, 0.5]), ..OMEGA },
    Model { name: "delta.3", force: 20.0, radius: 0.15, senses_rotation: false, ..OMEGA },
    Model {
        name: "delta.6",
        force: 20.0,
        torque: 0.2,
        angular_stiffness: 1.0,
        radius: 0.15,
        moves_rotation: true,
        ..OMEGA
    },
    Model { name: "sigma.7", senses_gripper: true, gripper: Some([8.0, 2000.0, 0.5]), ..SIGMA },
    Model { name: "sigma.6+", radius: 0.09, ..SIGMA },
    Model { name: "Razer Hydra", ..HYDRA },
    Model { name: "Razor Hydra", ..HYDRA },
    Model { name: "Leap Motion", manufacturer: "Leap Motion", senses_gripper: false, ..HYDRA },
];

/// What a device of that model can do; `None` for a model that is not known. Names that begin with `PHANTOM` are all
/// known. The match is exact, as that of `hardware name`.
pub fn spec(model: &str) -> Option<DeviceSpec> {
    let known = MODELS.iter().find(|known| known.name == model);
    let of = known.or_else(|| model.starts_with("PHANTOM").then_some(&PHANTOM))?;
    // The gripper of a master arm is sensed, not moved, and still rated.
    let arm = of.manufacturer == DVRK.manufacturer;
    let [grip, grip_stiffness, grip_damping] = if arm { [3.0, 1000.0, 0.0] } else { of.gripper.unwrap_or_default() };
    let angle = match (of.senses_gripper, arm) {
        (true, true) => 60.0,
        (true, false) => GRIPPER_DEGREES,
        (false, _) => 0.0,
    };
    Some(DeviceSpec {
        model: model.to_owned(),
        manufacturer: of.manufacturer.to_owned(),
        max_force: of.force,
        max_torque: of.torque,
        max_gripper_force: grip,
        max_stiffness: of.stiffness,
        max_angular_stiffness: of.angular_stiffness,
        max_gripper_stiffness: grip_stiffness,
        max_damping: of.damping,
        max_angular_damping: of.angular_damping,
        max_gripper_damping: grip_damping,
        workspace_radius: of.radius,
        gripper_max_angle: f64::to_radians(angle),
        sensed: Axes { position: true, rotation: of.senses_rotation, gripper: of.senses_gripper },
        actuated: Axes { position: of.force > 0.0, rotation: of.moves_rotation, gripper: of.gripper.is_some() },
        left_hand: model != "MTMR",
        right_hand: model != "MTML",
        start_up_hold: if model == "Razer Hydra" { 5.0 } else { 3.0 },
    })
}

/// Names of the models that are known.
pub fn models() -> impl Iterator<Item = &'static str> {
    MODELS.iter().map(|model| model.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_exact_and_occur_once() {
        let mut names: Vec<_> = models().collect();
        assert!(names.iter().all(|name| spec(name).is_some_and(|spec| spec.model == *name)));
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), MODELS.len());
        assert!(spec("falcon").is_none() && spec("").is_none());
    }

    #[test]
    fn numbers_of_the_table() {
        let falcon = spec("Falcon").expect("known");
        assert_eq!((falcon.max_force, falcon.max_stiffness, falcon.workspace_radius), (8.0, 3000.0, 0.04));
        assert_eq!(falcon.sensed, Axes { position: true, rotation: false, gripper: false });
        let arm = spec("MTML").expect("known");
        assert_eq!((arm.max_torque, arm.max_gripper_force, arm.left_hand, arm.right_hand), (0.1, 3.0, true, false));
        assert_eq!((arm.gripper_max_angle.to_degrees().round(), arm.actuated.gripper), (60.0, false));
        let sigma = spec("sigma.7").expect("known");
        assert_eq!((sigma.max_angular_damping, sigma.max_gripper_stiffness), (0.07, 2000.0));
        assert_eq!(sigma.actuated, Axes { position: true, rotation: true, gripper: true });
        let hydra = spec("Razer Hydra").expect("known");
        assert_eq!((hydra.start_up_hold, hydra.max_force, hydra.actuated), (5.0, 0.0, Axes::default()));
        assert_eq!(spec("PHANTOM Premium 1.0").expect("any").max_force, 6.0);
        assert_eq!(spec("PHANTOM Premium 3.0 6DOF").expect("known").max_force, 22.0);
    }
}

//! Broken elements: each gives a message with its place and is dropped, and the others live.

use crate::physics_common::{load_texts, DT, HEAVY};
use ambf_core::ids::BodyId;
use ambf_core::scene::Loaded;
use ambf_core::sim::Simulation;

const GOOD: &str = "BODY Good: {name: Good, mass: 1, damping: {linear: 0, angular: 0}}\n\
                    BODY Other: {name: Other, mass: 1, damping: {linear: 0, angular: 0}}\n";

/// Loads bodies Good, Other and what `more` adds; demands one error or more that holds `parts`, and that the good
/// bodies fall.
fn survives(lists: &str, more: &str, parts: &[&str]) -> Simulation {
    let text = format!("{lists}\n{GOOD}{more}");
    let Loaded { scene, report } = load_texts(HEAVY, &[&text]);
    let message = report.to_string();
    assert!(report.errors() > 0, "no error: {message}");
    for part in parts {
        assert!(message.contains(part), "`{part}` is missing in: {message}");
    }
    let mut simulation = Simulation::new(scene, DT);
    for _ in 0..100 {
        simulation.update(DT).unwrap_or_else(|error| panic!("{error}"));
    }
    let scene = simulation.scene();
    for name in ["Good", "Other"] {
        let body = scene
            .bodies
            .iter()
            .position(|body| *body.identity.name == *name)
            .unwrap_or_else(|| panic!("{name} is lost"));
        let (velocity, _) = scene.world.velocity(scene.world.bodies()[body]).expect("live");
        assert!((velocity.z + 1.0).abs() < 1e-9, "{name} does not fall: {velocity}");
    }
    simulation
}

fn joint(keys: &str) -> String {
    let mut text = String::from("J: {name: J, type: revolute, ");
    for key in
        ["parent: BODY Good", "child: BODY Other", "parent axis: {x: 0, y: 0, z: 1}", "child axis: {x: 0, y: 0, z: 1}"]
    {
        let name = key.split(':').next().expect("a key");
        if !keys.contains(&format!("{name}:")) {
            text += key;
            text += ", ";
        }
    }
    text + keys + ", parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}}\n"
}

const TWO: &str = "bodies: [BODY Good, BODY Other]";
const WITH_JOINT: &str = "bodies: [BODY Good, BODY Other]\njoints: [J]";
const WITH_BODY: &str = "bodies: [BODY Good, BODY Bad, BODY Other]";

#[test]
fn a_joint_with_a_dangling_end_is_dropped() {
    for (end, keys) in [("parent", "parent: BODY Nobody"), ("child", "child: BODY Nobody")] {
        let simulation = survives(WITH_JOINT, &joint(keys), &["m0.yaml:5", "J", end, "BODY Nobody"]);
        assert!(simulation.scene().joints.is_empty());
    }
}

#[test]
fn a_joint_of_a_body_with_itself_is_dropped() {
    let simulation = survives(WITH_JOINT, &joint("child: BODY Good"), &["m0.yaml:5", "itself"]);
    assert!(simulation.scene().joints.is_empty());
}

#[test]
fn a_joint_with_a_zero_axis_is_dropped() {
    for key in ["parent axis", "child axis"] {
        let simulation = survives(WITH_JOINT, &joint(&format!("{key}: {{x: 0, y: 0, z: 0}}")), &["m0.yaml:5", key]);
        assert!(simulation.scene().joints.is_empty());
    }
}

#[test]
fn a_joint_of_unknown_type_constrains_nothing() {
    let text = joint("joint erp: 0.1").replace("type: revolute", "type: magic");
    let simulation = survives(WITH_JOINT, &text, &["m0.yaml:5", "magic"]);
    assert!(simulation.scene().world.constraints().is_empty());
}

#[test]
fn bodies_with_impossible_numbers_are_dropped() {
    for (keys, part) in [
        ("mass: -1", "mass"),
        ("mass: .nan", "mass"),
        ("mass: .inf", "mass"),
        ("mass: 1, inertia: {ix: -1, iy: 1, iz: 1}", "inertia"),
        ("mass: 1, inertia: {ix: .nan, iy: 1, iz: 1}", "ix"),
        ("mass: 1, location: {position: {x: .nan, y: 0, z: 0}}", "x"),
        ("mass: 1, location: {position: {x: 0, y: 0, z: 0}, orientation: {r: .inf, p: 0, y: 0}}", "r"),
        ("mass: 1, collision shape: Sphere, collision geometry: {radius: -1}", "radius"),
        ("mass: 1, collision shape: Sphere, collision geometry: {radius: .nan}", "radius"),
        ("mass: 1, scale: 0", "scale"),
    ] {
        let simulation = survives(WITH_BODY, &format!("BODY Bad: {{name: Bad, {keys}}}\n"), &["m0.yaml:4", part]);
        // Dropped, or alive with a sane number in the place of the bad one; never alive and not finite.
        for body in simulation.scene().bodies.iter() {
            let numbers = body.inertia.iter().chain([&body.mass]).chain(body.initial_pose.translation.vector.iter());
            assert!(numbers.copied().all(f64::is_finite) && body.mass >= 0.0, "{keys}: {body:?}");
        }
    }
}

#[test]
fn a_file_with_a_text_for_a_number_is_refused_and_the_others_live() {
    for value in ["heavy", "1e999", "[1]"] {
        let bad = format!("bodies: [BODY Bad]\nBODY Bad: {{name: Bad, mass: {value}}}\n");
        let good = format!("{TWO}\n{GOOD}");
        let Loaded { scene, report } = load_texts(HEAVY, &[&bad, &good]);
        assert!(report.to_string().contains("m0.yaml:2") && report.refused.len() == 1, "{value}: {report}");
        assert_eq!(
            scene.bodies.iter().map(|body| body.identity.communication_name()).collect::<Vec<_>>(),
            ["Good", "Other"],
            "{value}"
        );
    }
}

#[test]
fn a_body_that_is_listed_but_not_defined_is_said_and_replaced() {
    let simulation = survives(WITH_BODY, "", &["m0.yaml:1", "BODY Bad", "not defined"]);
    // An unnamed one, as in the C++ program.
    let body = &simulation.scene().bodies[BodyId::new(1)];
    assert_eq!((&*body.identity.name, body.mass), ("", 1.0));
}

#[test]
fn a_body_without_its_mesh_is_dropped_with_its_joints() {
    let body = "BODY Bad: {name: Bad, mass: 1, mesh: nowhere.stl, collision shape type: CONVEX_HULL}\n";
    let lists =
        "high resolution path: ./\nlow resolution path: ./\nbodies: [BODY Good, BODY Bad, BODY Other]\njoints: [J]";
    let simulation = survives(
        lists,
        &(body.to_owned() + &joint("parent: BODY Bad")),
        &["m0.yaml:7", "nowhere.stl", "m0.yaml:8", "J"],
    );
    assert_eq!((simulation.scene().bodies.len(), simulation.scene().joints.len()), (2, 0));
}

#[test]
fn a_key_that_is_written_twice_is_said() {
    let text = format!("{TWO}\n{GOOD}BODY Good: {{name: Again, mass: 3}}\n");
    let Loaded { scene, report } = load_texts(HEAVY, &[&text]);
    assert!(report.to_string().contains("BODY Good"), "silent: {report}");
    assert_eq!(
        scene.bodies.iter().find(|body| body.identity.identifier == "BODY Good").expect("one of them").identity.name,
        "Good".into()
    );
    assert_eq!(scene.bodies.len(), 2);
}

#[test]
fn bodies_of_one_name_live_beside_each_other() {
    let text = "bodies: [BODY A, BODY B]\nBODY A: {name: Same, mass: 1}\nBODY B: {name: Same, mass: 2}\n";
    let Loaded { scene, report } = load_texts(HEAVY, &[text]);
    assert_eq!(report.errors(), 0, "{report}");
    assert_eq!(scene.bodies.iter().map(|body| body.mass).collect::<Vec<_>>(), [1.0, 2.0]);
}

#[test]
fn a_state_that_is_lost_is_reported_with_body_and_step() {
    let text = "bodies: [BODY A, BODY B]\njoints: [J]\n\
                BODY A: {name: A, mass: 1}\nBODY B: {name: B, mass: 1, inertia: {ix: 1, iy: 1, iz: 1}}\n\
                J: {name: J, type: p2p, parent: BODY A, child: BODY B, parent axis: {x: 0, y: 0, z: 1}, \
                child axis: {x: 0, y: 0, z: 1}, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}}\n";
    let Loaded { scene, report } = load_texts(HEAVY, &[text]);
    assert_eq!(report.errors(), 0, "{report}");
    let mut simulation = Simulation::new(scene, DT);
    simulation.update(DT).expect("sane");
    simulation.set_velocity(BodyId::new(1), nalgebra::Vector3::repeat(1e308), nalgebra::Vector3::repeat(1e308));
    let lost = (0..100).find_map(|_| simulation.update(DT).err()).expect("1e308 m/s cannot last");
    assert!(lost.step >= 2 && lost.body.contains("BODY "), "{lost}");
    assert_eq!(lost.joint.as_deref(), Some("J"));
}

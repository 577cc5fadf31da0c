//! What each kind of command does, against what mechanics says it must do. No gravity, no damping, no contact.

mod batch_common;

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use batch_common::{close, Folder};

/// A free body, a static one.
const FREE: &str = "bodies: [BODY Free, BODY Fixed]\n\
    BODY Free: {name: Free, mass: 2, inertia: {ix: 0.1, iy: 0.2, iz: 0.4}, damping: {linear: 0, angular: 0}}\n\
    BODY Fixed: {name: Fixed, mass: 0, location: {position: {x: 5, y: 0, z: 0}}, \
    inertial offset: {position: {x: 0, y: 0, z: 0.3}}}\n";

/// A block that turns about z at 0.5 m from its centre of mass, and one that slides along y.
const JOINTS: &str = "bodies: [BODY Base, BODY Arm, BODY Cart]\njoints: [JOINT Turn, JOINT Slide]\n\
    BODY Base: {name: Base, mass: 0}\n\
    BODY Arm: {name: Arm, mass: 2, inertia: {ix: 0.1, iy: 0.1, iz: 0.1}, location: {position: {x: 0.5, y: 0, z: 0}}, \
    damping: {linear: 0, angular: 0}}\n\
    BODY Cart: {name: Cart, mass: 4, inertia: {ix: 0.1, iy: 0.1, iz: 0.1}, location: {position: {x: 0, y: 1, z: 0}}, \
    damping: {linear: 0, angular: 0}}\n\
    JOINT Turn: {name: Turn, parent: BODY Base, child: BODY Arm, type: revolute, parent axis: {x: 0, y: 0, z: 1}, \
    child axis: {x: 0, y: 0, z: 1}, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: -0.5, y: 0, z: 0}TURN}\n\
    JOINT Slide: {name: Slide, parent: BODY Base, child: BODY Cart, type: prismatic, parent axis: {x: 0, y: 1, z: 0}, \
    child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0, y: 1, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
    joint limits: {low: -3, high: 3}SLIDE}\n";

/// Moment of inertia of the arm about its joint, kg·m².
const ARM: f64 = 0.1 + 2.0 * 0.5 * 0.5;

fn joints(turn: &str, slide: &str) -> String {
    JOINTS.replace("TURN", turn).replace("SLIDE", slide)
}

#[test]
fn a_wrench_gives_the_acceleration_of_newton_and_euler() {
    let folder = Folder::new();
    // Steps 10 to 109: 100 ms.
    let csv = folder.float(FREE, "10|109|WR|Free|4 0 -6 0 0 0.8\n0|200|WR|Fixed|9 9 9 9 9 9\n", 200);
    for step in [0, 10, 60, 110, 111, 200] {
        // The command after step k acts in step k + 1.
        let pushed = (step as f64 - 10.0).clamp(0.0, 100.0) * 0.001;
        close(csv.at(step, "Free", "vx"), 4.0 / 2.0 * pushed, 1e-12);
        close(csv.at(step, "Free", "vz"), -6.0 / 2.0 * pushed, 1e-12);
        close(csv.at(step, "Free", "wz"), 0.8 / 0.4 * pushed, 1e-12);
        assert_eq!(csv.vector(step, "Fixed", ["px", "py", "pz"]), [5.0, 0.0, 0.0], "static");
    }
    // The fixed axis keeps the rotation about z exact: 2 rad/s² for 100 ms, then 0.2 rad/s for 90 ms.
    let angle = 2.0 * csv.at(200, "Free", "cqz").atan2(csv.at(200, "Free", "cqw"));
    close(angle, 0.5 * 2.0 * 0.1 * 0.1 + 0.2 * 0.09, 2e-4);
}

#[test]
fn a_twist_sets_the_velocity_even_of_row_zero() {
    let folder = Folder::new();
    let csv = folder.float(FREE, "0|0|TW|Free|0.25 -0.5 1 0 0 0.3\n", 100);
    assert_eq!(csv.vector(0, "Free", ["vx", "vy", "vz"]), [0.25, -0.5, 1.0]);
    assert_eq!(csv.at(0, "Free", "wz"), 0.3);
    assert_eq!(csv.vector(0, "Free", ["px", "py", "pz"]), [0.0; 3]);
    for step in [1, 50, 100] {
        let time = step as f64 * 0.001;
        close(csv.at(step, "Free", "cy"), -0.5 * time, 1e-12);
        // The reported pose is one step old.
        close(csv.at(step, "Free", "pz"), time - 0.001, 1e-12);
    }
}

#[test]
fn a_twist_carries_a_static_body_along() {
    let folder = Folder::new();
    let csv = folder.float(FREE, "0|200|TW|Fixed|0 0.5 0 0 0 1\n", 200);
    let (first, last) = (100, 200);
    close(csv.at(last, "Fixed", "py") - csv.at(first, "Fixed", "py"), 0.5 * 0.1, 1e-9);
    let angle = |step| 2.0 * csv.at(step, "Fixed", "qz").atan2(csv.at(step, "Fixed", "qw"));
    close(angle(last) - angle(first), 0.1, 1e-9);
    close(csv.at(last, "Fixed", "px"), 5.0, 1e-12);
}

#[test]
fn a_pose_is_taken_at_once_by_a_static_body() {
    let folder = Folder::new();
    let pose = format!("1 2 3 0 0 {FRAC_1_SQRT_2} {FRAC_1_SQRT_2}");
    let csv = folder.float(FREE, &format!("5|5|POSE|Fixed|{pose}\n"), 10);
    assert_eq!(csv.vector(5, "Fixed", ["px", "py", "pz"]), [5.0, 0.0, 0.0]);
    for step in [6, 10] {
        let position = csv.vector(step, "Fixed", ["px", "py", "pz"]);
        let orientation = [csv.at(step, "Fixed", "qz"), csv.at(step, "Fixed", "qw")];
        position.iter().zip([1.0, 2.0, 3.0]).for_each(|(&found, expected)| close(found, expected, 1e-12));
        orientation.iter().for_each(|&found| close(found, FRAC_1_SQRT_2, 1e-12));
        // The inertial frame is 0.3 m above the body frame.
        close(csv.at(step, "Fixed", "cz"), 3.3, 1e-12);
    }
}

#[test]
fn a_pose_of_any_quaternion_is_a_pose() {
    let folder = Folder::new();
    let csv = folder.float(FREE, "1|20|POSE|Fixed|1 2 3 0 0 0 0\n1|20|POSE|Free|0 0 0 0 0 5 0\n", 40);
    assert_eq!(csv.at(40, "Fixed", "qw"), 1.0, "a zero quaternion counts as no rotation");
    assert!(csv.at(40, "Free", "wz").abs() > 1.0, "half a turn is left");
}

#[test]
fn a_pose_is_approached_by_a_free_body_in_a_tenth_of_a_second() {
    let folder = Folder::new();
    let turn = 0.4_f64;
    let pose = format!("1 0 -0.5 0 {} 0 {}", (turn / 2.0).sin(), (turn / 2.0).cos());
    let csv = folder.float(FREE, &format!("0|2000|POSE|Free|{pose}\n"), 2000);
    // Velocity 10/s times the error: e(t) = e(0)·exp(−10 t); 1 % for the steps of 1 ms and the delay of one.
    for step in [50, 100, 200] {
        let left = (-10.0 * (step as f64) * 0.001).exp();
        close(1.0 - csv.at(step, "Free", "px"), left, 0.012);
        close(csv.at(step, "Free", "pz") + 0.5, 0.5 * left, 0.006);
        let angle = 2.0 * csv.at(step, "Free", "qy").atan2(csv.at(step, "Free", "qw"));
        close(turn - angle, turn * left, 0.006);
    }
    close(csv.at(2000, "Free", "px"), 1.0, 1e-7);
    close(csv.at(2000, "Free", "qy"), (turn / 2.0).sin(), 1e-7);
}

#[test]
fn an_effort_turns_and_pushes() {
    let folder = Folder::new();
    folder.float(&joints("", ""), "0|299|J|Base|0 0 0.6\n0|299|J|Base|1 0 2\n", 300);
    let csv = folder.csv("t_joints.csv");
    let time = 0.3;
    // Torque on the child, none of it lost in the joint; the step's half is Bullet's way to integrate.
    close(csv.at(300, "Turn", "position"), 0.6 / ARM * time * (time + 0.001) / 2.0, 1e-4);
    close(csv.at(300, "Turn", "velocity"), 0.6 / ARM * time, 2e-3);
    // A slider tells its position when it was solved, before the bodies moved.
    close(csv.at(300, "Slide", "position"), 2.0 / 4.0 * time * (time - 0.001) / 2.0, 1e-9);
}

#[test]
fn a_sine_of_effort_integrates_to_one_minus_cosine() {
    let folder = Folder::new();
    let bodies = folder.float(&joints("", ""), "0|1000|JS|Base|1 0 0.0 8.0 2.0\n", 1000);
    for step in [100, 125, 250, 500, 1000] {
        let time = step as f64 * 0.001;
        let expected = 8.0 / (4.0 * TAU * 2.0) * (1.0 - (TAU * 2.0 * time).cos());
        close(bodies.at(step, "Cart", "vy"), expected, 2e-3);
    }
    let constant = folder.float(&joints("", ""), "0|1000|JS|Base|1 0 2.0 0.0 5.0\n", 100);
    close(constant.at(100, "Cart", "vy"), 2.0 / 4.0 * 0.1, 1e-6);
}

#[test]
fn a_velocity_is_kept_after_its_last_command() {
    let folder = Folder::new();
    folder.float(&joints("", ""), "0|300|J|Base|0 2 0.8\n0|300|J|Base|1 2 -0.4\n", 1200);
    let csv = folder.csv("t_joints.csv");
    for step in [900, 1200] {
        close(csv.at(step, "Turn", "velocity"), 0.8, 1e-3);
        close(csv.at(step, "Slide", "velocity"), -0.4, 1e-3);
    }
}

#[test]
fn an_effort_ends_a_velocity() {
    let folder = Folder::new();
    folder.float(&joints("", ""), "0|300|J|Base|1 2 0.4\n301|301|J|Base|1 0 0\n302|402|J|Base|1 0 -1\n", 402);
    let csv = folder.csv("t_joints.csv");
    // The motor is off, so 1 N brakes 4 kg for 100 ms.
    close(csv.at(402, "Slide", "velocity"), csv.at(301, "Slide", "velocity") - 1.0 / 4.0 * 0.1, 1e-3);
}

#[test]
fn a_position_is_reached_and_held() {
    let folder = Folder::new();
    let critical = ", controller: {P: 600, I: 0, D: 98}";
    folder.float(&joints("", critical), "0|3000|J|Base|0 1 0.7\n0|3000|J|Base|1 1 0.25\n", 3000);
    let csv = folder.csv("t_joints.csv");
    close(csv.at(3000, "Turn", "position"), 0.7, 1e-4);
    close(csv.at(3000, "Slide", "position"), 0.25, 1e-4);
    // With P 600 N/m on 4 kg the undamped frequency is 12 rad/s: after 0.1 s it is neither at the start nor at the end.
    let early = csv.at(100, "Slide", "position");
    assert!(early > 0.05 && early < 0.2, "{early}");
}

#[test]
fn positions_stay_within_limits_and_turn_the_short_way() {
    let folder = Folder::new();
    let limits = ", joint limits: {low: -0.5, high: 0.3}";
    folder.float(&joints(limits, ""), "0|2000|J|Base|0 1 2.0\n", 2000);
    close(folder.csv("t_joints.csv").at(2000, "Turn", "position"), 0.3, 2e-3);
    let folder = Folder::new();
    // Without limits 350° is reached over −10°.
    folder.float(&joints("", ""), &format!("0|2000|J|Base|0 1 {}\n", 350.0_f64.to_radians()), 2000);
    let csv = folder.csv("t_joints.csv");
    close(csv.at(2000, "Turn", "position"), -10.0_f64.to_radians(), 1e-3);
    assert!(csv.lines.iter().all(|line| csv.text(line, "position").parse::<f64>().unwrap().abs() < PI / 2.0));
}

#[test]
fn values_are_rounded_as_on_the_wire() {
    let folder = Folder::new();
    let bodies = folder.float(&joints("", ""), "0|99|J|Base|1 0 1000.1\n", 100);
    let speed = |force: f64| force / 4.0 * 0.1;
    close(bodies.at(100, "Cart", "vy"), speed(f64::from(1000.1_f32)), 1e-8);
    assert!((speed(f64::from(1000.1_f32)) - speed(1000.1)).abs() > 1e-7, "the test cannot tell");
}

#[test]
fn bodies_are_named_by_full_names_names_and_parts_of_them() {
    let folder = Folder::new();
    let model = format!("namespace: /n/\n{FREE}");
    for name in ["Free", "/n/Free", "/n/BODY Free", "Y Fr"] {
        let csv = folder.float(&model, &format!("0|0|TW|{name}|0.25 0 0 0 0 0\n"), 1);
        assert_eq!(csv.at(1, "Free", "vx"), 0.25, "{name}");
    }
    folder.write("commands.txt", "\n0|0|TW|BODY|0 0 0 0 0 0\n");
    let ran = folder.run("-a model.yaml --world world.yaml --commands commands.txt --steps 1");
    let expected = "commands.txt:2: `BODY` is part of several: `/n/BODY Free`, `/n/BODY Fixed`; write more of the name of the body";
    assert!(ran.status == 2 && ran.stderr.contains(expected), "{ran:?}");
}

#[test]
fn cuts_and_tools_open_a_hole_for_a_ball() {
    use ambf_core::volume::{nrrd, Label, Voxel, VoxelGrid};
    use nalgebra::{Isometry3, Vector3};
    let folder = Folder::new();
    // Solid up to 3 mm above the centre.
    let grid = VoxelGrid::from_fn([40; 3], Vector3::repeat(0.02), 0.5, vec![Label::of_color([255; 3])], |[_, _, k]| {
        if k < 26 {
            Voxel { density: 255, label: 1 }
        } else {
            Voxel::default()
        }
    });
    nrrd::write(&grid.expect("a grid"), &folder.path().join("v.nrrd"), &Isometry3::identity()).expect("written");
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -9.81}\n");
    folder.write(
        "model.yaml",
        "volumes: [VOLUME bone]\nVOLUME bone: {name: bone, nrrd: v.nrrd, contact: true, \
         tools: [{body: BODY drill, tip: {radius: 0.002}, rate: 1.0e-6, on: false, \
         burrs: [{radius: 0.002, rate: 1.0e-6}]}]}\n\
         bodies: [BODY ball, BODY drill]\n\
         BODY ball: {name: ball, mass: 0.001, location: {position: {x: 0, y: 0, z: 0.0045}}, collision shape: Sphere, \
         collision geometry: {radius: 0.0015}, restitution: 0}\n\
         BODY drill: {name: drill, mass: 0, location: {position: {x: 0, y: 0, z: 0.001}}}\n",
    );
    let height = |commands: &str, step: u64| {
        folder.write("commands.txt", commands);
        folder.succeed("-a model.yaml --world world.yaml --commands commands.txt --steps 400 --trace t");
        folder.csv("t_bodies.csv").at(step, "ball", "pz")
    };
    close(height("", 400), 0.0045, 1e-4);
    // From 6 mm to the middle in 20 steps of 0.3 mm.
    let cut = "100|119|CUT|bone|0 0 0.006 0 0 0 0.003\n";
    close(height(cut, 100), 0.0045, 1e-4);
    close(height(cut, 400), -0.0015, 5e-4);
    assert!(height("100|399|TOOL|bone|0 1\n", 400) < 0.0025, "the drill is at 1 mm");
    close(height("0|0|TOOL|bone|0 0 0.002\n", 400), 0.0045, 1e-4);
    // What a volume refuses ends the run.
    folder.write("commands.txt", "5|9|TOOL|bone|0 1 0.001\n");
    let ran = folder.run("-a model.yaml --world world.yaml --commands commands.txt --steps 10");
    assert!(ran.status != 0 && ran.stderr.contains("commands.txt:1: step 5: no burr"), "{ran:?}");
}

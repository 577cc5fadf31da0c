//! Robots read from URDF, in motion.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use ambf_core::adf;
use ambf_core::comm::JointCommandType;
use ambf_core::ids::BodyId;
use ambf_core::scene::{load, Loaded, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use tempfile::TempDir;

use crate::physics_common::{close, turned, Bench, DT, HEAVY, WEIGHTLESS};

/// A folder that goes with the test.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(TempDir::new().expect("a temporary folder"))
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(&path, text).expect("written");
        path
    }

    fn load(&self, world: &str, robot: &str) -> Loaded {
        let files =
            SceneFiles { world: Some(self.write("world.yaml", world)), models: vec![self.write("robot.urdf", robot)] };
        load(&files, &SceneOptions::default())
    }

    /// A simulation of a robot without errors.
    fn bench(&self, world: &str, robot: &str) -> Bench {
        let Loaded { scene, report } = self.load(world, robot);
        assert_eq!(report.errors(), 0, "{report}");
        Bench(Simulation::new(scene, DT))
    }
}

/// A joint of the test robot: type, origin (xyz, rpy), axis, limits.
type Row = (&'static str, [f64; 3], [f64; 3], [f64; 3], [f64; 2]);

/// Joints whose frames are turned by nothing, by nearly nothing, by half a turn, by nearly half a turn and by anything.
const CHAIN: [Row; 9] = [
    ("revolute", [0.0, 0.0, 0.3], [0.0, 0.0, 0.0], [0.0008, 0.0, 1.0], [-2.0, 2.0]),
    ("revolute", [0.1, 0.0, 0.2], [0.0005, 0.0, 0.0], [0.0, 0.0, 1.0], [-2.0, 2.0]),
    ("revolute", [0.0, 0.2, 0.0], [std::f64::consts::PI, 0.0, 0.0], [0.0, 0.0, 1.0], [-2.0, 2.0]),
    ("revolute", [0.0, 0.2, 0.1], [3.1406, 0.0, 0.0], [1.0, 0.0, 1.0], [-2.0, 2.0]),
    ("prismatic", [0.3, 0.0, 0.0], [0.3, -1.1, 2.0], [0.0, -2.0, 0.0], [-0.2, 0.2]),
    ("revolute", [0.3, 0.1, 0.0], [-2.0, 0.4, 1.0], [0.3, -0.5, 0.7], [0.4, 1.5]),
    ("prismatic", [0.0, 0.1, 0.2], [1.57, 0.0, -1.57], [1.0, 0.0002, 0.0], [-0.3, -0.1]),
    ("fixed", [0.2, 0.0, 0.1], [0.5, 0.6, 0.7], [0.0, 0.0, 0.0], [0.0, 0.0]),
    ("continuous", [0.0, 0.0, 0.2], [0.0, 3.1412, 0.2], [0.0003, 0.0, -1.0], [0.0, 0.0]),
];

/// Joint position next to zero.
fn start([low, high]: [f64; 2]) -> f64 {
    0f64.clamp(low, high)
}

/// The robot of [`CHAIN`]: links `l0` (without mass), `l1`, …, joints `j1`, `j2`, …; inertias far from diagonal.
fn chain() -> String {
    let mut text = String::from("<robot name='chain'><link name='l0'/>\n");
    for (i, (kind, xyz, rpy, axis, [low, high])) in (1..).zip(CHAIN) {
        let three = |v: [f64; 3]| format!("{} {} {}", v[0], v[1], v[2]);
        writeln!(
            text,
            "<joint name='j{i}' type='{kind}'><parent link='l{}'/><child link='l{i}'/>\
             <origin xyz='{}' rpy='{}'/><axis xyz='{}'/><limit lower='{low}' upper='{high}' effort='2000'/></joint>\n\
             <link name='l{i}'><inertial><origin xyz='0.05 -0.02 0.03' rpy='0.2 0.1 -0.4'/><mass value='0.5'/>\
             <inertia ixx='0.011' iyy='0.012' izz='0.013' ixy='-0.001' ixz='0.002' iyz='0.0005'/></inertial></link>",
            i - 1,
            three(xyz),
            three(rpy),
            three(axis)
        )
        .expect("a text takes everything");
    }
    let text = text.replace("type='continuous'>", "type='continuous'>\n");
    text + "</robot>\n"
}

/// Poses of `l0`, `l1`, … at joint positions `q`.
fn forward_kinematics(q: impl Fn(usize) -> f64) -> Vec<Isometry3<f64>> {
    let mut poses = vec![Isometry3::identity()];
    for (i, (kind, xyz, rpy, axis, _)) in CHAIN.into_iter().enumerate() {
        let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
        let origin = Isometry3::from_parts(Vector3::from(xyz).into(), rotation);
        let motion = match kind {
            "prismatic" => Isometry3::from(Vector3::from(axis).normalize() * q(i)),
            "fixed" => Isometry3::identity(),
            _ => Isometry3::rotation(Vector3::from(axis).normalize() * q(i)),
        };
        poses.push(poses[i] * origin * motion);
    }
    poses
}

#[track_caller]
fn same_pose(found: &Isometry3<f64>, expected: &Isometry3<f64>, tolerance: f64, what: &str) {
    let apart = (found.translation.vector - expected.translation.vector).norm();
    let angle = turned(&found.rotation, &expected.rotation);
    assert!(apart < tolerance && angle < tolerance, "{what}: {apart} m, {angle} rad apart");
}

#[test]
fn links_stand_where_urdf_puts_them_and_the_joints_agree() {
    let folder = Folder::new();
    let mut bench = folder.bench(WEIGHTLESS, &chain());
    let poses = forward_kinematics(|i| start(CHAIN[i].4));
    for steps in [0, 200] {
        bench.steps(steps);
        for (i, expected) in poses.iter().enumerate() {
            same_pose(&bench.pose(&format!("l{i}")), expected, 1e-9, &format!("l{i} after {steps} steps"));
        }
        for (i, (kind, .., limits)) in CHAIN.into_iter().enumerate() {
            let expected = if kind == "fixed" { 0.0 } else { start(limits) };
            close(bench.joint(&format!("j{}", i + 1)).position, expected, 1e-9);
        }
    }
}

#[test]
fn joint_positions_are_those_of_urdf() {
    let folder = Folder::new();
    let mut bench = folder.bench(WEIGHTLESS, &chain());
    let wanted = [0.5, -0.7, 0.3, 1.0, 0.15, 0.9, -0.2, f64::NAN, -0.4];
    let root = bench.body("l0");
    let active: Vec<_> = bench.0.scene().active_joints(root).to_vec();
    assert_eq!(active.len(), 8, "the fixed joint has no coordinate");
    for _ in 0..3000 {
        for (index, q) in wanted.iter().filter(|q| !q.is_nan()).enumerate() {
            assert!(bench.0.command_joint(root, index, JointCommandType::Position, *q));
        }
        bench.update(DT);
    }
    let position = |i: usize| bench.joint(&format!("j{}", i + 1)).position;
    for (i, q) in wanted.iter().enumerate().filter(|(_, q)| !q.is_nan()) {
        close(position(i), *q, 1e-4);
    }
    for (i, expected) in forward_kinematics(position).iter().enumerate() {
        same_pose(&bench.pose(&format!("l{i}")), expected, 1e-4, &format!("l{i}"));
    }
}

/// ADF text of the shipped arm, with the same frames.
fn arm_in_adf() -> String {
    let rows = [
        ("base", 0.0, [0.0, 0.0], 0.09, 0.2, "z", 0.0, 0.0),
        ("shoulder", 1.5, [0.0041625, 0.0027], 0.06, 0.15, "z", 2.9, 100.0),
        ("upper_arm", 1.2, [0.00475, 0.0015], 0.05, 0.2, "y", 2.0, 100.0),
        ("elbow", 1.0, [0.0038396, 0.0010125], 0.045, 0.2, "z", 2.9, 60.0),
        ("forearm", 0.8, [0.0030717, 0.00081], 0.045, 0.2, "y", 2.3, 60.0),
        ("wrist", 0.6, [0.00224, 0.00048], 0.04, 0.2, "z", 2.9, 30.0),
        ("hand", 0.3, [0.0002519, 0.0001838], 0.035, 0.08, "y", 2.0, 30.0),
        ("flange", 0.15, [0.0001138, 6.75e-5], 0.03, 0.08, "z", 2.9, 10.0),
    ];
    let mut text = String::from("namespace: /ambf/env/hanging_arm/\nignore inter-collision: true\n");
    let (mut names, mut joints) = (vec![], vec![]);
    let (mut z, mut parent) = (0.0, ("", 0.0));
    for (i, (name, mass, [across, along], radius, height, axis, limit, effort)) in rows.into_iter().enumerate() {
        names.push(format!("BODY {name}"));
        // The base's frame is in its middle, those of the others in their joints.
        let middle = if i == 0 { 0.0 } else { height / 2.0 };
        let pose = format!("{{position: {{x: 0, y: 0, z: {middle}}}}}");
        let size = format!("{{radius: {radius}, height: {height}}}");
        writeln!(
            text,
            "BODY {name}: {{name: {name}, mass: {mass}, inertia: {{ix: {across}, iy: {across}, iz: {along}}}, \
             location: {{position: {{x: 0, y: 0, z: {}}}, orientation: {{r: 3.141592653589793, p: 0, y: 0}}}}, \
             inertial offset: {pose}, compound collision shape: [{{shape: Cylinder, geometry: {size}, offset: {pose}}}]}}",
            -z
        )
        .expect("a text takes everything");
        if i > 0 {
            joints.push(format!("JOINT {name}"));
            let axis = ["x", "y", "z"].map(|other| format!("{other}: {}", u8::from(other == axis))).join(", ");
            writeln!(
                text,
                "JOINT {name}: {{name: {name}, type: revolute, parent: BODY {}, child: BODY {name}, \
                 parent pivot: {{x: 0, y: 0, z: {}}}, child pivot: {{x: 0, y: 0, z: 0}}, parent axis: {{{axis}}}, \
                 child axis: {{{axis}}}, joint limits: {{low: {}, high: {limit}}}, max motor impulse: {}}}",
                parent.0,
                parent.1,
                -limit,
                effort * 0.001
            )
            .expect("a text takes everything");
        }
        parent = (name, if i == 0 { height / 2.0 } else { height });
        z += parent.1;
    }
    format!("bodies: [{}]\njoints: [{}]\n{text}", names.join(", "), joints.join(", "))
}

#[test]
fn the_shipped_arm_moves_as_the_same_arm_in_adf() {
    let folder = Folder::new();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/models/hanging_arm.urdf");
    let text = std::fs::read_to_string(path).expect("the shipped arm");
    // ADF has no largest velocity.
    let text = text.replace(" velocity=\"3\"", "");
    let mut urdf = folder.bench(HEAVY, &text);
    let mut twin = Bench::new(HEAVY, &arm_in_adf());
    let mut moved = 0.0_f64;
    for step in 0..2000 {
        for bench in [&mut urdf, &mut twin] {
            let base = bench.body("base");
            // Fall freely for half of the time.
            for (index, q) in [0.5, 1.0, -0.5, 0.8, 0.3, -0.6, 1.0].into_iter().enumerate().filter(|_| step < 1000) {
                assert!(bench.0.command_joint(base, index, JointCommandType::Position, q));
            }
            if step == 1000 {
                let joints = bench.0.scene().active_joints(base).len();
                (0..joints).for_each(|i| assert!(bench.0.command_joint(base, i, JointCommandType::Effort, 0.0)));
            }
            bench.update(DT);
        }
        let names = ["yaw", "shoulder", "roll", "elbow", "forearm_roll", "wrist", "flange_roll"];
        let links = ["shoulder", "upper_arm", "elbow", "forearm", "wrist", "hand", "flange"];
        for (joint, link) in names.into_iter().zip(links) {
            let (found, expected) = (urdf.joint(joint).position, twin.joint(link).position);
            close(found, expected, 1e-9);
            same_pose(&urdf.pose(link), &twin.pose(link), 1e-9, link);
            moved = moved.max(found.abs());
        }
    }
    assert!(moved > 0.5, "the arm moved by {moved} rad only");
}

#[test]
fn a_base_that_is_fixed_to_the_world_stays_there() {
    let folder = Folder::new();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/models/hanging_arm.urdf");
    let text = std::fs::read_to_string(path).expect("the shipped arm");
    let mut bench = folder.bench(HEAVY, &text);
    let before = bench.pose("base");
    bench.steps(500);
    assert_eq!(bench.pose("base"), before);
    let [world, base] = ["world", "base"].map(|name| bench.body(name));
    assert_eq!(bench.0.scene().active_joints(base).len(), 7);
    assert_eq!(bench.0.scene().active_joints(base), bench.0.scene().active_joints(world));
}

const MASS: &str =
    "<inertial><mass value='1'/><inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial>";

/// A pyramid with a base of 2 m × 2 m in z = 0 and its tip 1 m above.
const PYRAMID: &str = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv 0 0 1\n\
                       f 4 3 2\nf 4 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";

#[test]
fn meshes_are_found_in_packages_scaled_mirrored_and_placed_beside_primitives() {
    let folder = Folder::new();
    folder.write("package.xml", "<package><name>pyramids</name></package>");
    folder.write("meshes/pyramid.obj", PYRAMID);
    // A foot of 0.1 m, and beside it a pyramid upside down whose tip is 0.2 m below the body.
    let robot = format!(
        "<robot name='r'><link name='a'>{MASS}\
         <collision><origin xyz='0.3 0 0'/><geometry><box size='0.2 0.8 0.2'/></geometry></collision>\
         <collision><origin xyz='-0.3 0 0'/><geometry><mesh filename='package://pyramids/meshes/pyramid.obj' \
         scale='0.1 0.2 -0.1'/></geometry></collision></link></robot>"
    );
    let floor =
        "bodies: [F]\nF: {name: floor, mass: 0, collision shape: Plane, location: {position: {x: 0, y: 0, z: -1}}, \
                 collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}}\n";
    let files = SceneFiles {
        world: Some(folder.write("world.yaml", HEAVY)),
        models: vec![folder.write("floor.yaml", floor), folder.write("robot.urdf", &robot)],
    };
    let Loaded { scene, report } = load(&files, &SceneOptions::default());
    assert_eq!((report.errors(), report.notes.len()), (0, 0), "{report}");
    let mut bench = Bench(Simulation::new(scene, DT));
    bench.steps(3000);
    let rest = bench.pose("a");
    // Box and tip both reach 0.1 m down, so that the body rests level on an edge, a side and a tip.
    close(rest.translation.z, -0.9, 5e-3);
    close((rest.rotation * Vector3::z()).z, 1.0, 1e-3);
}

#[test]
fn a_mesh_that_is_missing_costs_nothing_but_itself() {
    let folder = Folder::new();
    let mesh = |name: &str| format!("<collision><geometry><mesh filename='{name}'/></geometry></collision>");
    let robot = format!(
        "<robot name='r'><link name='a'>{MASS}{}{}<collision><geometry><sphere radius='0.1'/></geometry></collision>\
         </link></robot>",
        mesh("nowhere.stl"),
        mesh("package://unheard_of/a.stl")
    );
    let Loaded { scene, report } = folder.load(WEIGHTLESS, &robot);
    assert_eq!((scene.bodies.len(), report.errors()), (1, 2), "{report}");
    let text = report.to_string();
    assert!(
        text.contains("robot.urdf:1:17: error: `BODY a`: a collision mesh is left out: ")
            && text.contains("nowhere.stl")
    );
    assert!(text.contains("`package://unheard_of/a.stl`, expected a package"), "{text}");
}

#[test]
fn links_of_one_robot_pass_through_each_other_unless_gazebo_is_told_otherwise() {
    let folder = Folder::new();
    let ball = "<collision><geometry><sphere radius='0.1'/></geometry></collision>";
    let slide = |name: &str, parent: &str, x: f64, limits: &str| {
        format!(
            "<joint name='{name}' type='prismatic'><parent link='{parent}'/><child link='{name}'/><origin xyz='{x} 0 0'/>\
             <axis xyz='1 0 0'/><limit {limits} effort='1000'/></joint><link name='{name}'>{MASS}{ball}</link>"
        )
    };
    let text = format!(
        "<robot name='r'><link name='root'/>{}{}EXTRA</robot>",
        slide("a", "root", 0.0, "lower='0' upper='2'"),
        slide("b", "root", 0.5, "lower='0' upper='0.001'")
    );
    let reach = |extra: &str| {
        let mut bench = folder.bench(WEIGHTLESS, &text.replace("EXTRA", extra));
        bench.command("root", 0, JointCommandType::Effort, 2.0, 900);
        bench.position("a").x
    };
    assert!(reach("") > 0.6);
    for link in ["", "reference='a'", "reference='b'"] {
        let stopped = reach(&format!("<gazebo {link}><self_collide>true</self_collide></gazebo>"));
        assert!(stopped < 0.35, "{link}: went to {stopped}");
    }
}

#[test]
fn a_floating_joint_joins_nothing_and_a_planar_one_keeps_to_its_plane() {
    let folder = Folder::new();
    let robot = |kind: &str| {
        format!(
            "<robot name='r'><link name='root'/><joint name='j' type='{kind}'><parent link='root'/><child link='a'/>\
             <origin xyz='0 0 1' rpy='0.5 0 0'/><axis xyz='0 0 1'/></joint><link name='a'>{MASS}</link></robot>"
        )
    };
    let mut bench = folder.bench(HEAVY, &robot("floating"));
    bench.steps(100);
    assert!(bench.position("a").z < 0.96);
    let mut bench = folder.bench(HEAVY, &robot("planar"));
    let normal = UnitQuaternion::from_euler_angles(0.5, 0.0, 0.0) * Vector3::z();
    bench.throw("a", Vector3::new(0.5, 0.0, 0.0));
    bench.steps(400);
    let moved = bench.position("a") - Vector3::z();
    assert!(moved.norm() > 0.3, "it slides down the plane: {moved}");
    close(moved.dot(&normal), 0.0, 1e-3);
    close((bench.pose("a").rotation * Vector3::z()).dot(&normal), 1.0, 1e-5);
}

#[test]
fn robots_of_the_same_file_are_told_apart_and_adf_files_still_are_adf() {
    let folder = Folder::new();
    let robot = folder.write("robot.urdf", &chain());
    let files = SceneFiles { world: None, models: vec![robot.clone(), robot] };
    let Loaded { scene, report } = load(&files, &SceneOptions::default());
    assert_eq!(report.errors(), 0, "{report}");
    assert_eq!((scene.bodies.len(), scene.joints.len(), scene.models.len()), (20, 18, 3));
    assert!(scene.joints.iter().skip(9).all(|joint| joint.parent >= BodyId::new(10) && joint.child >= BodyId::new(10)));
    let yaml = folder.write("model.yaml", "bodies: []\n");
    assert!(adf::load::<adf::Model>(&yaml).is_ok() && ambf_core::scene::read_model(&yaml).is_ok());
    let broken = SceneFiles { world: None, models: vec![folder.write("broken.urdf", "<robot>\n<link></robot>")] };
    let refused = load(&broken, &SceneOptions::default()).report.refused;
    assert!(refused.len() == 1 && refused[0].contains("broken.urdf:2:7: syntax error"), "{refused:?}");
}

#[test]
fn a_spherical_joint_holds_its_point_and_lets_its_link_swing() {
    let folder = Folder::new();
    let mass = "<inertial><mass value='1'/><inertia ixx='0.1' iyy='0.1' izz='0.1' ixy='0' ixz='0' iyz='0'/></inertial>";
    let robot = format!(
        "\n<?xml version='1.0'?><robot name=''><link name='world'/><link name='b'>{}</link>\
         <joint name='j' type='spherical'><parent link='world'/><child link='b'/><origin xyz='0 0 2'/></joint></robot>",
        mass.replace("<inertial>", "<inertial><origin xyz='0.5 0 0'/>")
    );
    let mut bench = folder.bench(HEAVY, &robot);
    bench.steps(300);
    let pose = bench.pose("b");
    assert!((pose.translation.vector - Vector3::new(0.0, 0.0, 2.0)).norm() < 5e-3, "{pose}");
    assert!((pose * nalgebra::Point3::new(0.5, 0.0, 0.0)).z < 1.9, "it swings down: {pose}");
}

//! Numbers that no physics survives: whatever is lost is named in the iteration in which it is lost, and a reset brings
//! it back.

use crate::physics_common::{load_texts, DT};
use ambf_core::comm::{CartesianCommandType, JointCommandType, RigidBodyCommand};
use ambf_core::ids::BodyId;
use ambf_core::scene::Loaded;
use ambf_core::sim::{Loss, LostState, Nearness, Simulation};
use nalgebra::Vector3;

const PROFILES: [&str; 2] = ["legacy", "accurate"];

/// A rod on a hinge and a ball above it; `BODY`, `JOINT` are further keys of ball and hinge.
const SCENE: &str = "bodies: [BODY Post, BODY Rod, BODY Ball]\njoints: [J]\n\
    BODY Post: {name: Post, mass: 0}\n\
    BODY Rod: {name: Rod, mass: 1, inertia: {ix: 0.01, iy: 0.1, iz: 0.1}, location: {position: {x: 0.5, y: 0, z: 0}}, \
    collision shape: Box, collision geometry: {x: 1, y: 0.1, z: 0.1}, damping: {linear: 0, angular: 0}}\n\
    BODY Ball: {name: Ball, mass: 1, location: {position: {x: 0.5, y: 0, z: 0.3}}, collision shape: Sphere, \
    collision geometry: {radius: 0.1}BODY}\n\
    J: {name: J, type: revolute, parent: BODY Post, child: BODY Rod, parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}, \
    parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: -0.5, y: 0, z: 0}JOINT}\n";
const ROD: &str = "BODY Rod";
const BALL: &str = "BODY Ball";

fn simulation(profile: &str, body: &str, joint: &str) -> Simulation {
    of_scene(SCENE, profile, body, joint)
}

fn of_scene(scene: &str, profile: &str, body: &str, joint: &str) -> Simulation {
    let text = scene.replace("BODY}", &format!("{body}}}")).replace("JOINT}", &format!("{joint}}}"));
    let world = format!("gravity: {{x: 0, y: 0, z: -10}}\nphysics: {{profile: {profile}}}\n");
    let Loaded { scene, report } = load_texts(&world, &[&text]);
    assert_eq!(report.errors(), 0, "{body} {joint}: {report}");
    Simulation::new(scene, DT)
}

/// Steps 300 times with what `act` does before each; the loss, if there is one.
fn run(simulation: &mut Simulation, mut act: impl FnMut(&mut Simulation)) -> Option<LostState> {
    (0..300).find_map(|_| {
        act(simulation);
        simulation.update(DT).err()
    })
}

/// Every number that can be read is finite.
fn is_sane(simulation: &Simulation) -> bool {
    let scene = simulation.scene();
    let bodies = scene.world.bodies().iter().all(|&body| {
        let (velocity, spin) = scene.world.velocity(body).expect("alive");
        let pose = scene.world.pose(body).expect("alive");
        (velocity + spin + pose.translation.vector).iter().all(|x| x.is_finite())
    });
    bodies && scene.joints.iter().all(|joint| (joint.position + joint.velocity + joint.effort).is_finite())
}

/// What was not lost is sane; what was lost is back after a reset.
fn comes_back(simulation: &mut Simulation, lost: &Option<LostState>, what: &str) {
    if lost.is_some() {
        simulation.reset_bodies();
    }
    assert!(is_sane(simulation), "{what}");
    let again = run(simulation, |_| ());
    assert!(lost.is_none() || again.is_none(), "{what}: after the reset {}", again.expect("lost"));
}

fn hold(kind: JointCommandType, value: f64) -> impl FnMut(&mut Simulation) {
    move |simulation| {
        simulation.command_joint(BodyId::new(0), 0, kind, value);
    }
}

#[test]
fn impossible_joint_gains_and_commands_are_named_with_their_joint() {
    let gains = |p: &str, d: &str, output: &str| {
        format!(", controller: {{P: {p}, I: 0, D: {d}}}, controller output type: {output}, max motor impulse: 1e308")
    };
    let position = JointCommandType::Position;
    for profile in PROFILES {
        let mut names = 0;
        for (keys, kind, value) in [
            (gains("1e308", "0", "FORCE"), position, 0.5),
            (gains("1e308", "1e308", "FORCE"), position, 100.0),
            (gains("0", "1e306", "FORCE"), position, 0.5),
            (gains("1e308", "0", "VELOCITY"), position, 100.0),
            (gains("1e308", "1e308", "VELOCITY"), position, 0.5),
            (String::new(), JointCommandType::Effort, 1e308),
            (", max motor impulse: 1e308".into(), JointCommandType::Velocity, 1e308),
        ] {
            let mut simulation = simulation(profile, "", &keys);
            let lost = run(&mut simulation, hold(kind, value));
            let what = format!("{profile}: {keys} {kind:?} {value}");
            if let Some(lost) = &lost {
                names += 1;
                assert!(lost.body.contains("BODY "), "{what}: {lost}");
                assert!(lost.body.contains(BALL) || lost.joint.as_deref() == Some("J"), "{what}: {lost}");
            }
            comes_back(&mut simulation, &lost, &what);
        }
        assert!(names > 0, "{profile}: nothing was lost, which shows nothing");
    }
}

#[test]
fn impossible_pose_controllers_are_named_with_their_body() {
    for profile in PROFILES {
        let mut names = 0;
        for output in ["FORCE", "VELOCITY"] {
            for (p, d) in [("1e308", "0"), ("1e308", "1e308"), ("1e200", "1e306")] {
                let gains = format!("{{P: {p}, I: 0, D: {d}}}");
                let keys =
                    format!(", controller: {{linear: {gains}, angular: {gains}}}, controller output type: {output}");
                let mut simulation = simulation(profile, &keys, "");
                let target = Vector3::new(3.0, 4.0, 5.0);
                let lost = run(&mut simulation, |simulation| {
                    simulation.follow_pose(BodyId::new(2), target, [0.5, 0.5, 0.5, 0.5])
                });
                let what = format!("{profile}: {keys}");
                if let Some(lost) = &lost {
                    names += 1;
                    assert!(lost.body.contains(BALL) || lost.body.contains(ROD), "{what}: {lost}");
                }
                comes_back(&mut simulation, &lost, &what);
            }
        }
        assert!(names > 0, "{profile}: nothing was lost, which shows nothing");
    }
}

#[test]
fn extreme_properties_are_survived_or_named() {
    for profile in PROFILES {
        for (body, joint) in [
            (", inertia: {ix: 1e-300, iy: 1e-300, iz: 1e-300}", ""),
            (", inertia: {ix: 1e-9, iy: 1e-9, iz: 1e-9}", ""),
            (", inertia: {ix: 1e-9, iy: 1, iz: 1e300}", ""),
            (", inertia: {ix: 1e308, iy: 1e308, iz: 1e308}", ""),
            (", restitution: 1e200", ""),
            (", friction: {static: 1e308, rolling: 1e308}", ""),
            (", damping: {linear: 1e308, angular: -1e308}", ""),
            (", gravity: {x: 0, y: 0, z: -1e308}", ""),
            ("", ", joint limits: {low: 1, high: -1}"),
            ("", ", joint limits: {low: 1e308, high: -1e308}"),
            ("", ", joint limits: {low: -1e308, high: 1e308}"),
            ("", ", joint limits: {low: 3, high: 3}"),
            ("", ", joint erp: 1e308"),
            ("", ", joint cfm: 1e308, joint erp: 1"),
            ("", ", joint cfm: 1e-320"),
        ] {
            let what = format!("{profile}: {body}{joint}");
            let mut simulation = simulation(profile, body, joint);
            if let Some(lost) = run(&mut simulation, |_| ()) {
                assert!(lost.body.contains(BALL) || lost.joint.as_deref() == Some("J"), "{what}: {lost}");
                simulation.reset_bodies();
            }
            assert!(is_sane(&simulation), "{what}");
        }
    }
}

#[test]
fn an_impossible_spring_is_survived_or_named() {
    let scene = SCENE.replace("revolute", "torsion spring");
    for profile in PROFILES {
        for (stiffness, damping) in [("1e308", "0"), ("0", "1e308"), ("1e308", "1e308"), ("-1e308", "1")] {
            let keys = format!(
                ", stiffness: {stiffness}, damping: {damping}, equilibrium point: 1, joint limits: {{low: -1, high: 2}}"
            );
            let mut simulation = of_scene(&scene, profile, "", &keys);
            if let Some(lost) = run(&mut simulation, |_| ()) {
                assert_eq!(lost.joint.as_deref(), Some("J"), "{profile}: {keys}: {lost}");
                simulation.reset_bodies();
            }
            assert!(is_sane(&simulation), "{profile}: {keys}");
        }
    }
}

#[test]
fn a_loss_names_the_command_to_the_body_whose_joint_it_is() {
    let keys = ", controller: {P: 1e308, I: 0, D: 1e308}, controller output type: FORCE";
    let mut simulation = simulation("legacy", "", keys);
    use Nearness::{Connected, SameModel};
    let near = |body| simulation.nearness(BodyId::new(body)).iter().copied().collect::<Vec<_>>();
    assert_eq!(near(1), [Connected, Connected, SameModel], "the rod, and the post that has its joint");
    assert_eq!(near(2), [SameModel, SameModel, Connected]);
    let hub = simulation.connect();
    let objects = hub.objects().clone();
    let (post, _) = objects.entries().find(|(_, object)| object.info.name.contains("Post")).expect("the post");
    let command = RigidBodyCommand {
        cartesian: CartesianCommandType::Force,
        joint_commands: vec![1e3],
        joint_command_types: vec![JointCommandType::Position],
        ..RigidBodyCommand::default()
    };
    hub.post(post, &command).expect("it is finite");
    let options = ambf_core::sim::RunnerOptions { fixed_step: true, ..Default::default() };
    let runner = ambf_core::sim::Runner::start(simulation, options);
    let lost = std::iter::from_fn(|| runner.events().recv_timeout(std::time::Duration::from_secs(20)).ok()).find_map(
        |event| match event {
            ambf_core::sim::Event::Lost(lost) => Some(lost.to_string()),
            _ => None,
        },
    );
    let lost = lost.expect("1e308 cannot last");
    assert!(
        lost.contains("joint `J`") && lost.ends_with("last command: joint 0 position 1000.0 to `BODY Post`"),
        "{lost}"
    );
}

#[test]
fn a_loss_names_the_newest_command_to_what_is_connected_however_far_along_the_chain() {
    let link = |name: &str, x: f64, mass: f64| {
        format!(
            "BODY {name}: {{name: {name}, mass: {mass}, inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}, location: {{position: {{x: {x}, y: 0, z: 0}}}}, \
             collision shape: Sphere, collision geometry: {{radius: 0.1}}}}\n"
        )
    };
    let hinge = |name: &str, parent: &str, child: &str| {
        format!(
            "{name}: {{name: {name}, type: revolute, parent: BODY {parent}, child: BODY {child}, parent axis: {{x: 0, y: 1, z: 0}}, \
             child axis: {{x: 0, y: 1, z: 0}}, parent pivot: {{x: 0.5, y: 0, z: 0}}, child pivot: {{x: -0.5, y: 0, z: 0}}}}\n"
        )
    };
    // A chain of three on a table, and a second one on the same table.
    let bodies = ["Table", "A", "B", "C", "Other"];
    let chain: String =
        (bodies.iter().enumerate()).map(|(i, name)| link(name, i as f64, f64::from(i.min(1) as u8))).collect();
    let joints =
        hinge("j0", "Table", "A") + &hinge("j1", "A", "B") + &hinge("j2", "B", "C") + &hinge("k", "Table", "Other");
    let model =
        format!("bodies: [BODY Table, BODY A, BODY B, BODY C, BODY Other]\njoints: [j0, j1, j2, k]\n{chain}{joints}");
    let Loaded { scene, report } = load_texts("gravity: {x: 0, y: 0, z: 0}\nphysics: {profile: legacy}\n", &[&model]);
    assert_eq!(report.errors(), 0, "{report}");
    let mut simulation = Simulation::new(scene, DT);
    let near = simulation.nearness(BodyId::new(1));
    assert_eq!(near[BodyId::new(4)], Nearness::SameModel, "a table passes nothing on");
    let hub = simulation.connect();
    let post = |name: &str, force: f64| {
        let objects = hub.objects().clone();
        let (object, _) = objects.entries().find(|(_, object)| object.info.name == name).expect("a body");
        let command = RigidBodyCommand::wrench(Vector3::new(0.0, 0.0, force), Vector3::zeros());
        hub.post(object, &command).expect("it is finite");
    };
    post("A", 0.1);
    simulation.iterate(DT).expect("a small force");
    post("C", 1e300);
    simulation.iterate(DT).expect("it acts in the next one");
    post("Other", 0.2);
    let lost = (0..10).find_map(|_| simulation.iterate(DT).err()).expect("1e300 N");
    assert_eq!(lost.body, "BODY A", "the first of all that are lost");
    // That used to be its own old command, or `none`.
    assert_eq!(lost.command, "force (0.0, 0.0, 1e300) N, torque (0.0, 0.0, 0.0) N·m to `BODY C`");
}

/// [`SCENE`] in a world with these further keys of `physics`.
fn bounded(profile: &str, keys: &str) -> Simulation {
    let world = format!("gravity: {{x: 0, y: 0, z: -10}}\nphysics: {{profile: {profile}{keys}}}\n");
    let Loaded { scene, report } = load_texts(&world, &[&SCENE.replace("BODY}", "}").replace("JOINT}", "}")]);
    assert_eq!(report.errors(), 0, "{keys}: {report}");
    Simulation::new(scene, DT)
}

#[test]
fn what_is_finite_but_implausible_is_lost_too_unless_the_world_says_otherwise() {
    for profile in PROFILES {
        let fling = |simulation: &mut Simulation| {
            simulation.set_velocity(BodyId::new(2), Vector3::new(0.0, 0.0, 1e9), Vector3::zeros())
        };
        let mut simulation = bounded(profile, "");
        fling(&mut simulation);
        let lost = simulation.update(DT).expect_err("faster than light");
        assert!(matches!(lost.loss, Loss::TooFast { bound: 3e8, .. }), "{profile}: {lost}");
        assert!(lost.to_string().contains("`physics / largest speed` is 3e8"), "{lost}");
        simulation.reset_bodies();
        assert_eq!(simulation.update(DT), Ok(()));

        let mut simulation = bounded(profile, ", largest speed: 1e10");
        fling(&mut simulation);
        assert_eq!(simulation.update(DT), Ok(()));

        let mut simulation = bounded(profile, ", largest speed: 1e10, largest distance: 1e6");
        fling(&mut simulation);
        let lost = (0..10).find_map(|_| simulation.update(DT).err()).expect("1e6 m are passed in the second step");
        assert!(matches!(lost.loss, Loss::TooFar { bound: 1e6, .. }), "{profile}: {lost}");
        assert!(lost.body.ends_with(BALL), "{lost}");
    }
}

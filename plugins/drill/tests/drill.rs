//! The drill in a scene: it touches and cuts all volumes, shows the burr that it has, and does what keys and clients ask
//! for, without a window.

use std::path::Path;
use std::sync::Arc;

use ambf_core::adf::{PluginEntry, SourcePos};
use ambf_core::comm::{Cut, Hub, ToolReading, VolumeCommand};
use ambf_core::ids::{BodyId, VolumeId};
use ambf_core::plugin::{Input, PluginSetup, Registry};
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{recorder, Simulation};
use ambf_core::volume::{nrrd, Label, Voxel, VoxelGrid};
use nalgebra::{Isometry3, Vector3};

const LEFT: VolumeId = VolumeId::new(0);
const RIGHT: VolumeId = VolumeId::new(1);

/// Edge of a voxel, m; the blocks have 30 of them in a box of 32.
const EDGE: f64 = 0.25e-3;
/// Half an edge of the blocks, m.
const HALF: f64 = 15.0 * EDGE;
/// Between the centres of both blocks, along x, m.
const APART: f64 = 0.03;

const CONTROL: i32 = 2;

/// A drill, its burrs, and two blocks.
struct Bench {
    simulation: Simulation,
    hub: Arc<Hub>,
    /// Cuts since it was asked the last time.
    cuts: Box<dyn Fn() -> Vec<Arc<Cut>>>,
    problems: Vec<String>,
}

fn block(folder: &Path) {
    let full = |index: [usize; 3]| match index.iter().all(|i| (1..31).contains(i)) {
        true => Voxel { density: 255, label: 1 },
        false => Voxel::default(),
    };
    let labels = vec![Label::of_color([255, 249, 219])];
    let grid = VoxelGrid::from_fn([32; 3], Vector3::repeat(32.0 * EDGE), 0.5, labels, full).expect("a grid");
    nrrd::write(&grid, &folder.join("block.nrrd"), &Isometry3::identity()).expect("written");
}

fn model(burrs: &[&str]) -> String {
    let drill = "mastoidectomy_drill";
    let bodies: Vec<String> = [drill].iter().chain(burrs).map(|name| format!("BODY {name}")).collect();
    let mut text = format!("bodies: [{}]\nvolumes: [VOLUME left, VOLUME right]\n", bodies.join(", "));
    for (name, x) in [("left", 0.0), ("right", APART)] {
        text += &format!(
            "VOLUME {name}: {{name: {name}, nrrd: block.nrrd, location: {{position: {{x: {x}, y: 0, z: 0}}, \
             orientation: {{r: 0, p: 0, y: 0}}}}}}\n"
        );
    }
    for name in [drill].iter().chain(burrs) {
        text += &format!(
            "BODY {name}: {{name: {name}, mass: 0, location: {{position: {{x: 0.01, y: 0, z: 0}}, \
             orientation: {{r: 0, p: 0, y: 0}}}}}}\n"
        );
    }
    text
}

fn bench(burrs: &[&str], words: &str) -> Bench {
    let folder = tempfile::tempdir().expect("a folder");
    block(folder.path());
    let (world, file) = (folder.path().join("world.yaml"), folder.path().join("model.yaml"));
    std::fs::write(&world, "gravity: {x: 0, y: 0, z: 0}\n").expect("written");
    std::fs::write(&file, model(burrs)).expect("written");
    let loaded = load(&SceneFiles { world: Some(world), models: vec![file] }, &SceneOptions::default());
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    let mut simulation = Simulation::new(loaded.scene, 0.001);
    let mut registry = Registry::default();
    drill::register(&mut registry);
    let file = folder.path().join("launch.yaml");
    std::fs::write(&file, "plugins: []\n").expect("written");
    let source = SourcePos { file: file.into(), line: 7, column: 5 };
    // As a launch file of the C++ plugin names it.
    let filename = "libvolumetric_drilling.so".into();
    let launch = vec![PluginEntry { name: "volumetric_drilling".into(), filename, path: None, source }];
    let arguments = words.split_whitespace().map(str::to_owned).collect();
    let problems = simulation.load_plugins(PluginSetup { registry, arguments, launch, ..Default::default() }).problems;
    let hub = simulation.connect();
    let cuts = hub.follow_cuts();
    Bench { simulation, hub, cuts: Box::new(move || cuts.try_iter().collect()), problems }
}

impl Bench {
    fn step(&mut self, times: u32) {
        for _ in 0..times {
            self.simulation.iterate(0.001).expect("it holds");
        }
    }

    fn body(&self, name: &str) -> BodyId {
        let bodies = &self.simulation.scene().bodies;
        bodies.entries().find(|(_, body)| &*body.identity.name == name).expect("it is there").0
    }

    fn place_of(&self, name: &str) -> Vector3<f64> {
        let scene = self.simulation.scene();
        scene.bodies[self.body(name)].pose(&scene.world).translation.vector
    }

    /// Leads the drill to a place in so many steps.
    fn lead(&mut self, to: Vector3<f64>, steps: u32) {
        let (body, from) = (self.body("mastoidectomy_drill"), self.place_of("mastoidectomy_drill"));
        for step in 1..=steps {
            let place = from + (to - from) * (f64::from(step) / f64::from(steps));
            self.simulation.follow_pose(body, place, [0.0, 0.0, 0.0, 1.0]);
            self.step(1);
        }
    }

    fn key(&mut self, key: u8, mods: i32) {
        self.simulation.plugins_input(&Input::Key { window: 1, key: key.into(), scancode: 0, action: 1, mods });
        self.step(2);
    }

    fn tool(&self, volume: VolumeId) -> ToolReading {
        self.simulation.scene().tool(volume, 0).expect("it is there")
    }

    fn solid(&self, volume: VolumeId) -> usize {
        self.simulation.scene().volumes[volume].voxels().expect("it has some").count_solid()
    }
}

fn x(place: f64) -> Vector3<f64> {
    Vector3::x() * place
}

#[test]
fn it_stands_in_for_the_library_and_cuts_at_a_rate() {
    let mut bench = bench(&["6mm", "4mm", "2mm", "1mm"], "ambf");
    assert_eq!(bench.problems, Vec::<String>::new());
    bench.step(1);
    let tool = bench.tool(LEFT);
    assert!((tool.radius - 0.003).abs() < 1e-12 && tool.is_on && !tool.is_touching);
    assert_eq!(tool.burr, Some(bench.body("6mm")));
    // Off it holds: the drill goes 1 mm too deep, its burr stays at the surface.
    bench.key(b'B', CONTROL);
    assert!(!bench.tool(LEFT).is_on && !bench.tool(RIGHT).is_on);
    let goal = HALF + 0.002;
    bench.lead(x(goal), 200);
    bench.step(1);
    let tool = bench.tool(LEFT);
    assert!(tool.is_touching && (tool.force.x - 0.7).abs() < 0.1, "{tool:?}");
    assert!((bench.place_of("mastoidectomy_drill").x - goal).abs() < 1e-9);
    let shown = bench.place_of("6mm");
    assert!((shown.x - (HALF + 0.003)).abs() < 0.6 * EDGE && shown.yz().norm() < 0.1 * EDGE, "{shown}");
    assert_eq!((bench.cuts)().len(), 0);
    // On it cuts: at most 30 mm³/s.
    let before = bench.solid(LEFT);
    bench.key(b'B', CONTROL);
    bench.step(198);
    let cuts = (bench.cuts)();
    let volume: f64 = cuts.iter().map(|cut| cut.carved.volume).sum();
    assert!((3e-9..6.1e-9).contains(&volume), "{volume}");
    assert!(cuts.iter().all(|cut| cut.volume == LEFT));
    let voxels: usize = cuts.iter().map(|cut| cut.carved.indices.len()).sum();
    assert_eq!(before - bench.solid(LEFT), voxels);
    assert!(bench.place_of("6mm").x < shown.x - 0.1e-3, "it goes in");
    // Restored by its key, and by a reset of the world, which also leads it back.
    bench.key(b'N', CONTROL);
    let all = 30 * 30 * 30;
    assert!(bench.solid(LEFT) > all - 100, "{}", bench.solid(LEFT));
    bench.simulation.reset_world();
    bench.step(1);
    assert_eq!(bench.solid(LEFT), all);
    assert!((bench.place_of("mastoidectomy_drill").x - 0.01).abs() < 1e-12);
}

#[test]
fn each_volume_is_touched_and_the_burr_is_shown_where_one_holds_it() {
    let mut bench = bench(&["6mm"], "ambf");
    bench.step(1);
    bench.key(b'B', CONTROL);
    for place in [Vector3::new(0.015, 0.05, 0.0), Vector3::new(APART + 0.015, 0.05, 0.0), x(APART + 0.015)] {
        bench.lead(place, 1);
    }
    bench.lead(x(APART + HALF + 0.002), 200);
    bench.step(1);
    let (left, right) = (bench.tool(LEFT), bench.tool(RIGHT));
    assert!(!left.is_touching && right.is_touching, "{left:?} {right:?}");
    assert_eq!((left.force, left.burr), (Vector3::zeros(), right.burr));
    let shown = bench.place_of("6mm").x;
    assert!((shown - (APART + HALF + 0.003)).abs() < 0.6 * EDGE, "{shown}");
    // Away from both it is where the drill is.
    bench.lead(Vector3::new(APART + 0.02, 0.01, 0.02), 50);
    bench.step(1);
    assert!((bench.place_of("6mm") - Vector3::new(APART + 0.02, 0.01, 0.02)).norm() < 1e-9);
}

#[test]
fn burrs_are_changed_by_key_and_by_clients() {
    // With three burrs the C++ plugin stays at the smallest one.
    let mut bench = bench(&["4mm", "6mm", "2mm"], "ambf");
    bench.step(1);
    let size = |bench: &Bench| (2e3 * bench.tool(LEFT).radius).round() as u32;
    let mut sizes = vec![size(&bench)];
    for _ in 0..4 {
        bench.key(b'C', 0);
        sizes.push(size(&bench));
    }
    assert_eq!(sizes, [6, 4, 2, 6, 4]);
    assert_eq!(bench.tool(LEFT).burr, Some(bench.body("4mm")));
    let post = |bench: &mut Bench, radius| {
        let command = VolumeCommand::Tool { tool: 0, on: None, radius: Some(radius) };
        bench.hub.post_volume(LEFT, command).expect("there is room");
        bench.step(2);
    };
    post(&mut bench, 0.001);
    assert_eq!((size(&bench), bench.tool(LEFT).burr), (2, Some(bench.body("2mm"))));
    post(&mut bench, 0.0017);
    assert_eq!(size(&bench), 2);
    let notices = bench.simulation.take_notices().concat();
    assert!(notices.contains("no burr of this tool") && notices.contains("0.003 m, 0.002 m, 0.001 m"), "{notices}");
    bench.simulation.reset_world();
    bench.step(1);
    assert_eq!(size(&bench), 6);
}

#[test]
fn keys_lead_it() {
    let mut bench = bench(&[], "ambf");
    assert_eq!(bench.problems, Vec::<String>::new());
    assert!(bench.simulation.take_notices().concat().contains("no body is a burr"));
    bench.step(1);
    // The scene has the program's camera or none: one step is a millimetre in any case.
    let before = bench.place_of("mastoidectomy_drill");
    bench.key(b'W', CONTROL);
    bench.key(b'W', CONTROL);
    let after = bench.place_of("mastoidectomy_drill");
    assert!(((after - before).norm() - 0.002).abs() < 1e-9, "{before} {after}");
    bench.key(b'S', CONTROL);
    bench.key(b'S', CONTROL);
    assert!((bench.place_of("mastoidectomy_drill") - before).norm() < 1e-9);
}

#[test]
fn keys_that_come_together_add_up() {
    let mut bench = bench(&[], "ambf");
    bench.step(1);
    let before = bench.place_of("mastoidectomy_drill");
    for _ in 0..10 {
        let key = b'W'.into();
        bench.simulation.plugins_input(&Input::Key { window: 1, key, scancode: 0, action: 1, mods: CONTROL });
    }
    bench.step(2);
    assert!(((bench.place_of("mastoidectomy_drill") - before).norm() - 0.01).abs() < 1e-9);
}

#[test]
fn a_recording_begins_with_the_drill() {
    let mut bench = bench(&["6mm"], "ambf");
    let (recorder, _tap) = recorder(false);
    bench.simulation.start_recording(recorder).expect("nothing has moved");
}

#[test]
fn a_reset_of_bodies_lets_the_volume_go() {
    let mut bench = bench(&["6mm"], "ambf");
    bench.step(1);
    bench.key(b'B', CONTROL);
    bench.lead(x(HALF + 0.002), 100);
    assert!(bench.tool(LEFT).is_touching);
    let before = bench.tool(LEFT);
    bench.simulation.reset_bodies();
    bench.step(1);
    let after = bench.tool(LEFT);
    assert!(!after.is_touching && after.force == Vector3::zeros());
    assert_eq!((after.is_on, after.radius), (before.is_on, before.radius));
}

#[test]
fn it_counts_voxels_if_asked_to() {
    let mut bench = bench(&["6mm", "1mm"], "ambf --nt 1 --removal count");
    bench.step(1);
    bench.lead(x(HALF + 0.002), 100);
    bench.step(100);
    let cuts = (bench.cuts)();
    assert!(cuts.len() > 40, "{}", cuts.len());
    assert!(cuts.iter().all(|cut| cut.carved.indices.len() == 10));
    assert!(cuts.windows(2).all(|pair| pair[1].sim_step - pair[0].sim_step >= 2), "in every second update");
}

#[test]
fn what_keeps_it_from_running_is_said() {
    let problem = |words: &str| bench(&["6mm"], words).problems.concat();
    for (words, expected) in [
        ("ambf --nt 9", "--nt is `9`"),
        ("ambf --drill_body chisel", "the scene has no body `chisel`"),
        ("ambf --anatomy_volume_name skull", "there is no volume that it could cut"),
    ] {
        let problem = problem(words);
        assert!(problem.contains(expected) && problem.contains("launch.yaml:7:5"), "{problem}");
    }
    // Of two volumes the one that is named.
    let mut bench = bench(&["6mm"], "ambf --anatomy_volume_name right");
    bench.step(1);
    let scene = bench.simulation.scene();
    assert!(scene.tool(LEFT, 0).is_none() && scene.tool(RIGHT, 0).is_some());
}

//! Volumes in a scene: read once for all worlds, cut by commands, part of saved states and resets.

use std::path::Path;
use std::sync::Arc;

use ambf_core::comm::{CarveCommand, VolumeCommand};
use ambf_core::ids::VolumeId;
use ambf_core::scene::{load, Loaded, SceneFiles, SceneOptions, VolumeError};
use ambf_core::sim::{Simulation, Stepper};
use ambf_core::volume::{nrrd, save, Label, Rule, Shape, Voxel, VoxelGrid};
use nalgebra::{Isometry3, Vector3};

const VOLUME: VolumeId = VolumeId::new(0);

/// A block of bone with a nerve in it, 40 × 32 × 24 voxels of 1 mm.
fn phantom() -> VoxelGrid {
    let labels = [[255, 249, 219], [255, 255, 0]].map(Label::of_color).to_vec();
    let edges = Vector3::new(0.04, 0.032, 0.024);
    VoxelGrid::from_fn([40, 32, 24], edges, 0.5, labels, |[i, j, k]| match (i, j, k) {
        (0, ..) | (39, ..) => Voxel::default(),
        (_, 14..18, 10..14) => Voxel { density: 255, label: 2 },
        _ => Voxel { density: 255, label: 1 },
    })
    .expect("a grid")
}

const CARRIER: &str = "bodies: [BODY carrier]\nBODY carrier:\n  name: carrier\n  mass: 0\n  collision shape: Sphere\n\
    \x20 collision geometry: {radius: 0.001}\n  location: {position: {x: 0.1, y: 0.2, z: 0.3}, orientation: {r: 0, p: 0, y: 1.5707963267948966}}\n";

fn files(folder: &Path, volume: &str) -> SceneFiles {
    let text = format!("volumes: [VOLUME bone]\nVOLUME bone:\n  name: bone\n  parent: carrier\n{volume}\n{CARRIER}");
    let (world, model) = (folder.join("world.yaml"), folder.join("model.yaml"));
    std::fs::write(&world, "gravity: {x: 0, y: 0, z: 0}\n").expect("written");
    std::fs::write(&model, text).expect("written");
    SceneFiles { world: Some(world), models: vec![model] }
}

fn of_pictures(folder: &Path) -> SceneFiles {
    save::pictures(&phantom(), &folder.join("slices"), "p0").expect("saved");
    let volume =
        "  images: {path: slices, prefix: p0, format: png, count: 100}\n  dimensions: {x: 0.04, y: 0.032, z: 0.024}\n\
                  \x20 labels: [{color: {r: 1, g: 1, b: 0}, name: nerve, hardness: 4}]";
    files(folder, volume)
}

fn stepper(files: &SceneFiles) -> Stepper {
    let Loaded { scene, report } = load(files, &SceneOptions { savable: true, ..SceneOptions::default() });
    assert_eq!(report.errors(), 0, "{report}");
    Stepper::new(Simulation::new(scene, 0.001), 0.001)
}

fn ball_at(position: Vector3<f64>, in_world: bool, rule: Rule) -> CarveCommand {
    let from = Isometry3::from(position);
    CarveCommand { shape: Shape::Sphere { radius: 0.004 }, from, to: from, in_world, rule }
}

#[test]
fn cuts_are_published_saved_restored_and_reset() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut stepper = stepper(&of_pictures(folder.path()));
    let solid = |stepper: &Stepper| stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels").count_solid();
    let first = Arc::clone(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels"));
    assert!(first.label_named("nerve").is_some_and(|label| first.labels()[usize::from(label)].hardness == 4.0));
    let all = 38 * 32 * 24;
    assert_eq!(solid(&stepper), all);
    let start = stepper.save().expect("it is at rest");
    // In the world the volume is where its parent is, turned by 90° about z: its x axis is y of the world.
    let place = Vector3::new(0.1, 0.2 + 0.01, 0.3);
    let carved = stepper.carve(VOLUME, &ball_at(place, true, Rule::All)).expect("a cut");
    let count = carved.indices.len();
    // 4/3 π 4³ = 268 voxels.
    assert!((240..300).contains(&count), "{count}");
    assert_eq!(solid(&stepper), all - count);
    let mean = carved.indices.iter().map(|index| f64::from(index[0]) + 0.5).sum::<f64>() / count as f64;
    assert!((mean - 30.0).abs() < 0.5, "{mean}");
    assert!(carved.colors.contains(&[255, 249, 219, 255]) && carved.colors.contains(&[255, 255, 0, 255]));
    assert!((carved.volume - count as f64 * 1e-9).abs() < 1e-15);
    // A rate goes on where it was, also after a state was restored.
    let rule = Rule::Rate { rate: 1.7e-9, interval: 1.0 };
    let slow = ball_at(Vector3::new(-0.01, 0.0, 0.0), false, rule);
    stepper.carve(VOLUME, &slow).expect("a cut");
    let saved = stepper.save().expect("it is at rest");
    let go_on = |stepper: &mut Stepper| {
        let cuts: Vec<_> = (0..20).map(|_| stepper.carve(VOLUME, &slow).expect("a cut").indices).collect();
        stepper.step(3).expect("nothing moves");
        (cuts, Arc::clone(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels")))
    };
    let once = go_on(&mut stepper);
    stepper.restore(&saved).expect("it fits");
    assert_eq!(solid(&stepper), all - count);
    let twice = go_on(&mut stepper);
    assert!(once == twice && once.0.iter().any(|cut| !cut.is_empty()));
    stepper.reset();
    assert!(Arc::ptr_eq(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels"), &first));
    stepper.restore(&saved).expect("it fits");
    stepper.restore(&start).expect("it fits");
    assert!(*stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels").as_ref() == *first);
    stepper.carve(VOLUME, &slow).expect("a cut");
    stepper.restore_voxels(VOLUME).expect("it is there");
    assert_eq!(solid(&stepper), all);
}

#[test]
fn worlds_share_what_was_not_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = of_pictures(folder.path());
    // What was written just now may change without being seen, and is not shared.
    std::thread::sleep(std::time::Duration::from_millis(200));
    let mut one = stepper(&files);
    let other = stepper(&files);
    let voxels = |stepper: &Stepper| Arc::clone(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels"));
    assert!(Arc::ptr_eq(&voxels(&one), &voxels(&other)));
    one.carve(VOLUME, &ball_at(Vector3::zeros(), false, Rule::All)).expect("a cut");
    assert!(!Arc::ptr_eq(&voxels(&one), &voxels(&other)));
    assert_eq!(voxels(&other).count_solid(), 38 * 32 * 24);
    assert_eq!(voxels(&stepper(&files)).count_solid(), 38 * 32 * 24);
}

#[test]
fn a_file_gives_voxels_edges_and_pose() {
    let folder = tempfile::tempdir().expect("a folder");
    let pose = Isometry3::new(Vector3::new(0.01, 0.02, 0.03), Vector3::new(0.1, 0.2, 0.3));
    nrrd::write(&phantom(), &folder.path().join("v.nrrd"), &pose).expect("saved");
    let read = stepper(&files(folder.path(), "  nrrd: v.nrrd"));
    let scene = read.simulation().scene();
    let volume = &scene.volumes[VOLUME];
    assert!((volume.attached.pose.to_homogeneous() - pose.to_homogeneous()).norm() < 1e-12);
    let grid = volume.voxels().expect("it has voxels");
    assert!((grid.edges() - phantom().edges()).norm() < 1e-12);
    assert_eq!(grid.count_solid(), 38 * 32 * 24);
    assert_eq!(scene.volume_named("bone"), Some(VOLUME));
    // What is written in the model file counts more.
    let volume = "  nrrd: v.nrrd\n  dimensions: {x: 0.4, y: 0.32, z: 0.24}\n  location: {position: {x: 1, y: 0, z: 0}, orientation: {r: 0, p: 0, y: 0}}\n  carvable: false";
    let mut read = stepper(&files(folder.path(), volume));
    let volume = &read.simulation().scene().volumes[VOLUME];
    assert_eq!(volume.attached.pose.translation.x, 1.0);
    assert!((volume.voxels().expect("it has voxels").edges() - 10.0 * phantom().edges()).norm() < 1e-12);
    let refused = read.carve(VOLUME, &ball_at(Vector3::zeros(), false, Rule::All)).expect_err("it says so");
    assert!(matches!(refused, VolumeError::NotCarvable(_)), "{refused}");
}

#[test]
fn what_cannot_be_read_is_reported_and_empty() {
    let folder = tempfile::tempdir().expect("a folder");
    let of = |volume: &str| load(&files(folder.path(), volume), &SceneOptions::default());
    let missing = "  images: {path: none, prefix: p, format: png, count: 3}";
    for (volume, expected) in [(missing, "no picture is there"), ("  nrrd: none.nrrd", "none.nrrd")] {
        let Loaded { scene, report } = of(volume);
        assert_eq!(report.errors(), 1, "{report}");
        assert!(
            report.to_string().contains(expected) && report.to_string().contains("the volume is empty"),
            "{report}"
        );
        let mut simulation = Simulation::new(scene, 0.001);
        let refused =
            simulation.carve(VOLUME, &ball_at(Vector3::zeros(), false, Rule::All)).expect_err("nothing is there");
        assert!(matches!(refused, VolumeError::Empty(_)), "{refused}");
        let refused = simulation.carve(VolumeId::new(7), &ball_at(Vector3::zeros(), false, Rule::All));
        assert!(matches!(refused, Err(VolumeError::Unknown)));
    }
}

#[test]
fn commands_of_clients_are_executed_in_order_and_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let Loaded { scene, report } = load(&of_pictures(folder.path()), &SceneOptions::default());
    assert_eq!(report.errors(), 0, "{report}");
    let mut simulation = Simulation::new(scene, 0.001);
    let hub = simulation.connect();
    let carve = |x: f64| VolumeCommand::Carve(ball_at(Vector3::new(x, 0.0, 0.0), false, Rule::All));
    let cuts = hub.follow_cuts();
    for command in [carve(0.01), VolumeCommand::Restore, carve(-0.01), carve(-0.01)] {
        hub.post_volume(VOLUME, command).expect("there is room");
    }
    let solid =
        |simulation: &Simulation| simulation.scene().volumes[VOLUME].voxels().expect("it has some").count_solid();
    simulation.iterate(0.001).expect("nothing moves");
    let told: Vec<_> = cuts.try_iter().collect();
    // The last one has found nothing to remove.
    assert_eq!(told.len(), 2);
    assert!(told.iter().all(|cut| cut.volume == VOLUME && cut.sim_step == 1));
    assert_eq!(solid(&simulation), 38 * 32 * 24 - told[1].carved.indices.len());
    // What waits when a reset is asked for is forgotten.
    hub.post_volume(VOLUME, carve(0.01)).expect("there is room");
    simulation.reset_world();
    simulation.iterate(0.001).expect("nothing moves");
    assert_eq!((solid(&simulation), cuts.try_iter().count()), (38 * 32 * 24, 0));
    // What cannot be done is said; what finds no room is refused.
    hub.post_volume(VolumeId::new(9), carve(0.0)).expect("there is room");
    simulation.iterate(0.001).expect("nothing moves");
    assert!(simulation.take_notices().concat().contains("a command of a volume is ignored: there is no volume"));
    let posted = (0..5000).take_while(|_| hub.post_volume(VOLUME, VolumeCommand::Restore).is_ok()).count();
    assert!((100..5000).contains(&posted), "{posted}");
}

/// The shipped scene, without devices.
fn drill() -> Stepper {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/drill");
    stepper(&SceneFiles { world: Some(folder.join("world.yaml")), models: vec![folder.join("drill.yaml")] })
}

/// Pushes the drill down with 0.5 N, against a damper of 5 N·s/m, for so many iterations.
fn push(stepper: &mut Stepper, iterations: u32) {
    let drill = stepper.objects().entries().find(|(_, object)| object.info.name == "drill").expect("it is there").0;
    for _ in 0..iterations {
        let world = &stepper.simulation().scene().world;
        let velocity = world.velocity(world.bodies()[0]).unwrap_or_default().0;
        let command = stepper.body_command(drill).expect("it is a body");
        *command =
            ambf_core::comm::RigidBodyCommand::wrench(Vector3::new(0.0, 0.0, -0.5) - 5.0 * velocity, Vector3::zeros());
        stepper.step(1).expect("it holds");
    }
}

#[test]
fn the_shipped_drill_is_held_by_the_phantom_and_cuts_it_the_same_each_time() {
    let mut stepper = drill();
    let first = Arc::clone(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels"));
    let nerve = first.label_named("nerve").expect("it has a nerve");
    let start = stepper.save().expect("it is at rest");
    let tool = |stepper: &Stepper| stepper.snapshot().tools[VOLUME][0];
    assert!(!tool(&stepper).is_touching && tool(&stepper).is_on);
    let run = |stepper: &mut Stepper| {
        push(stepper, 400);
        let (touching, force) = (tool(stepper).is_touching, tool(stepper).force);
        (touching, force, Arc::clone(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels")))
    };
    let (touching, force, cut) = run(&mut stepper);
    assert!(touching && force.z > 0.2, "{force}");
    let removed = first.count_solid() - cut.count_solid();
    // In contact it cuts at most 30 mm³/s, half of that in the hard layer: some 0.1 s or more of the 0.4 s.
    let volume = removed as f64 * first.voxel_volume() * 1e9;
    assert!((0.5..12.0).contains(&volume), "{volume} mm³");
    assert!(cut.label_named("nerve") == Some(nerve));
    stepper.restore(&start).expect("it fits");
    let again = run(&mut stepper);
    assert!(again.0 == touching && again.1 == force && *again.2 == *cut);
    stepper.reset();
    assert!(Arc::ptr_eq(stepper.snapshot().voxels[VOLUME].as_ref().expect("it has voxels"), &first));
}

#[test]
fn a_drill_that_is_off_holds_and_cuts_nothing() {
    let Loaded { scene, report } = {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/drill");
        let files = SceneFiles { world: Some(folder.join("world.yaml")), models: vec![folder.join("drill.yaml")] };
        load(&files, &SceneOptions::default())
    };
    assert_eq!(report.to_string(), "", "it loads without a word");
    let mut simulation = Simulation::new(scene, 0.001);
    let hub = simulation.connect();
    let cuts = hub.follow_cuts();
    hub.post_volume(VOLUME, VolumeCommand::Tool { tool: 0, on: Some(false), radius: Some(0.0015) })
        .expect("there is room");
    let body = simulation.scene().bodies.ids().next().expect("the drill");
    let height = |simulation: &Simulation| {
        let scene = simulation.scene();
        scene.bodies[body].pose(&scene.world).translation.z
    };
    for _ in 0..2000 {
        let world = &simulation.scene().world;
        let speed = world.velocity(world.bodies()[0]).unwrap_or_default().0;
        simulation.apply_wrench(body, Vector3::new(0.0, 0.0, -0.5) - 5.0 * speed, Vector3::zeros());
        simulation.iterate(0.001).expect("it holds");
    }
    // The top is at about 7.3 mm; the burr has 1.5 mm, and 0.5 N press it 0.7 mm in.
    let z = height(&simulation);
    assert!((0.0065..0.0095).contains(&z), "{z}");
    assert_eq!(cuts.try_iter().count(), 0);
    hub.post_volume(VOLUME, VolumeCommand::Tool { tool: 0, on: Some(true), radius: None }).expect("there is room");
    for _ in 0..300 {
        simulation.apply_wrench(body, Vector3::new(0.0, 0.0, -0.5), Vector3::zeros());
        simulation.iterate(0.001).expect("it holds");
    }
    let volume: f64 = cuts.try_iter().map(|cut| cut.carved.volume).sum();
    // Hardness 2: at most 15 mm³/s.
    assert!((1e-9..4.6e-9).contains(&volume), "{volume}");
    hub.post_volume(VOLUME, VolumeCommand::Tool { tool: 3, on: None, radius: None }).expect("there is room");
    simulation.iterate(0.001).expect("it holds");
    assert!(simulation.take_notices().concat().contains("no such tool"));
}

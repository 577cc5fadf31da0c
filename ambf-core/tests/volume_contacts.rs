//! Rigid bodies on volumes that ask for contact, against what mechanics and planes say, in both profiles.

use std::path::Path;
use std::sync::Arc;

use ambf_core::bullet::{Ray, RayTarget};
use ambf_core::comm::CarveCommand;
use ambf_core::control::Profile;
use ambf_core::ids::{BodyId, SensorId, VolumeId};
use ambf_core::scene::{load, Loaded, PhysicsOptions, Scene, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, Stepper};
use ambf_core::volume::{nrrd, Label, Rule, Shape, Voxel, VoxelGrid};
use nalgebra::{Isometry3, Vector3};

const VOLUME: VolumeId = VolumeId::new(0);
const VOXEL: f64 = 0.25e-3;
/// Height of the block's upper face above its centre, m.
const TOP: f64 = 12.0 * VOXEL;
const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

/// A block of 120 × 64 × 40 voxels of 0.25 mm, solid up to the 32nd layer.
fn block() -> VoxelGrid {
    let size = [120, 64, 40];
    let edges = Vector3::from_fn(|axis, _| size[axis] as f64 * VOXEL);
    VoxelGrid::from_fn(size, edges, 0.5, vec![Label::of_color([255; 3])], |[_, _, k]| {
        if k < 32 {
            Voxel { density: 255, label: 1 }
        } else {
            Voxel::default()
        }
    })
    .expect("a grid")
}

fn body(name: &str, shape: &str, at: [f64; 3], mass: f64, surface: &str) -> String {
    let [x, y, z] = at;
    format!(
        "BODY {name}:\n  name: {name}\n  mass: {mass}\n{shape}\n  location: {{position: {{x: {x}, y: {y}, z: {z}}}}}\n\
         \x20 damping: {{linear: 0, angular: 0}}\n{surface}\n"
    )
}

const BALL: &str = "  collision shape: Sphere\n  collision geometry: {radius: 0.005}";
const SMALL: &str = "  collision shape: Sphere\n  collision geometry: {radius: 0.002}";
const BOX: &str =
    "  collision shape: Box\n  collision geometry: {x: 0.01, y: 0.01, z: 0.01}\n  collision margin: 0.0001";
const SMOOTH: &str = "  friction: {static: 1, rolling: 0}\n  restitution: 0";
const CONTACT: &str = "  contact: {friction: {static: 0.3}, restitution: 0}";

struct Setting {
    folder: tempfile::TempDir,
    stepper: Stepper,
}

impl std::ops::Deref for Setting {
    type Target = Stepper;
    fn deref(&self) -> &Stepper {
        &self.stepper
    }
}

impl std::ops::DerefMut for Setting {
    fn deref_mut(&mut self) -> &mut Stepper {
        &mut self.stepper
    }
}

fn setting(
    profile: Profile,
    gravity: [f64; 3],
    grid: &VoxelGrid,
    volume: &str,
    bodies: &[(&str, String)],
    more: &str,
) -> Setting {
    let folder = tempfile::tempdir().expect("a folder");
    nrrd::write(grid, &folder.path().join("v.nrrd"), &Isometry3::identity()).expect("saved");
    let names = bodies.iter().map(|(name, _)| format!("BODY {name}")).collect::<Vec<_>>().join(", ");
    let texts: String = bodies.iter().map(|(_, text)| text.as_str()).collect();
    let volumes = format!("volumes: [VOLUME bone]\nVOLUME bone:\n  name: bone\n  nrrd: v.nrrd\n{volume}\n");
    let text = format!("{volumes}bodies: [{names}]\n{texts}{more}\n");
    let stepper = stepper(folder.path(), profile, gravity, &text);
    Setting { folder, stepper }
}

fn stepper(folder: &Path, profile: Profile, gravity: [f64; 3], text: &str) -> Stepper {
    stepper_with(folder, profile, None, gravity, text)
}

fn stepper_with(folder: &Path, profile: Profile, sleep: Option<bool>, [x, y, z]: [f64; 3], text: &str) -> Stepper {
    let (world, model) = (folder.join("world.yaml"), folder.join("model.yaml"));
    std::fs::write(&world, format!("gravity: {{x: {x}, y: {y}, z: {z}}}\n")).expect("written");
    std::fs::write(&model, text).expect("written");
    let files = SceneFiles { world: Some(world), models: vec![model] };
    let physics = PhysicsOptions { sleep, ..PhysicsOptions::default() };
    let options = SceneOptions { savable: true, physics, default_profile: Some(profile), ..SceneOptions::default() };
    let Loaded { scene, report } = load(&files, &options);
    assert!(report.errors() == 0 && report.notes.is_empty(), "{report}");
    Stepper::new(Simulation::new(scene, 0.001), 0.001)
}

const DOWN: [f64; 3] = [0.0, 0.0, -9.81];

fn scene(stepper: &Stepper) -> &Scene {
    stepper.simulation().scene()
}

fn pose(stepper: &Stepper, index: usize) -> Isometry3<f64> {
    let scene = scene(stepper);
    scene.world.pose(scene.world.bodies()[index]).expect("it is there")
}

fn velocity(stepper: &Stepper, index: usize) -> Vector3<f64> {
    let scene = scene(stepper);
    scene.world.velocity(scene.world.bodies()[index]).expect("it is there").0
}

fn hole(radius: f64) -> CarveCommand {
    let (from, to) = (Isometry3::translation(0.0, 0.0, 0.006), Isometry3::translation(0.0, 0.0, 0.0));
    CarveCommand { shape: Shape::Sphere { radius }, from, to, in_world: true, rule: Rule::All }
}

#[test]
fn a_ball_and_a_box_rest_at_the_height_of_the_surface() {
    for profile in PROFILES {
        for (shape, half) in [(BALL, 0.005), (BOX, 0.005), (SMALL, 0.002)] {
            let it = body("it", shape, [0.0013, 0.0007, TOP + half + 0.001], 0.1, SMOOTH);
            let mut on = setting(profile, DOWN, &block(), CONTACT, &[("it", it)], "");
            on.step(1000).expect("it holds");
            let (height, speed) = (pose(&on, 0).translation.z - half - TOP, velocity(&on, 0).norm());
            assert!(height.abs() < 5e-5 && speed < 1e-3, "{profile:?} {shape}: {height} {speed}");
            let tilt = pose(&on, 0).rotation.angle();
            assert!(shape != BOX || tilt < 1e-3, "{profile:?}: {tilt}");
            // The body that carries the volume has its name and is what touches.
            let scene = scene(&on);
            assert_eq!(scene.bodies[BodyId::new(1)].identity.key(), "BODY bone (volume)");
            let mut contacts = Vec::new();
            scene.world.contacts(scene.world.bodies()[0], 1e-4, &mut contacts);
            assert!(!contacts.is_empty() && contacts.iter().all(|c| c.other == scene.world.bodies()[1]));
            let weight: f64 = contacts.iter().map(|c| c.impulse / 0.001 * c.normal.z).sum();
            assert!((weight - 0.981).abs() < 0.02, "{profile:?} {shape}: {weight}");
        }
    }
}

#[test]
fn a_box_slides_with_the_friction_of_a_plane() {
    for profile in PROFILES {
        for (slope, expected) in [(0.5, 0.2), (0.25, 0.0)] {
            let (sine, cosine) = f64::atan(slope).sin_cos();
            let it = body("it", BOX, [-0.0072, 0.0003, TOP + 0.005], 0.1, SMOOTH);
            let gravity = [9.81 * sine, 0.0, -9.81 * cosine];
            let mut on = setting(profile, gravity, &block(), CONTACT, &[("it", it)], "");
            on.step(20).expect("it holds");
            let (from, before) = (pose(&on, 0).translation.vector, velocity(&on, 0).x);
            on.step(80).expect("it holds");
            let way = pose(&on, 0).translation.vector - from;
            let right = before * 0.08 + 0.5 * 9.81 * cosine * expected * 0.08_f64.powi(2);
            assert!((way.x - right).abs() < 0.02 * right + 1e-4, "{profile:?} {slope}: {way} {right}");
            assert!(way.z.abs() < 5e-5 && way.y.abs() < 1e-4, "{profile:?} {slope}: {way}");
        }
    }
}

#[test]
fn contact_follows_cuts_and_resets() {
    for profile in PROFILES {
        let it = body("it", SMALL, [0.0, 0.0, TOP + 0.002], 0.01, SMOOTH);
        let mut on = setting(profile, DOWN, &block(), CONTACT, &[("it", it)], "");
        let start = on.save().expect("it is at rest");
        let bits = |on: &Stepper| pose(on, 0).to_homogeneous().map(f64::to_bits);
        let run = |on: &mut Setting| {
            let mut all = Vec::new();
            on.step(300).expect("it holds");
            all.push(bits(on));
            assert!((pose(on, 0).translation.z - TOP - 0.002).abs() < 5e-5, "{profile:?}");
            assert!(!on.carve(VOLUME, &hole(0.004)).expect("a cut").indices.is_empty());
            // It falls from the next step on.
            on.step(2).expect("it holds");
            let speed = velocity(on, 0).z;
            assert!((-0.0201..-0.0097).contains(&speed), "{profile:?}: {speed}");
            let mid = on.save().expect("it is saved");
            on.step(400).expect("it holds");
            let height = pose(on, 0).translation.z;
            // The hole ends with a half ball of 4 mm about the middle of the block.
            assert!((-0.0023..-0.0016).contains(&height), "{profile:?}: {height}");
            all.push(bits(on));
            on.restore(&mid).expect("it fits");
            on.step(400).expect("it holds");
            all.push(bits(on));
            assert_eq!(all[1], all[2], "{profile:?}: as before it was saved");
            all
        };
        let first = run(&mut on);
        on.restore(&start).expect("it fits");
        assert_eq!(run(&mut on), first, "{profile:?}");
        on.reset();
        assert_eq!(run(&mut on), first, "{profile:?}: a reset closes the hole");
    }
}

#[test]
fn rays_hit_the_surface_also_where_it_was_cut() {
    for profile in PROFILES {
        let mut on = setting(profile, DOWN, &block(), CONTACT, &[], "");
        on.step(1).expect("it holds");
        let cast = |on: &Stepper, from: [f64; 3], to: [f64; 3]| {
            let mut hits = [None];
            scene(on).world.cast_rays(&[Ray { from: from.into(), to: to.into() }], &mut hits);
            hits[0]
        };
        let carrier = scene(&on).world.bodies()[0];
        let hit = cast(&on, [0.001, 0.0007, 0.1], [0.001, 0.0007, -0.1]).expect("it hits");
        assert_eq!(hit.target, RayTarget::Body(carrier));
        assert!((hit.point - Vector3::new(0.001, 0.0007, TOP)).norm() < 1e-9, "{hit:?}");
        assert!((hit.normal - Vector3::z()).norm() < 1e-9, "{hit:?}");
        // From far, at a small angle, over the whole volume.
        let hit = cast(&on, [-5.0, 0.001, TOP + 0.5], [5.0, 0.001, TOP - 0.5 + 1e-4]).expect("it hits");
        assert!((hit.point.z - TOP).abs() < 1e-9 && hit.point.x.abs() < 0.002, "{hit:?}");
        let hit = cast(&on, [-0.1, 0.001, 0.0011], [0.1, 0.001, 0.0011]).expect("it hits the side");
        assert!((hit.point.x + 0.015).abs() < 1e-9 && (hit.normal + Vector3::x()).norm() < 1e-9, "{hit:?}");
        assert!(cast(&on, [-0.1, 0.001, TOP + 1e-5], [0.1, 0.001, TOP + 1e-5]).is_none());
        on.carve(VOLUME, &hole(0.003)).expect("a cut");
        let hit = cast(&on, [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]).expect("it hits the bottom");
        assert!((hit.point.z + 0.003).abs() < VOXEL, "{hit:?}");
        on.restore_voxels(VOLUME).expect("it is there");
        let hit = cast(&on, [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]).expect("it hits");
        assert!((hit.point.z - TOP).abs() < 1e-9, "{hit:?}");
    }
}

#[test]
fn a_volume_of_a_body_acts_on_it() {
    // Both weigh 0.1 kg and stay together after the impact.
    for profile in PROFILES {
        let inertia =
            "  inertia: {ix: 1.0e-5, iy: 1.0e-5, iz: 1.0e-5}\n  restitution: 0\n  friction: {static: 0, rolling: 0}";
        let carrier = body("carrier", "  mesh: ''", [0.0, 0.0, 0.0], 0.1, inertia);
        let it =
            body("it", BALL, [0.0, 0.0, TOP + 0.006], 0.1, "  restitution: 0\n  friction: {static: 0, rolling: 0}");
        let volume = "  contact: true\n  parent: carrier";
        let mut on = setting(profile, [0.0; 3], &block(), volume, &[("carrier", carrier), ("it", it)], "");
        on.simulation_mut().set_velocity(BodyId::new(1), Vector3::new(0.0, 0.0, -0.1), Vector3::zeros());
        on.step(200).expect("it holds");
        for index in [0, 1] {
            let v = velocity(&on, index);
            assert!((v - Vector3::new(0.0, 0.0, -0.05)).norm() < 1e-3, "{profile:?} {index}: {v}");
        }
        let gap = pose(&on, 1).translation.z - pose(&on, 0).translation.z - TOP - 0.005;
        assert!(gap.abs() < 1e-4, "{profile:?}: {gap}");
    }
}

#[test]
fn a_moved_volume_carries_what_lies_on_it() {
    for profile in PROFILES {
        let it = body("it", BOX, [0.0, 0.0, TOP + 0.005], 0.1, SMOOTH);
        let mut on = setting(profile, DOWN, &block(), CONTACT, &[("it", it)], "");
        on.step(200).expect("it holds");
        // Up by 10 mm at 20 mm/s.
        for i in 1..=500 {
            let z = 2e-5 * f64::from(i);
            on.simulation_mut().follow_pose(BodyId::new(1), Vector3::new(0.0, 0.0, z), [0.0, 0.0, 0.0, 1.0]);
            on.step(1).expect("it holds");
        }
        let gap = pose(&on, 0).translation.z - pose(&on, 1).translation.z - TOP - 0.005;
        assert!((pose(&on, 1).translation.z - 0.01).abs() < 1e-4, "{profile:?}");
        assert!(gap.abs() < 1e-4, "{profile:?}: {gap}");
    }
}

#[test]
fn a_contact_sensor_feels_a_volume() {
    let it = body("it", BALL, [0.0, 0.0, TOP + 0.005], 0.1, SMOOTH);
    let sensor =
        "sensors: [SENSOR feel]\nSENSOR feel: {name: feel, type: contact, parent: BODY it, distance threshold: 0.001}";
    let mut on = setting(Profile::Legacy, DOWN, &block(), CONTACT, &[("it", it)], sensor);
    on.step(100).expect("it holds");
    let reading = &on.snapshot().contacts[SensorId::new(0)];
    assert!(matches!(&reading.bodies[..], [body] if body.identifier.ends_with("BODY bone (volume)")), "{reading:?}");
}

#[test]
fn without_the_key_nothing_collides_and_nothing_changes() {
    for profile in PROFILES {
        let plane = body(
            "floor",
            "  collision shape: Plane\n  collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: -0.02}",
            [0.0; 3],
            0.0,
            "",
        );
        let bodies =
            |it: &str| [("floor", plane.clone()), ("it", body("it", it, [0.0, 0.0, TOP + 0.006], 0.1, SMOOTH))];
        let run = |on: &mut Stepper| {
            on.step(500).expect("it holds");
            pose(on, 1).to_homogeneous().map(f64::to_bits)
        };
        let mut with = setting(profile, DOWN, &block(), "  contact: false", &bodies(BOX), "");
        let with_volume = run(&mut with);
        assert!((pose(&with, 1).translation.z + 0.015).abs() < 1e-4, "it lies on the floor");
        let text: String = bodies(BOX).into_iter().map(|(_, text)| text).collect();
        let text = format!("bodies: [BODY floor, BODY it]\n{text}");
        let mut without = stepper(with.folder.path(), profile, DOWN, &text);
        assert_eq!(run(&mut without), with_volume, "{profile:?}");
    }
}

#[test]
fn fast_small_balls_do_not_get_through() {
    let it = body(
        "it",
        "  collision shape: Sphere\n  collision geometry: {radius: 0.0005}",
        [0.0, 0.0, 0.053],
        0.001,
        SMOOTH,
    );
    let mut on = setting(Profile::Accurate, DOWN, &block(), CONTACT, &[("it", it)], "");
    on.step(400).expect("it holds");
    let height = pose(&on, 0).translation.z - TOP - 0.0005;
    assert!(height.abs() < 5e-5, "{height}");
}

/// A head of bone: rough, as scans are.
fn rough() -> VoxelGrid {
    let size = [160, 160, 80];
    let edges = Vector3::from_fn(|axis, _| size[axis] as f64 * VOXEL);
    VoxelGrid::from_fn(size, edges, 0.5, vec![Label::of_color([255; 3])], |[i, j, k]| {
        let (x, y) = (i as f64 * VOXEL, j as f64 * VOXEL);
        let height = 0.01 + 6e-4 * (x / 0.0031).sin() * (y / 0.0043).cos();
        if (k as f64) * VOXEL < height {
            Voxel { density: 255, label: 1 }
        } else {
            Voxel::default()
        }
    })
    .expect("a grid")
}

/// What this thread has used of a processor, s: others may keep it waiting.
fn processor_time() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux tells it");
    let spent: f64 = text.split(' ').next().and_then(|word| word.parse().ok()).expect("a number");
    1e-9 * spent
}

#[test]
fn a_box_on_rough_bone_comes_to_rest_and_costs_little() {
    for profile in PROFILES {
        for (shape, grid) in [(BOX, rough()), (BALL, rough()), (BOX, block()), (BALL, block())] {
            let top = if grid.size()[0] == 160 { 0.001 } else { TOP };
            let it = body(
                "it",
                shape,
                [0.0, 0.0, top + 0.006],
                0.05,
                "  friction: {static: 1, rolling: 0.001}\n  restitution: 0",
            );
            let contact = "  contact: {friction: {static: 0.8}, restitution: 0}";
            let mut on = setting(profile, DOWN, &grid, contact, &[("it", it)], "");
            on.step(2000).expect("it holds");
            let from = pose(&on, 0);
            let begin = processor_time();
            on.step(500).expect("it holds");
            let cost = (processor_time() - begin) / 500.0 * 1e6;
            let way = (pose(&on, 0).translation.vector - from.translation.vector).norm();
            eprintln!("{profile:?} {} {}: {cost:.0} us a step, moved {way:.1e} m", grid.size()[0], &shape[..24]);
            assert!(pose(&on, 0).translation.z > top + 0.003, "{}", pose(&on, 0));
            assert!(way < 2e-4 || shape == BALL, "{profile:?}: {way}");
            // A cavity that is cut below it, a little in each step: the surface at up to 27 bricks is made again each time.
            let begin = processor_time();
            for i in 0..100 {
                let at = Isometry3::translation(0.0, -0.003 + 6e-5 * f64::from(i), top - 0.003);
                let to = Isometry3::translation(0.0, 6e-5, 0.0) * at;
                let shape = Shape::Sphere { radius: 5e-4 };
                let cut = CarveCommand { shape, from: at, to, in_world: true, rule: Rule::All };
                on.carve(VOLUME, &cut).expect("a cut");
                on.step(1).expect("it holds");
            }
            let cost = (processor_time() - begin) / 100.0 * 1e6;
            eprintln!("    {cost:.0} us with a cut in each step");
            assert!((pose(&on, 0).translation.z - from.translation.z).abs() < 2e-4, "{profile:?}: {}", pose(&on, 0));
        }
    }
}

#[test]
fn sleeping_bodies_wake_when_their_support_is_cut_away() {
    for profile in PROFILES {
        let it = body("it", SMALL, [0.0, 0.0, TOP + 0.002], 0.01, SMOOTH);
        let on = setting(profile, DOWN, &block(), CONTACT, &[("it", it)], "");
        let text = std::fs::read_to_string(on.folder.path().join("model.yaml")).expect("it is there");
        let mut asleep = stepper_with(on.folder.path(), profile, Some(true), DOWN, &text);
        let is_asleep = |on: &Stepper| scene(on).world.is_asleep(scene(on).world.bodies()[0]) == Some(true);
        asleep.step(4000).expect("it holds");
        assert!(is_asleep(&asleep), "{profile:?}");
        let saved = asleep.save().expect("it is saved");
        // Far from it.
        let far = CarveCommand {
            from: Isometry3::translation(0.012, 0.0, 0.006),
            to: Isometry3::translation(0.012, 0.0, 0.0),
            ..hole(0.001)
        };
        asleep.carve(VOLUME, &hole(0.004)).expect("a cut");
        asleep.step(400).expect("it holds");
        assert!(pose(&asleep, 0).translation.z < 0.0, "{profile:?}");
        asleep.restore(&saved).expect("it fits");
        asleep.step(10).expect("it holds");
        assert!(is_asleep(&asleep) && (pose(&asleep, 0).translation.z - TOP - 0.002).abs() < 5e-5, "{profile:?}");
        asleep.carve(VOLUME, &far).expect("a cut");
        asleep.step(400).expect("it holds");
        assert!((pose(&asleep, 0).translation.z - TOP - 0.002).abs() < 5e-5, "{profile:?}");
    }
}

#[test]
fn worlds_have_surfaces_of_their_own() {
    let it = || body("it", SMALL, [0.0, 0.0, TOP + 0.002], 0.01, SMOOTH);
    let mut on = setting(Profile::Legacy, DOWN, &block(), CONTACT, &[("it", it())], "");
    let text = std::fs::read_to_string(on.folder.path().join("model.yaml")).expect("it is there");
    let mut other = stepper(on.folder.path(), Profile::Legacy, DOWN, &text);
    on.carve(VOLUME, &hole(0.004)).expect("a cut");
    on.step(200).expect("it holds");
    other.step(200).expect("it holds");
    assert!(pose(&on, 0).translation.z < 0.002 && (pose(&other, 0).translation.z - TOP - 0.002).abs() < 5e-5);
    let voxels = |stepper: &Stepper| Arc::clone(stepper.snapshot().voxels[VOLUME].as_ref().expect("voxels"));
    assert_ne!(voxels(&on).count_solid(), voxels(&other).count_solid());
}

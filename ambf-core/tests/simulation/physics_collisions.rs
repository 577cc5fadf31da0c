//! Who collides with whom.

use crate::physics_common::{close, Bench, HEAVY};
use nalgebra::Vector3;

/// A box 5 mm above a slab whose top is at z = 0; `SLAB` and `BOX` are further keys of either, `MODEL` of the model.
const SCENE: &str = "bodies: [BODY Slab, BODY Box]\nMODEL\n\
    BODY Slab: {name: Slab, mass: 0, location: {position: {x: 0, y: 0, z: -0.05}}, collision shape: Box, \
    collision geometry: {x: 2, y: 2, z: 0.1}SLAB}\n\
    BODY Box: {name: Box, mass: 1, location: {position: {x: 0, y: 0, z: 0.105}}, collision shape: Box, restitution: 0, \
    collision geometry: {x: 0.2, y: 0.2, z: 0.2}BOX}\n";

fn height_after_a_second(model: &str, slab: &str, falling: &str) -> f64 {
    let text = SCENE.replace("MODEL", model).replace("SLAB", slab).replace("BOX", falling);
    let mut bench = Bench::new(HEAVY, &text);
    bench.steps(1000);
    bench.position("Box").z
}

#[track_caller]
fn rests(height: f64) {
    close(height, 0.1, 1e-3);
}

#[track_caller]
fn falls(height: f64) {
    assert!(height < -4.0, "{height}");
}

#[test]
fn bodies_collide_unless_told_otherwise() {
    rests(height_after_a_second("", "", ""));
    rests(height_after_a_second("ignore inter-collision: false", "", ""));
    falls(height_after_a_second("ignore inter-collision: true", "", ""));
}

#[test]
fn bodies_collide_if_they_share_a_group_or_one_has_none() {
    let groups = |list: &str| format!(", collision groups: [{list}]");
    for (slab, falling, is_held) in [
        ("1", "1", true),
        ("1", "2", false),
        ("1, 2", "2, 3", true),
        ("1, 4", "2, 3", false),
        ("0", "999", false),
        ("", "7", true),
    ] {
        let slab = if slab.is_empty() { String::new() } else { groups(slab) };
        let height = height_after_a_second("", &slab, &groups(falling));
        if is_held {
            rests(height)
        } else {
            falls(height)
        }
    }
}

#[test]
fn groups_hold_between_models() {
    let [slab, falling]: [String; 2] = std::array::from_fn(|i| {
        let text = SCENE.replace("MODEL", "").replace("SLAB", "").replace("BOX", "");
        let lines: Vec<_> = text.lines().collect();
        let name = ["BODY Slab", "BODY Box"][i];
        let line = lines.iter().find(|line| line.starts_with(&format!("{name}:"))).expect("the body");
        format!("bodies: [{name}]\n{}, collision groups: [G]}}\n", line.trim_end_matches('}'))
    });
    for (group, is_held) in [("5", true), ("6", false)] {
        // The last brace of the geometry was cut off as well.
        let close_geometry = |text: &str, group: &str| {
            text.replace(", collision groups: [G]", &format!("}}, collision groups: [{group}]"))
        };
        let models = [close_geometry(&slab, "5"), close_geometry(&falling, group)];
        let loaded = crate::physics_common::load_texts(HEAVY, &[&models[0], &models[1]]);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        let mut bench = Bench(ambf_core::sim::Simulation::new(loaded.scene, crate::physics_common::DT));
        bench.steps(1000);
        let height = bench.position("Box").z;
        if is_held {
            rests(height)
        } else {
            falls(height)
        }
    }
}

#[test]
fn a_joint_lets_its_bodies_overlap_unless_told_otherwise() {
    // Two overlapping boxes on a common axis; a push apart would turn the free one.
    let text = |key: &str| {
        format!(
            "bodies: [BODY A, BODY B]\njoints: [J]\n\
             BODY A: {{name: A, mass: 0, collision shape: Box, collision geometry: {{x: 0.2, y: 0.2, z: 0.2}}}}\n\
             BODY B: {{name: B, mass: 1, location: {{position: {{x: 0.15, y: 0.02, z: 0}}}}, collision shape: Box, \
             collision geometry: {{x: 0.2, y: 0.2, z: 0.2}}}}\n\
             J: {{name: J, parent: BODY A, child: BODY B, type: prismatic, parent axis: {{x: 1, y: 0, z: 0}}, \
             child axis: {{x: 1, y: 0, z: 0}}, parent pivot: {{x: 0.15, y: 0.02, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}, \
             joint limits: {{low: -1, high: 1}}{key}}}\n"
        )
    };
    let moved = |key: &str| {
        let mut bench = Bench::new("gravity: {x: 0, y: 0, z: 0}\n", &text(key));
        bench.steps(500);
        bench.position("B").x - 0.15
    };
    close(moved(""), 0.0, 1e-9);
    close(moved(", ignore inter-collision: true"), 0.0, 1e-9);
    assert!(moved(", ignore inter-collision: false") > 0.03);
}

#[test]
fn static_bodies_do_not_collide_with_each_other() {
    let text = SCENE.replace("MODEL", "").replace("SLAB", "").replace("BOX", "").replace("mass: 1", "mass: 0");
    let mut bench = Bench::new(HEAVY, &text.replace("z: 0.105", "z: 0.0"));
    bench.steps(10);
    assert_eq!(bench.0.scene().world.contact_count(), 0);
    assert_eq!(bench.position("Box").z, 0.0);
}

/// Whether a ball of 5 mm radius shot at 100 m/s at a wall of 1 mm is behind it after 20 ms; its keys and the profile
/// are given.
fn passes_a_wall(profile: &str, keys: &str) -> bool {
    let world = format!("gravity: {{x: 0, y: 0, z: 0}}\nphysics: {{profile: {profile}}}\n");
    let text = format!(
        "bodies: [BODY Wall, BODY Ball]\n\
         BODY Wall: {{name: Wall, mass: 0, collision shape: Box, collision geometry: {{x: 0.001, y: 1, z: 1}}}}\n\
         BODY Ball: {{name: Ball, mass: 0.01, location: {{position: {{x: -0.53, y: 0.1, z: 0}}}}, collision shape: Sphere, \
         collision geometry: {{radius: 0.005}}{keys}}}\n"
    );
    let mut bench = Bench::new(&world, &text);
    bench.throw("Ball", nalgebra::Vector3::new(100.0, 1.0, 0.0));
    bench.steps(20);
    bench.position("Ball").x > 0.0
}

#[test]
fn a_fast_ball_is_stopped_by_a_thin_wall_in_the_accurate_profile_and_on_request() {
    assert!(passes_a_wall("legacy", ""));
    assert!(!passes_a_wall("legacy", ", continuous collision: true"));
    assert!(!passes_a_wall("accurate", ""));
    assert!(passes_a_wall("accurate", ", continuous collision: false"));
}

/// A world of the accurate profile with sub-steps of `step` s.
fn accurate(step: f64, text: &str) -> Bench {
    let world = format!("gravity: {{x: 0, y: 0, z: -10}}\nphysics: {{profile: accurate, sub step: {step}}}\n");
    let loaded = crate::physics_common::load_texts(&world, &[text]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(ambf_core::sim::Simulation::new(loaded.scene, step))
}

/// Contacts of boxes used to be found only where they overlap, two sub-steps late.
#[test]
fn boxes_that_stand_exactly_on_each_other_do_not_sink() {
    let body = |name: &str, mass: f64, size: f64, z: f64| {
        format!(
            "BODY {name}: {{name: {name}, mass: {mass}, location: {{position: {{x: 0, y: 0, z: {z}}}}}, collision shape: Box, \
             restitution: 0, collision geometry: {{x: {size}, y: {size}, z: {size}}}}}\n"
        )
    };
    let text = format!(
        "bodies: [BODY Slab, BODY Low, BODY High]\n{}{}{}",
        body("Slab", 0.0, 2.0, -1.0),
        body("Low", 1.0, 0.2, 0.1),
        body("High", 1.0, 0.2, 0.3)
    );
    for step in [0.001, 0.01] {
        let mut bench = accurate(step, &text);
        for _ in 0..50 {
            bench.update(step);
            close(bench.position("High").z, 0.3, 1e-5);
        }
    }
}

/// Heights above a ground, m, of twelve bodies of 1 g that have fallen 0.2 m onto it and lain there, in all 0.5 s.
fn heights_after_a_fall(step: f64, ground: &str, shape: &str, restitution: f64) -> Vec<f64> {
    let names: Vec<_> = (0..12).map(|i| format!("BODY B{i}")).collect();
    let mut text = format!(
        "bodies: [BODY Ground, {}]\nBODY Ground: {{name: Ground, mass: 0, location: {{position: {{x: 0.9, y: 0, z: 0}}}}, {ground}}}\n",
        names.join(", "),
    );
    for i in 0..12 {
        let turn = |f: f64| 0.6 * (f64::from(i) * f + shape.len() as f64).sin();
        text += &format!(
            "BODY B{i}: {{name: B{i}, mass: 0.001, location: {{position: {{x: {}, y: 0, z: {}}}, \
             orientation: {{r: {}, p: {}, y: {}}}}}, restitution: {restitution}, {shape}}}\n",
            0.15 * f64::from(i),
            0.2 + 0.001 * f64::from(i),
            turn(1.3),
            turn(2.1),
            turn(0.7)
        );
    }
    let mut bench = accurate(step, &text);
    (0..(0.5 / step) as u32).for_each(|_| bench.update(step));
    (0..12).map(|i| bench.position(&format!("B{i}")).z).collect()
}

/// A plate whose top is at z = 0.
fn plate(thickness: f64) -> String {
    format!(
        "collision shape: Box, collision geometry: {{x: 3, y: 0.5, z: {thickness}}}, \
         collision offset: {{position: {{x: 0, y: 0, z: {}}}}}",
        -thickness / 2.0
    )
}

const THIN_SHAPES: [&str; 4] = [
    "collision shape: Box, collision geometry: {x: 0.03, y: 0.001, z: 0.001}",
    "collision shape: Box, collision geometry: {x: 0.03, y: 0.03, z: 0.001}",
    "collision shape: Cylinder, collision geometry: {radius: 0.02, height: 0.001, axis: z}",
    "collision shape: Capsule, collision geometry: {radius: 0.0005, height: 0.03, axis: y}",
];

/// Rods, sheets, discs and needles used to go through: the sphere that is swept does not see their ends. Those that rebound
/// had no contact before they touched.
#[test]
fn thin_bodies_do_not_fall_through_thin_plates() {
    let mut through = vec![];
    for (step, thickness) in [(0.001, 0.001), (0.001, 0.002), (0.005, 0.002), (0.005, 0.01)] {
        for shape in THIN_SHAPES {
            for restitution in [0.0, 0.1] {
                let heights = heights_after_a_fall(step, &plate(thickness), shape, restitution);
                let count = heights.iter().filter(|&&z| z <= 0.0).count();
                if count > 0 {
                    through.push(format!("{shape}, {restitution}, plate {thickness} m, step {step} s: {heights:?}"));
                }
                // What spins by more than half a radian in a sub-step may get through.
                assert!(count <= usize::from(step > 0.001), "{through:#?}");
            }
        }
    }
    assert!(through.len() <= 6, "{through:#?}");
}

/// The same on the triangles of a mesh, also of a ring, in which no sphere can be swept.
#[test]
fn thin_bodies_do_not_fall_through_meshes() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = "v -1.5 -0.25 0\nv 1.5 -0.25 0\nv 1.5 0.25 0\nv -1.5 0.25 0\nf 1 2 3\nf 1 3 4\n";
    std::fs::write(folder.path().join("flat.obj"), text).expect("written");
    let ground = format!("collision mesh: flat.obj, high resolution path: {}", folder.path().display());
    let part = |n: u32| {
        let angle = f64::from(n) * std::f64::consts::FRAC_PI_4;
        format!(
            "{{shape: Box, geometry: {{x: 0.001, y: 0.009, z: 0.001}}, \
             offset: {{position: {{x: {}, y: {}, z: 0}}, orientation: {{r: 0, p: 0, y: {angle}}}}}}}",
            0.01 * angle.cos(),
            0.01 * angle.sin()
        )
    };
    let ring = format!("compound collision shape: [{}]", (0..8).map(part).collect::<Vec<_>>().join(", "));
    for shape in THIN_SHAPES.into_iter().chain([ring.as_str()]) {
        for restitution in [0.0, 0.1] {
            let heights = heights_after_a_fall(0.001, &ground, shape, restitution);
            assert!(heights.iter().all(|&z| z > 0.0), "{shape}, {restitution}: {heights:?}");
        }
    }
}

#[test]
fn continuous_collision_of_a_body_without_an_inside_is_refused() {
    let text = "bodies: [BODY A, BODY B]\nBODY A: {name: A, mass: 1, continuous collision: true}\nBODY B: {name: B, mass: 1}\n";
    let world = format!("{HEAVY}physics: {{profile: accurate}}\n");
    let report = crate::physics_common::load_texts(&world, &[text]).report.to_string();
    assert_eq!(report.matches("continuous collision").count(), 1, "{report}");
    assert!(report.contains("m0.yaml:2") && report.contains("BODY A"), "{report}");
}

#[test]
fn friction_knows_what_torques_do_in_the_same_sub_step() {
    let world = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\nphysics: {profile: accurate}\n";
    let model = "bodies: [BODY Ground, BODY Ball]\n\
        BODY Ground: {name: Ground, mass: 0, location: {position: {x: 0, y: 0, z: -0.05}}, collision shape: Box, \
        collision geometry: {x: 4, y: 4, z: 0.1}, friction: {static: 1, rolling: 0}}\n\
        BODY Ball: {name: Ball, mass: 1, location: {position: {x: 0, y: 0, z: 0.1}}, collision shape: Sphere, \
        collision geometry: {radius: 0.1}, friction: {static: 1, rolling: 0}, restitution: 0, damping: {linear: 0, angular: 0}}\n";
    let mut bench = Bench::new(world, model);
    let ball = bench.body("Ball");
    bench.steps(10);
    for _ in 0..300 {
        bench.0.apply_wrench(ball, Vector3::zeros(), Vector3::new(0.0, 0.1, 0.0));
        bench.steps(1);
        let (linear, angular) = bench.velocity("Ball");
        close(linear.x, 0.1 * angular.y, 1e-6);
    }
    // τ / (m r² + 2 m r² / 5) for 0.3 s.
    let (_, angular) = bench.velocity("Ball");
    close(angular.y, 0.1 / 0.014 * 0.3, 1e-4);
}

/// A gutter along y as OBJ: 3 m × 1 m × 2 m about x = 0 on z = 0, its hollow 1 m wide and 1 m deep.
fn gutter() -> tempfile::TempDir {
    let profile = [(-1.5, 0.0), (1.5, 0.0), (1.5, 2.0), (0.5, 2.0), (0.5, 1.0), (-0.5, 1.0), (-0.5, 2.0), (-1.5, 2.0)];
    let mut text = String::new();
    for y in [-0.5, 0.5] {
        profile.iter().for_each(|(x, z)| text += &format!("v {x} {y} {z}\n"));
    }
    let n = profile.len();
    for i in 0..n {
        let j = (i + 1) % n;
        text += &format!("f {} {} {}\nf {} {} {}\n", i + 1, j + 1, j + n + 1, i + 1, j + n + 1, i + n + 1);
    }
    // The ends: floor, right wall, left wall, as triangles of the profile.
    for [a, b, c] in [[1, 2, 5], [1, 5, 6], [2, 3, 4], [2, 4, 5], [1, 6, 7], [1, 7, 8]] {
        text += &format!("f {a} {c} {b}\nf {} {} {}\n", a + n, b + n, c + n);
    }
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("gutter.OBJ"), text).expect("written");
    folder
}

/// Keys of the gutter as a geometry, at a tenth of its size.
fn gutter_keys(folder: &tempfile::TempDir) -> String {
    format!(
        "mesh: gutter.OBJ, high resolution path: {0}, low resolution path: {0}, scale: 0.1, \
         collision mesh type: CONVEX_DECOMPOSITION",
        folder.path().display()
    )
}

#[test]
fn a_ball_lies_in_a_divided_mesh_that_is_scaled_off_its_centre_of_mass_and_moves() {
    let folder = gutter();
    let text = |kind: &str| {
        format!(
            "bodies: [BODY Slab, BODY Gutter, BODY Ball]\n\
             BODY Slab: {{name: Slab, mass: 0, location: {{position: {{x: 0, y: 0, z: -0.05}}}}, collision shape: Box, \
             collision geometry: {{x: 2, y: 2, z: 0.1}}}}\n\
             BODY Gutter: {{name: Gutter, mass: 10, location: {{position: {{x: 0.3, y: 0.2, z: 0.01}}, \
             orientation: {{r: 0, p: 0, y: 0.7}}}}, inertial offset: {{position: {{x: 0.03, y: -0.02, z: 0.05}}, \
             orientation: {{r: 0.4, p: 0, y: 0}}}}, inertia: {{ix: 0.1, iy: 0.1, iz: 0.1}}, {kind}}}\n\
             BODY Ball: {{name: Ball, mass: 0.1, location: {{position: {{x: 0.3, y: 0.2, z: 0.25}}}}, \
             collision shape: Sphere, collision geometry: {{radius: 0.03}}, damping: {{linear: 0.1, angular: 0.9}}}}\n"
        )
    };
    let ball_above_gutter = |kind: &str| {
        let mut bench = Bench::new(HEAVY, &text(kind));
        bench.steps(1500);
        close(bench.position("Gutter").z, 0.0, 2e-3);
        bench.position("Ball").z - bench.position("Gutter").z
    };
    let keys = gutter_keys(&folder);
    // On the floor of the hollow; on the rim's level, were it filled.
    close(ball_above_gutter(&keys), 0.13, 3e-3);
    close(ball_above_gutter(&keys.replace("DECOMPOSITION", "HULL")), 0.23, 3e-3);
}

#[test]
fn the_hollow_of_a_divided_ghost_is_outside_of_it() {
    let folder = gutter();
    let text = format!(
        "bodies: [BODY Within, BODY Between]\nghost objects: [GHOST zone]\n\
         BODY Within: {{name: Within, mass: 1, location: {{position: {{x: -0.1, y: 0, z: 0.15}}}}, \
         collision shape: Sphere, collision geometry: {{radius: 0.02}}}}\n\
         BODY Between: {{name: Between, mass: 1, location: {{position: {{x: 0, y: 0, z: 0.15}}}}, \
         collision shape: Sphere, collision geometry: {{radius: 0.02}}}}\n\
         GHOST zone: {{name: zone, {}}}\n",
        gutter_keys(&folder)
    );
    let mut bench = Bench::new(HEAVY, &text);
    bench.steps(50);
    let (within, between) = (bench.body("Within"), bench.body("Between"));
    let scene = bench.0.scene();
    let sensed: Vec<_> = scene.ghosts[ambf_core::ids::GhostId::new(0)].sensed(&scene.bodies).collect();
    assert!(sensed.contains(&within) && !sensed.contains(&between), "{sensed:?}");
    close(bench.velocity("Between").0.z, -0.5, 0.02);
    close(bench.velocity("Within").0.z, 0.0, 0.02);
}

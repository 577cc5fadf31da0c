//! Rings as meshes, written in the usual ways, keep their holes: they fall over a peg.

use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::path::Path;

use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

const INNER: f64 = 0.0055;
const HEIGHT: f64 = 0.004;
const DT: f64 = 0.001;

/// The four corners of a cross-section of a ring of `n` parts; the hole between them has at least the radius `INNER`.
fn section(i: usize, n: usize, outer: f64) -> [[f64; 3]; 4] {
    let (sin, cos) = (TAU * i as f64 / n as f64).sin_cos();
    let inner = INNER / (PI / n as f64).cos();
    let at = |radius: f64, z: f64| [radius * cos, radius * sin, z];
    let half = HEIGHT / 2.0;
    [at(inner, -half), at(outer, -half), at(outer, half), at(inner, half)]
}

fn vertices(text: &mut String, corners: &[[f64; 3]]) {
    for [x, y, z] in corners {
        writeln!(text, "v {x:.9} {y:.9} {z:.9}").expect("a string grows");
    }
}

/// A closed surface.
fn shell(outer: f64) -> String {
    const N: usize = 32;
    let mut text = String::new();
    (0..N).for_each(|i| vertices(&mut text, &section(i, N, outer)));
    for (i, k) in (0..N).flat_map(|i| (0..4).map(move |k| (i, k))) {
        let at = |i: usize, k: usize| 4 * (i % N) + k % 4 + 1;
        writeln!(text, "f {} {} {} {}", at(i, k), at(i + 1, k), at(i + 1, k + 1), at(i, k + 1))
            .expect("a string grows");
    }
    text
}

/// Twelve convex parts, each after a line `KEYWORD mI`, and before all of them `head`.
fn parts(keyword: &str, head: &str) -> String {
    const N: usize = 12;
    let mut text = format!("{head}\n");
    for i in 0..N {
        vertices(&mut text, &section(i, N, 0.009));
        vertices(&mut text, &section(i + 1, N, 0.009));
    }
    for i in 0..N {
        writeln!(text, "{keyword} m{i}").expect("a string grows");
        for face in [[0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]] {
            let [a, b, c, d] = face.map(|corner| 8 * i + corner + 1);
            writeln!(text, "f {a} {b} {c} {d}").expect("a string grows");
        }
    }
    text
}

const GROUND: &str = "<robot name='p'><link name='world'><collision><origin xyz='0 0 -0.045'/><geometry><box size='0.2 0.2 0.01'/>\
    </geometry></collision><collision><origin xyz='0 0 -0.025'/><geometry><cylinder radius='0.005' length='0.03'/></geometry>\
    </collision></link></robot>";

/// Height in mm at which a ring, as this file describes it, comes to rest; its note, if there is one, about holes.
fn rest(folder: &Path, name: &str, ring: &str, profile: Profile) -> (f64, Vec<String>) {
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let world = "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\n";
    let files = SceneFiles {
        world: Some(write("world.yaml", world)),
        models: vec![write(name, ring), write("ground.urdf", GROUND)],
    };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let Loaded { scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(report.errors(), 0, "{report}");
    let notes = report.notes.iter().map(ToString::to_string).filter(|note| note.contains("holes")).collect();
    let mut simulation = Simulation::new(scene, DT);
    (0..2000).for_each(|_| simulation.update(DT).map(|_| ()).expect("a step"));
    let scene = simulation.scene();
    let ring = scene.bodies.iter().find(|body| &*body.identity.name == "ring").expect("the ring");
    (ring.pose(&scene.world).translation.z * 1e3, notes)
}

fn urdf(mesh: &Path) -> String {
    format!(
        "<robot name='r'><link name='ring'><inertial><mass value='0.005'/><inertia ixx='2e-7' ixy='0' ixz='0' iyy='2e-7' iyz='0' \
         izz='2e-7'/></inertial><collision><geometry><mesh filename='{}'/></geometry></collision></link></robot>",
        mesh.display()
    )
}

fn adf(folder: &Path, mesh: &str, keys: &str) -> String {
    format!(
        "bodies: [BODY ring]\njoints: []\nnamespace: /ambf/env/r/\nBODY ring:\n  name: ring\n  mass: 0.005\n  location: {{position: {{x: 0, y: \
         0, z: 0}}}}\n  inertial offset: {{position: {{x: 0, y: 0, z: 0}}, orientation: {{r: 0, p: 0, y: 0}}}}\n  inertia: {{ix: 1.5e-7, iy: \
         1.5e-7, iz: 2.8e-7}}\n  high resolution path: {0}/\n  low resolution path: {0}/\n  mesh: {mesh}\n  collision mesh: {mesh}\n  friction: \
         {{static: 0.5, rolling: 0}}\n  restitution: 0\n{keys}",
        folder.display()
    )
}

#[test]
fn rings_fall_over_a_peg_however_they_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let library: String = (0..12).map(|i| format!("newmtl m{i}\nKd 1 0 0\n")).collect();
    for (name, text) in [
        ("shell.obj", shell(0.009)),
        ("objects.obj", parts("o", "")),
        ("groups.obj", parts("g", "o ring")),
        ("materials.obj", parts("usemtl", "mtllib materials.mtl\no ring")),
        ("nameless.obj", parts("usemtl", "o ring")),
        ("materials.mtl", library),
    ] {
        std::fs::write(folder.join(name), text).expect("written");
    }
    let mut wrong = Vec::new();
    let mut check = |what: &str, found: f64, tolerance: f64| {
        println!("{what}: {found} mm");
        if found.is_nan() || (found + 38.0).abs() >= tolerance {
            wrong.push(format!("{what}: {found} mm instead of -38 ± {tolerance}"));
        }
    };
    for mesh in ["shell.obj", "objects.obj", "groups.obj", "materials.obj", "nameless.obj"] {
        for profile in [Profile::Legacy, Profile::Accurate] {
            let (found, notes) = rest(folder, "ring.urdf", &urdf(&folder.join(mesh)), profile);
            check(&format!("URDF {mesh} {profile:?}"), found, 1.2);
            assert_eq!(notes.len(), usize::from(mesh == "shell.obj"), "{notes:?}");
        }
    }
    let hull = "  collision mesh type: CONVEX_HULL\n";
    let divided = "  collision mesh type: CONVEX_DECOMPOSITION\n";
    let thin = "  collision margin: 0.0001\n";
    for (mesh, keys, tolerance) in [
        ("shell.obj", String::new(), 1.2),
        ("shell.obj", divided.to_owned(), 1.2),
        ("shell.obj", format!("{divided}{thin}"), 0.2),
        ("objects.obj", hull.to_owned(), 1.2),
        ("objects.obj", format!("{hull}{thin}"), 0.2),
        ("groups.obj", format!("{hull}{thin}"), 0.2),
        ("nameless.obj", format!("{hull}{thin}"), 0.2),
        ("materials.obj", format!("{hull}{thin}"), 0.2),
        ("materials.obj", hull.to_owned(), 1.2),
    ] {
        let (found, notes) = rest(folder, "ring.yaml", &adf(folder, mesh, &keys), Profile::Accurate);
        assert!(notes.is_empty(), "{notes:?}");
        check(&format!("ADF {mesh} {keys:?}"), found, tolerance);
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    // What a file asks for is done, and said.
    let (closed, notes) = rest(folder, "ring.yaml", &adf(folder, "shell.obj", hull), Profile::Accurate);
    assert!(closed > -10.0 && notes.len() == 1 && notes[0].contains("closes the holes"), "{closed} {notes:?}");
}

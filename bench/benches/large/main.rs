//! Concave meshes, sleeping heaps, many contact sensors, models that come and go: `scripts/bench large [--quick]
//! [--only PART]…`

mod shapes;

use std::fmt::Write;
use std::path::PathBuf;
use std::process::exit;

use ambf_bench::plot::Figure;
use ambf_bench::report::{self, Section};
use ambf_bench::statistics::{short, Spread};
use ambf_core::adf::ConvexDecomposition;
use ambf_core::bullet::ContactLists;
use ambf_core::control::Profile;
use ambf_core::scene::{convex_hulls, load, PhysicsOptions, PreparedModel, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;
use rustix::time::{clock_gettime, ClockId};
use shapes::Shape;

/// Length of a step, s.
const DT: f64 = 0.001;
/// Bodies of a heap of concave meshes.
const BODIES: usize = 45;
/// Sensors on boxes of a heap of 200.
const SENSORS: usize = 50;
/// A floor at z = 0 under gravity.
const WORLD: &str = "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\n";
const FLOOR: &str = "FLOOR: {name: Floor, mass: 0, friction: {static: 0.9, rolling: 0.1}, collision shape: Plane, \
                     collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}}\n";

/// What is measured, in this order: memory of the process while it is small.
const PARTS: [&str; 4] = ["changes", "concave", "sleep", "sensors"];

/// How a mesh collides: name, value of `collision mesh type`, hulls of its geometry.
const KINDS: [(&str, &str, u32); 3] = [
    ("mesh as it is (GImpact)", "CONCAVE_MESH", 0),
    ("convex hull", "CONVEX_HULL", 1),
    ("decomposition", "CONVEX_DECOMPOSITION", 32),
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == "--bench") {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench large");
        return;
    }
    let (mut quick, mut only) = (false, Vec::new());
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match (argument.as_str(), rest.as_slice().first().map(String::as_str)) {
            ("--bench", _) => (),
            ("--quick", _) => quick = true,
            ("--only", Some(part)) if PARTS.contains(&part) => only.extend(rest.next().map(String::as_str)),
            _ => {
                eprintln!("bench large: {argument} is not known; expected --quick, --only {}", PARTS.join("|"));
                exit(1);
            }
        }
    }
    let machine = report::machine(quick);
    println!("{machine}\n");
    let rounds = if quick { 5 } else { 20 };
    let measure = |part: &&str| match *part {
        "changes" => changes(if quick { &[100, 1000] } else { &[100, 1000, 5000] }),
        "concave" => concave(rounds, if quick { 1000 } else { usize::MAX }),
        "sleep" => sleep(rounds),
        _ => sensors(rounds),
    };
    let wanted = PARTS.iter().filter(|part| only.is_empty() || only.contains(part));
    let sections: Vec<Section> = wanted.map(measure).inspect(|section| println!("{section}")).collect();
    if !quick && only.is_empty() {
        report::publish("benchmarks/large.md", "figures", &machine, &sections, &[] as &[(&str, Figure)]);
    }
}

/// CPU time of this thread, s.
fn cpu() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Calls `work` and tells what it took, µs of CPU time.
fn timed(work: impl FnOnce()) -> f64 {
    let begin = cpu();
    work();
    (cpu() - begin) * 1e6
}

fn written(name: &str, text: &str) -> PathBuf {
    let path = ambf_bench::folder().join(name);
    std::fs::write(&path, text).expect("the target folder can be written");
    path
}

fn simulation(world: PathBuf, model: PathBuf, physics: PhysicsOptions) -> Simulation {
    let files = SceneFiles { world: Some(world), models: vec![model] };
    let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, DT)
}

fn update(simulation: &mut Simulation, steps: usize) {
    for _ in 0..steps {
        simulation.update(DT).unwrap_or_else(|problem| panic!("{problem}"));
    }
}

fn places(simulation: &Simulation) -> Vec<Vector3<f64>> {
    let world = &simulation.scene().world;
    world.bodies().iter().filter_map(|&body| Some(world.pose(body)?.translation.vector)).collect()
}

fn asleep(simulation: &Simulation) -> usize {
    let world = &simulation.scene().world;
    world.bodies().iter().filter(|&&body| world.is_asleep(body) == Some(true)).count()
}

/// Cost of a step, µs, in rounds of `steps`.
fn cost(simulation: &mut Simulation, rounds: usize, steps: usize) -> Spread {
    let round = |_| timed(|| update(simulation, steps)) / steps as f64;
    Spread::of((0..rounds).map(round)).expect("there are rounds")
}

// --- concave meshes

/// Heaps of the meshes of at most `triangles`.
fn concave(rounds: usize, triangles: usize) -> Section {
    let mut rows = Vec::new();
    for shape in shapes::all().into_iter().filter(|shape| shape.mesh.triangles.len() <= triangles) {
        let mesh = written(&format!("large_{}.obj", shape.name.replace(", ", "_")), &shapes::obj(&shape.mesh));
        for (name, kind, hulls) in KINDS {
            let wanted = ConvexDecomposition { hulls, ..ConvexDecomposition::default() };
            let begin = std::time::Instant::now();
            let hulls = if hulls == 0 { Vec::new() } else { convex_hulls(&shape.mesh, &wanted) };
            let made = begin.elapsed();
            let (mean, most) = if hulls.is_empty() { (0.0, 0.0) } else { error(&shape, &hulls) };
            let mut heap = heap_of(&mesh, kind);
            update(&mut heap, 3000);
            let (own, ball) = resting(&shape, &mesh, kind);
            rows.push(vec![
                shape.name.into(),
                shape.mesh.triangles.len().to_string(),
                name.into(),
                if hulls.is_empty() { "–".into() } else { hulls.len().to_string() },
                heap.scene().world.contact_count().to_string(),
                lying(&heap).to_string(),
                cost(&mut heap, rounds, 100).to_string(),
                format!("{:.2}", mean * 1e3),
                format!("{:.2}", most * 1e3),
                format!("{:.2}", own * 1e3),
                ball.map_or("–".into(), |ball| format!("{:.2}", ball * 1e3)),
                if kind == "CONVEX_DECOMPOSITION" { format!("{:.0}", made.as_secs_f64() * 1e3) } else { "–".into() },
            ]);
        }
    }
    Section {
        title: "large/concave",
        intro: "45 equal bodies that fell into a heap, profile `legacy`: CPU time of a step of 1 ms after 3 s, µs, median (10th–90th \
                percentile). Contacts: \
                contact points then; lying: bodies above the floor and within 1 m of where they fell. Error: distance of 4000 points of the mesh's surface from the surface that collides, without Bullet's \
                margin, mm. Height: of the centre of a single body that lies on the floor, mm; of a ball of 20 mm radius that fell \
                into it. Time: what the division took, ms, without the files that keep it.",
        header: &["mesh", "triangles", "collides as", "hulls", "contacts", "lying", "step", "mean error", "largest error", "height", "ball", "time"],
        rows,
        ..Section::default()
    }
}

/// How many bodies are above the floor and near the heap; the first body is the floor.
fn lying(heap: &Simulation) -> usize {
    places(heap)
        .iter()
        .skip(1)
        .filter(|place| place.z > 0.0 && (place.xy() - nalgebra::Vector2::repeat(0.2)).norm() < 1.0)
        .count()
}

fn body(name: &str, mesh: &std::path::Path, kind: &str, place: [f64; 3], turn: [f64; 3]) -> String {
    let ([x, y, z], [r, p, w]) = (place, turn);
    format!(
        "{name}: {{name: {name}, mass: 0.1, location: {{position: {{x: {x:.4}, y: {y:.4}, z: {z:.4}}}, orientation: {{r: {r:.3}, p: {p:.3}, \
         y: {w:.3}}}}}, inertial offset: {{position: {{x: 0, y: 0, z: 0}}}}, mesh: '{}', collision mesh type: {kind}}}\n",
        mesh.display()
    )
}

fn heap_of(mesh: &std::path::Path, kind: &str) -> Simulation {
    let mut names = String::from("FLOOR");
    let mut text = String::from(FLOOR);
    for i in 0..BODIES {
        write!(names, ", B{i}").expect("a text takes everything");
        let place = [i % 3, i / 3 % 3, i / 9].map(|k| k as f64 * 0.13 + 0.1);
        let turn = [0.7, 0.4, 0.9].map(|k| (i as f64 * k).sin() * 1.5);
        text += &body(&format!("B{i}"), mesh, kind, place, turn);
    }
    scene("heap", &names, &text)
}

fn scene(name: &str, names: &str, text: &str) -> Simulation {
    let model = format!("bodies: [{names}]\njoints: []\nignore inter-collision: false\n{text}");
    let world = written("large_world.yaml", WORLD);
    simulation(world, written(&format!("large_{name}.yaml"), &model), PhysicsOptions::default())
}

/// Heights at which a body, and a ball in it, come to rest, m.
fn resting(shape: &Shape, mesh: &std::path::Path, kind: &str) -> (f64, Option<f64>) {
    let height = -shape.mesh.vertices.iter().map(|v| v[2]).fold(f64::INFINITY, f64::min);
    let own = body("B0", mesh, kind, [0.0, 0.0, height + 0.005], [0.0; 3]);
    let ball = shape.ball.map(|radius| {
        format!(
            "BALL: {{name: Ball, mass: 0.05, location: {{position: {{x: 0, y: 0, z: 0.15}}}}, collision shape: Sphere, \
             collision geometry: {{radius: {radius}}}}}\n"
        )
    });
    let names = if ball.is_some() { "FLOOR, B0, BALL" } else { "FLOOR, B0" };
    let mut simulation = scene("rest", names, &format!("{FLOOR}{own}{}", ball.as_deref().unwrap_or_default()));
    update(&mut simulation, 4000);
    let scene = simulation.scene();
    let of = |name: &str| {
        let id = scene.bodies.position(|body| *body.identity.name == *name)?;
        Some(places(&simulation)[id.index()].z)
    };
    (of("B0").expect("the body is there"), of("Ball"))
}

/// A plane of a hull: outward unit normal and offset.
type Face = (Vector3<f64>, f64);

/// All planes through three vertices with the rest on one side.
fn faces(hull: &[[f64; 3]]) -> Vec<Face> {
    let points: Vec<Vector3<f64>> = hull.iter().copied().map(Vector3::from).collect();
    let mut found: Vec<Face> = Vec::new();
    for (i, a) in points.iter().enumerate() {
        for (j, b) in points.iter().enumerate().skip(i + 1) {
            for c in &points[j + 1..] {
                let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-14) else { continue };
                for normal in [normal, -normal] {
                    let offset = normal.dot(a);
                    if points.iter().all(|p| normal.dot(p) <= offset + 1e-9) {
                        found.push((normal, offset));
                    }
                }
            }
        }
    }
    found
}

/// Mean and largest distance of points of the mesh's surface from the surface of the union of hulls, m. Outside of a
/// hull it is that from the farthest of its planes, which is less than the distance near an edge.
fn error(shape: &Shape, hulls: &[Vec<[f64; 3]>]) -> (f64, f64) {
    let hulls: Vec<Vec<Face>> = hulls.iter().map(|hull| faces(hull)).collect();
    let signed = |point: &Vector3<f64>, faces: &[Face]| {
        faces.iter().map(|(normal, offset)| normal.dot(point) - offset).fold(f64::NEG_INFINITY, f64::max)
    };
    let distances: Vec<f64> = shapes::samples(&shape.mesh, 4000)
        .into_iter()
        .map(|point| hulls.iter().map(|faces| signed(&point.into(), faces)).fold(f64::INFINITY, f64::min).abs())
        .collect();
    (distances.iter().sum::<f64>() / distances.len() as f64, distances.iter().copied().fold(0.0, f64::max))
}

// --- sleep

fn boxes() -> (PathBuf, PathBuf) {
    let root = report::docs().parent().expect("the workspace").join("resources");
    (root.join("world/world.yaml"), root.join("models/boxes200.yaml"))
}

fn sleep(rounds: usize) -> Section {
    let mut rows = Vec::new();
    for profile in [Profile::Legacy, Profile::Accurate] {
        let (world, model) = boxes();
        let [mut awake, mut sleepy] = [false, true].map(|sleep| {
            let physics = PhysicsOptions { profile: Some(profile), sleep: Some(sleep), ..PhysicsOptions::default() };
            simulation(world.clone(), model.clone(), physics)
        });
        // In steps of 0.1 s, at most 30 s.
        let mut seconds = 0.0;
        while asleep(&sleepy) < 200 && seconds < 30.0 {
            update(&mut sleepy, 100);
            seconds += 0.1;
        }
        update(&mut awake, (seconds * 1000.0) as usize);
        let before = [&awake, &sleepy].map(places);
        let sleepers = asleep(&sleepy);
        let costs = [&mut awake, &mut sleepy].map(|simulation| cost(simulation, rounds, 500));
        let drifts = [(&awake, &before[0]), (&sleepy, &before[1])].map(|(simulation, before)| {
            let now = places(simulation);
            let moved: Vec<f64> = now.iter().zip(before).map(|(now, before)| (now - before).norm() * 1e3).collect();
            let most = moved.iter().copied().fold(0.0, f64::max);
            format!("{} / {}", short(Spread::of(moved).expect("there are bodies").median), short(most))
        });
        rows.push(vec![
            format!("{profile:?}").to_lowercase(),
            format!("{sleepers} after {seconds:.1} s"),
            costs[0].to_string(),
            costs[1].to_string(),
            format!("{:.3}", costs[1].median / costs[0].median),
            drifts[0].clone(),
            drifts[1].clone(),
        ]);
    }
    Section {
        title: "large/sleep",
        intro: "The shipped 200 boxes: how many sleep, CPU time of `Simulation::update`, µs, without and with `--sleep` from then on, and how \
                far the boxes moved meanwhile (10 s; a quick run 2.5 s), median / largest, mm.",
        header: &["profile", "asleep", "awake", "with `--sleep`", "ratio", "moved awake", "moved with `--sleep`"],
        rows,
        ..Section::default()
    }
}

// --- contact sensors

fn sensors(rounds: usize) -> Section {
    let (world, model) = boxes();
    let bare = std::fs::read_to_string(&model).expect("the shipped scene can be read");
    let names: Vec<String> = (0..SENSORS).map(|i| format!("SENSOR {i}")).collect();
    let mut text = format!("{bare}\nsensors: [{}]\n", names.join(", "));
    for (i, name) in names.iter().enumerate() {
        writeln!(
            text,
            "{name}: {{name: S{i}, type: Contact, parent: BODY Box{}, process contact details: true}}",
            i * 4
        )
        .expect("a text takes everything");
    }
    let sensing = written("large_sensors.yaml", &text);
    let [mut plain, mut with] =
        [model, sensing].map(|model| simulation(world.clone(), model, PhysicsOptions::default()));
    for simulation in [&mut plain, &mut with] {
        update(simulation, 3000);
    }
    let scene = with.scene();
    let watched: Vec<_> =
        (0..SENSORS).map(|i| scene.world.bodies()[scene.world.bodies().len() - 200 + i * 4]).collect();
    let mut lists = ContactLists::default();
    lists.watch(watched.iter().copied());
    let mut contacts = Vec::new();
    let mut points = [0; 2];
    let mut ways = [Vec::new(), Vec::new()];
    for _ in 0..rounds * 10 {
        ways[0].push(timed(|| {
            points[0] = 0;
            for &body in &watched {
                scene.world.contacts(body, f64::INFINITY, &mut contacts);
                points[0] += contacts.len();
            }
        }));
        ways[1].push(timed(|| {
            points[1] = 0;
            lists.update(&scene.world);
            for &body in &watched {
                contacts.clear();
                contacts.extend(lists.of(body));
                points[1] += contacts.len();
            }
        }));
    }
    assert_eq!(points[0], points[1], "both ways find the same points");
    let [each, once] = ways.map(|costs| Spread::of(costs).expect("there are rounds"));
    let (mut without_sensors, mut with_sensors) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        without_sensors.push(timed(|| update(&mut plain, 200)) / 200.0);
        with_sensors.push(timed(|| update(&mut with, 200)) / 200.0);
    }
    let [without_sensors, with_sensors] =
        [without_sensors, with_sensors].map(|costs| Spread::of(costs).expect("there are rounds"));
    Section {
        title: "large/sensors",
        intro: "50 contact sensors on the shipped 200 boxes, profile `legacy`, CPU time, µs: finding the contacts of 50 bodies by a look at all \
                manifolds for each (as before) and by one pass for all, in the same state; and an iteration without and with the sensors.",
        header: &["contact points", "a look for each", "one pass", "ratio", "iteration without", "with 50 sensors"],
        rows: vec![vec![
            points[0].to_string(),
            each.to_string(),
            once.to_string(),
            format!("{:.3}", once.median / each.median),
            without_sensors.to_string(),
            with_sensors.to_string(),
        ]],
        ..Section::default()
    }
}

// --- models that come and go

/// Memory of this process, MB.
fn resident() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux tells");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("Linux tells");
    line.trim().trim_end_matches(" kB").parse::<f64>().expect("a number") / 1000.0
}

/// Adds a pendulum to two arms and removes it, again and again, with an update after each.
fn changes(marks: &[usize]) -> Section {
    /// Changes of which the median is told.
    const LAST: usize = 100;
    let models = report::docs().parent().expect("the workspace").join("resources/models");
    let (world, _) = boxes();
    let mut simulation = simulation(world, models.join("teleop.yaml"), PhysicsOptions::default());
    let hub = simulation.connect();
    hub.set_listening();
    let (mut costs, mut rows, mut first) = (Vec::new(), Vec::new(), None);
    for done in 1..=marks.last().copied().unwrap_or(0) {
        let read = PreparedModel::read(&models.join("pendulum.yaml")).expect("a shipped model");
        costs.push(timed(|| {
            let key = simulation.add_model(read).expect("something is built").key;
            update(&mut simulation, 1);
            simulation.remove_model(&key).expect("it is there");
            update(&mut simulation, 1);
        }));
        if marks.contains(&done) {
            let memory = resident();
            let grown = memory - *first.get_or_insert(memory);
            let cost = Spread::of(costs[costs.len().saturating_sub(LAST)..].to_vec()).expect("there are changes");
            let places = simulation.scene().bodies.len();
            rows.push(vec![done.to_string(), cost.to_string(), places.to_string(), format!("{grown:.2}")]);
        }
    }
    Section {
        title: "large/changes",
        intro: "A pendulum of two bodies is added to the scene `teleop` and removed, with an update after each and a hub that is listened to: \
                CPU time of the four together in the last 100 changes, µs, median (10th–90th percentile), without reading the file; places \
                of bodies in the scene; growth of the memory of the process since the first row, MB.",
        header: &["changes", "time", "places", "growth"],
        rows,
        ..Section::default()
    }
}

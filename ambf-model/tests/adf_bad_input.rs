//! Files that are broken, hostile or absent: each gives a message, none a panic, a hang or a flood.

use std::path::Path;
use std::time::{Duration, Instant};

use ambf_model::adf::{load, parse, ColorTable, InputDevices, Launch, LoadError, Model, Severity, World};

fn error(text: &str) -> LoadError {
    parse::<Model>(text, Path::new("m.yaml")).expect_err("refused")
}

#[test]
fn missing_file() {
    let error = load::<Model>(Path::new("no/such/file.yaml")).expect_err("missing");
    assert!(matches!(error, LoadError::Unreadable { .. }));
    let message = error.to_string();
    assert!(message.starts_with("no/such/file.yaml: cannot be read: "));
}

#[test]
fn a_directory_is_no_file() {
    let error = load::<World>(Path::new(env!("CARGO_MANIFEST_DIR"))).expect_err("a directory");
    assert!(matches!(error, LoadError::Unreadable { .. }));
}

#[test]
fn one_message_for_a_syntax_error() {
    let error = error("bodies: [BODY A\njoints: []\n");
    let LoadError::Syntax { at, .. } = &error else { panic!("{error}") };
    assert!(at.line == 2 && at.column > 0, "{error}");
    assert_eq!(error.to_string().lines().count(), 1);
}

#[test]
fn empty_files_and_other_roots() {
    for (text, expected) in [
        ("", "nothing"),
        ("# only a comment\n", "nothing"),
        ("~\n", "nothing"),
        ("- a\n", "a list"),
        ("text\n", "a single value"),
    ] {
        match error(text) {
            LoadError::NotAMapping { found, .. } => assert_eq!(found, expected),
            other => panic!("{text:?}: {other}"),
        }
    }
}

#[test]
fn binary_garbage() {
    let name = format!("adf_garbage_{}.yaml", std::process::id());
    let path = std::env::temp_dir().join(name);
    let garbage = (0..100_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8);
    std::fs::write(&path, garbage.collect::<Vec<u8>>()).expect("written");
    let result = load::<Model>(&path);
    std::fs::remove_file(&path).expect("removed");
    assert!(matches!(result, Err(LoadError::NotText { .. })));
}

#[test]
fn alias_bombs_are_harmless() {
    let start = Instant::now();
    let mut deep = String::from("a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n");
    for i in 1..40 {
        let item = format!("*a{}, ", i - 1);
        deep.push_str(&format!("a{i}: &a{i} [{}]\n", item.repeat(10)));
    }
    deep.push_str("bodies: *a39\n");
    assert!(matches!(error(&deep), LoadError::Refused { .. }));

    // A wide collection that is read again and again.
    let keys: String = (0..20_000).map(|i| format!("k{i}: 1, ")).collect();
    let wide = format!("B: {{{keys}}}\nbodies: [{}]\n", "B, ".repeat(20_000));
    let message = error(&wide).to_string();
    assert!(message.contains("aliases make the file too large"));

    // A long text that is copied again and again.
    let long = "x".repeat(1_000_000);
    let text = format!("bodies: [{}]\nB: {{name: {long}}}\n", "B, ".repeat(20_000));
    assert!(error(&text).to_string().len() < 10_000);

    let contains_itself = error("a: &a {b: *a}\n");
    assert!(matches!(contains_itself, LoadError::Syntax { .. }));
    assert!(start.elapsed() < Duration::from_secs(60));
}

#[test]
fn ten_thousand_levels() {
    let start = Instant::now();
    let mut block = String::new();
    for level in 0..10_000 {
        block.push_str(&" ".repeat(level));
        block.push_str("a:\n");
    }
    let flow = ["[", "{a: ", "- "].map(|open| open.repeat(10_000));
    for text in flow.iter().chain([&block]) {
        assert!(matches!(error(text), LoadError::Syntax { .. }));
    }
    assert!(start.elapsed() < Duration::from_secs(60));
}

#[test]
fn four_hundred_warnings_stay_readable() {
    let names: Vec<String> = (0..400).map(|i| format!("B{i}")).collect();
    let mut text = format!("bodies: [{}]\n", names.join(", "));
    for name in &names {
        text.push_str(name);
        text.push_str(": {mass: 1, mesh: m.stl, color: red, colour: red}\n");
    }
    let (model, report) = parse::<Model>(&text, Path::new("m.yaml")).expect("read");
    assert_eq!(model.bodies.len(), 400);
    assert_eq!((report.warnings(), report.errors()), (800, 0));
    let short = report.to_string();
    assert_eq!(short.lines().count(), 2, "{short}");
    let line = "m.yaml: warning: 400 × `colour` is not known: lines 2, 3, 4, … (397 more)";
    assert!(short.contains(line), "{short}");
    assert_eq!(report.verbose().to_string().lines().count(), 800);
}

#[test]
fn errors_name_file_line_key_and_what_to_write() {
    let text = "bodies: [A]\nA:\n  mass: 1\n  collision shape: Sphere\n  collision geometry:\n    radius: big\n";
    let LoadError::Refused { report, .. } = error(text) else { panic!() };
    let [problem] = report.problems() else { panic!("{report}") };
    assert_eq!(problem.severity, Severity::Fatal);
    assert_eq!(
        problem.to_string(),
        "m.yaml:6:13: error: `A / collision geometry / radius` is `big`, expected a number; the file is refused"
    );
}

/// Every element with most keys, as raw material for mutations.
const SEED: &str = "\
bodies: [A, B]
joints: [J]
sensors: [S]
lights: [L]
cameras: [C]
vehicles: [V]
soft bodies: [B]
namespace: /n/
high resolution path: ./h
anchor: &v {x: 1, y: 0.5, z: -1e-3}
gravity: *v
A:
  name: a b
  mass: 1.5
  inertia: {ix: 1, iy: 2, iz: 3}
  location: {position: *v, orientation: {r: 0, p: 1, y: 2}}
  collision shape: BOX
  collision geometry: {x: 1, y: 2, z: 3}
  friction: {static: 1, rolling: 2}
  collision groups: [0, 1]
  plugins: [{name: p, filename: f}]
  color rgba: {r: 1, g: 1, b: 1, a: 1}
  controller: {linear: {P: 1, D: 1}}
B:
  mesh: 'a.stl'
  mass: 0
  config: {kDP: 1, flags: 3, fixed nodes: [1]}
  shaders: {path: a, vertex: b, fragment: c}
J:
  type: six dof spring
  parent: A
  child: B
  parent pivot: *v
  child pivot: *v
  parent axis: *v
  child axis: *v
  joint limits: {linear: {low: *v, high: *v}, angular: {low: *v}}
  enable motor: 1
  publish frequency: {low: 1, high: 2}
S: {type: Resistance, parent: A, array: [{offset: *v, direction: *v}], friction: {variable: True}}
V:
  chassis: A
  wheels:
  - body: B
    suspension: &s
{
  stiffness: 1, damping: 1, compression: 1, rest length: 1
}
L: {location: *v, direction: *v, shadow quality: 0x3}
C: {look at: *v, stereo: {mode: P, eye separation: 1, focal length: 1}}
";

const BITS: [&str; 24] = [
    "&a ", "*a", "*v", "{", "}", "[", "]", ":", "- ", "? ", "|\n", "'", "\"", "#", "\n", "\t", "---\n", "!!int ",
    ".nan", "-.inf", "1e308", "~", "é", "<<: *v",
];

/// Next number below a bound; xorshift64 of Marsaglia (2003).
fn random(state: &mut u64, below: usize) -> usize {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state % below.max(1) as u64) as usize
}

fn mutated(state: &mut u64) -> String {
    let mut text: Vec<char> = SEED.chars().collect();
    for _ in 0..=random(state, 3) {
        let at = random(state, text.len());
        match random(state, 3) {
            0 => {
                let bit = BITS[random(state, BITS.len())];
                text.splice(at..at, bit.chars());
            }
            1 => {
                let end = (at + 1 + random(state, 12)).min(text.len());
                text.drain(at..end);
            }
            _ => {
                let end = (at + 1 + random(state, 80)).min(text.len());
                let copy = text[at..end].to_vec();
                let to = random(state, text.len());
                text.splice(to..to, copy);
            }
        }
    }
    text.into_iter().collect()
}

#[test]
fn mutated_scenes_give_messages() {
    let path = Path::new("m.yaml");
    let (model, report) = parse::<Model>(SEED, path).expect("the seed is sound");
    assert_eq!(report.errors(), 1, "{report}"); // an incomplete limit
    assert_eq!((model.bodies.len(), model.joints.len()), (2, 1));
    let mut state = 0x9E37_79B9_7F4A_7C15;
    let (mut read, mut refused) = (0, 0);
    for _ in 0..3_000 {
        let text = mutated(&mut state);
        match parse::<Model>(&text, path) {
            Ok((model, report)) => {
                read += 1;
                assert_eq!(report.is_empty(), report.to_string().is_empty());
                for body in &model.bodies {
                    let pose = body.location.to_homogeneous();
                    assert!(pose.iter().all(|x| x.is_finite()), "{text}");
                    assert!(body.mass.is_finite() && body.mass >= 0.0, "{text}");
                }
            }
            Err(error) => {
                refused += 1;
                assert!(error.to_string().starts_with("m.yaml"), "{error}");
            }
        }
        // The other kinds of file: whatever comes out, nothing panics.
        let _ = parse::<World>(&text, path);
        let _ = parse::<Launch>(&text, path);
        let _ = parse::<InputDevices>(&text, path);
        let _ = parse::<ColorTable>(&text, path);
    }
    assert!(read > 100 && refused > 100, "{read} read, {refused} refused");
}

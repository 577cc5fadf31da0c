//! The programs with the worked example of plugins and with libraries that are none.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(TempDir::new().expect("a temporary folder"))
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.path().join(name), text).unwrap();
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.0.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Bytes of a recording that goes on: it has its name when it is complete.
    fn recorded(&self) -> u64 {
        let entries = std::fs::read_dir(self.0.path()).unwrap().map_while(Result::ok);
        let mut unfinished = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(".unfinished"));
        unfinished.next().and_then(|entry| entry.metadata().ok()).map_or(0, |found| found.len())
    }
}

/// The folder of the library that `resources/plugins/recorder` makes: cargo puts it beside the tests that depend on it.
fn example() -> PathBuf {
    let program = std::env::current_exe().unwrap();
    let folder = program.parent().unwrap();
    assert!(folder.join("libambf_recorder.so").is_file());
    folder.to_owned()
}

const WORLD: &str = "gravity: {x: 0, y: 0, z: 0}\nmax iterations: 50\n\
    plugins: [{name: field, filename: libambf_recorder.so}]\nforce field: {centre: Magnet, radius: 1, force: 2}\n";

const MODEL: &str = "bodies: [BODY Magnet, BODY Ball]\n\
    BODY Magnet: {name: Magnet, mass: 0, collision shape: Sphere, collision geometry: {radius: 0.05}}\n\
    BODY Ball:\n  name: Ball\n  mass: 1\n  location: {position: {x: 0.5, y: 0, z: 0}}\n  damping: {linear: 0, angular: 0}\n  \
    collision shape: Sphere\n  collision geometry: {radius: 0.05}\n  \
    plugins: [{name: recorder, filename: libambf_recorder.so}]\n  record: {file: ball.csv, every: 10}\n";

const LAUNCH: &str = "world config: world.yaml\ninput devices config: devices.yaml\ncolor config: colors.yaml\n\
    multibody configs: [model.yaml]\n";

fn scene(folder: &Folder) {
    folder.write("world.yaml", WORLD);
    folder.write("model.yaml", MODEL);
    folder.write("devices.yaml", "input devices: []\n");
    folder.write("colors.yaml", "red: {r: 255, g: 0, b: 0, a: 255}\n");
}

fn batch(folder: &Folder, arguments: &[&str], plugin_path: &Path) -> (String, Option<i32>) {
    let output = Command::new(env!("CARGO_BIN_EXE_ambf_batch"))
        .args(arguments)
        .current_dir(folder.0.path())
        .env("AMBF_PLUGIN_PATH", plugin_path)
        .output()
        .unwrap();
    (String::from_utf8_lossy(&output.stderr).into_owned(), output.status.code())
}

#[test]
fn the_example_records_what_its_force_field_does() {
    let (folder, library) = (Folder::new(), example());
    scene(&folder);
    let arguments = ["-a", "model.yaml", "--world", "world.yaml", "--steps", "200", "--trace", "t", "--every", "10"];
    let (said, status) = batch(&folder, &arguments, &library);
    assert_eq!(status, Some(0), "{said}");
    assert!(
        said.contains("plugin recorder: 21 rows are in ./ball.csv") || said.contains("21 rows are in ball.csv"),
        "{said}"
    );
    let rows: Vec<Vec<f64>> = (folder.read("ball.csv").lines().skip(1))
        .map(|line| line.split(',').map(|field| field.parse().unwrap()).collect())
        .collect();
    assert_eq!(rows.len(), 21);
    assert_eq!((rows[0][0], rows[20][0]), (0.0, 200.0));
    // Bit for bit what the program's own trace says.
    let trace = folder.read("t_bodies.csv");
    let of_ball: Vec<&str> = trace.lines().filter(|line| line.contains("Ball")).collect();
    assert_eq!(of_ball.len(), 21, "{trace}");
    let x_of = |line: &str| -> Vec<f64> { line.split(',').filter_map(|field| field.parse().ok()).collect() };
    for (row, line) in rows.iter().zip(&of_ball) {
        assert!(x_of(line).contains(&row[2]), "{row:?}: {line}");
    }
    // At 0.5 m the field draws with 1 N: 1 m/s² for 0.2 s.
    let moved = 0.5 - rows[20][2];
    assert!((0.5 * 0.2 * 0.2 - moved).abs() < 0.002, "{moved}");
}

#[test]
fn libraries_that_are_none_are_left_out_one_by_one() {
    let (folder, library) = (Folder::new(), example());
    scene(&folder);
    folder.write("broken.so", "nothing");
    folder.write("libold.so", "\u{7f}ELF CreatePlugin\0");
    let recorder = library.join("libambf_recorder.so");
    let plugins = format!("broken.so, ./libold.so,absent.so ,builtin:x,{}", recorder.display());
    let arguments = ["-a", "model.yaml", "--world", "world.yaml", "--steps", "10", "--plugins", &plugins];
    let (said, status) = batch(&folder, &arguments, &library);
    assert_eq!(status, Some(0), "{said}");
    for part in [
        "plugin broken.so (broken.so) is left out: the dynamic loader cannot open it",
        "plugin ./libold.so (./libold.so) is left out: it is a compiled plugin of the C++ program",
        "plugin absent.so (absent.so) is left out: no such library: looked for",
        "no built-in plugin `x`",
        "libambf_recorder.so made no simulator plugin",
        "plugin recorder: 2 rows",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
}

#[test]
fn the_simulator_closes_plugins_when_it_is_interrupted() {
    let (folder, library) = (Folder::new(), example());
    scene(&folder);
    folder.write("launch.yaml", &format!("{LAUNCH}plugins: [{{name: gone, filename: libgone.so, path: sub}}]\n"));
    let mut simulator = Command::new(env!("CARGO_BIN_EXE_ambf_simulator"))
        .args(["--no_ros", "-g", "0", "-l", "0", "--verbose", "--launch_file", "launch.yaml"])
        .current_dir(folder.0.path())
        .env("AMBF_PLUGIN_PATH", &library)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(simulator.stderr.take().unwrap());
    let reader = std::thread::spawn(move || lines.lines().map_while(Result::ok).collect::<Vec<_>>());
    let begin = Instant::now();
    while folder.recorded() <= 10_000 {
        assert!(begin.elapsed() < Duration::from_secs(30), "nothing is recorded");
        std::thread::sleep(Duration::from_millis(10));
    }
    let interrupt = Command::new("kill").args(["-INT", &simulator.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    let status = simulator.wait().unwrap();
    let said = reader.join().unwrap().join("\n");
    assert!(status.success(), "{said}");
    for part in [
        "world plugin field (libambf_recorder.so) is running",
        "object plugin recorder (libambf_recorder.so) is running",
        "launch.yaml:5:",
        "plugin gone (libgone.so) is left out: no such library: looked for sub/libgone.so",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert_eq!(said.matches("rows are in").count(), 1, "closed once: {said}");
    let rows = folder.read("ball.csv");
    assert!(rows.ends_with('\n') && rows.lines().count() > 5, "{rows}");
    assert!(rows.lines().skip(1).all(|row| row.split(',').count() == 9), "no row is cut off");
}

#[test]
fn an_interrupted_batch_run_closes_plugins() {
    let (folder, library) = (Folder::new(), example());
    scene(&folder);
    let mut batch = Command::new(env!("CARGO_BIN_EXE_ambf_batch"))
        .args(["-a", "model.yaml", "--world", "world.yaml", "--steps", "1000000000"])
        .current_dir(folder.0.path())
        .env("AMBF_PLUGIN_PATH", &library)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    while folder.recorded() <= 10_000 {
        assert!(begin.elapsed() < Duration::from_secs(30), "nothing is recorded");
        std::thread::sleep(Duration::from_millis(10));
    }
    Command::new("kill").args(["-INT", &batch.id().to_string()]).status().unwrap();
    let mut said = String::new();
    std::io::Read::read_to_string(&mut batch.stderr.take().unwrap(), &mut said).unwrap();
    assert_eq!(batch.wait().unwrap().code(), Some(130), "{said}");
    assert_eq!(said.matches("rows are in").count(), 1, "{said}");
    assert!(folder.read("ball.csv").ends_with('\n'));
}

#[test]
fn the_linter_looks_for_libraries_without_loading_them() {
    let (folder, library) = (Folder::new(), example());
    scene(&folder);
    let check = |path: &Path| {
        let output = Command::new(env!("CARGO_BIN_EXE_ambf_batch"))
            .args(["--check", "world.yaml", "model.yaml"])
            .current_dir(folder.0.path())
            .env("AMBF_PLUGIN_PATH", path)
            .output()
            .unwrap();
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let said = check(&library);
    assert!(!said.contains("left out"), "{said}");
    let said = check(Path::new("/nowhere"));
    assert_eq!(
        said.matches("is left out: no such library: looked for /nowhere/libambf_recorder.so").count(),
        2,
        "{said}"
    );
    assert!(!folder.0.path().join("ball.csv").exists(), "nothing was run");
}

//! Writes `docs/legacy.md`; called by `scripts/legacy`.
//!
//! Each file is checked, and each model then loaded and stepped by a process of its own, so that memory is that of this
//! model.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use ambf_app::check::{self, Checked, Level};
use ambf_app::cli::CheckOptions;
use serde_json::Value;

const TEXT: &str = include_str!("legacy_report.md");
/// Steps that are timed.
const STEPS: u32 = 1000;
/// Numbers in the columns of the table.
const ELEMENTS: [(&str, &str); 10] = [
    ("bodies", "bodies"),
    ("joints", "joints"),
    ("soft", "soft bodies"),
    ("ghosts", "ghost objects"),
    ("sensors", "sensors"),
    ("actuators", "actuators"),
    ("vehicles", "vehicles"),
    ("cameras", "cameras"),
    ("lights", "lights"),
    ("volumes", "volumes"),
];

/// Scene files below a folder, sorted.
fn scene_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for path in std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "yaml" || extension == "urdf") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// What `--check` says of a file alone; the first row and the findings in that file are its own.
fn checked(file: &Path, launch_file: &Path) -> Checked {
    check::run(&CheckOptions {
        files: vec![file.to_owned()],
        together: None,
        launch_file: launch_file.to_owned(),
        world: None,
        json: false,
    })
}

/// What a process that loads and steps the model says about itself; `None` when it could not.
fn stepped(batch: &Path, model: &Path, world: &Path, steps: u32) -> Option<Value> {
    let output = Command::new(batch)
        .args(["--json", "--steps", &steps.to_string(), "-a"])
        .arg(model)
        .arg("--world")
        .arg(world)
        .output()
        .ok()?;
    serde_json::from_slice(&output.stdout).ok()
}

fn number(json: Option<&Value>, key: &str, digits: usize) -> String {
    let number = json.and_then(|json| json[key].as_f64());
    number.map_or("–".into(), |number| format!("{number:.digits$}"))
}

struct Programs<'a> {
    batch: &'a Path,
    world: &'a Path,
}

/// One line of the table, and what is wrong with the file in few words.
fn line(name: &str, file: &Path, launch_file: &Path, programs: &Programs<'_>) -> String {
    let checked = checked(file, launch_file);
    let row = &checked.rows[0];
    let own = |level| {
        let here = move |finding: &&check::Finding| finding.level == level && *finding.place.file == *file;
        checked.findings.iter().filter(here)
    };
    let refused =
        row.built.is_none() || own(Level::Error).any(|finding| finding.sentence.contains("the file is refused"));
    let loads = match (refused, own(Level::Error).count()) {
        (true, _) => "no".to_owned(),
        (false, 0) => "yes".to_owned(),
        (false, 1) => "yes, 1 error".to_owned(),
        (false, errors) => format!("yes, {errors} errors"),
    };
    let built = row.built.unwrap_or_default();
    let mut cells = vec![format!("`{name}`"), row.kind.to_owned(), loads];
    for (_, what) in ELEMENTS {
        let written = row.written.get(what);
        cells.push(if written > 0 { format!("{}/{written}", built.get(what)) } else { String::new() });
    }
    let meshes = row.meshes;
    cells.push(if meshes.named > 0 {
        format!("{}/{}", meshes.named - meshes.found, meshes.named)
    } else {
        String::new()
    });
    let is_model = row.kind == "model" && !refused;
    let load = is_model.then(|| stepped(programs.batch, file, programs.world, 0)).flatten();
    let run = is_model.then(|| stepped(programs.batch, file, programs.world, STEPS)).flatten();
    if is_model {
        cells.push(number(load.as_ref(), "load_s", 3));
        cells.push(number(load.as_ref(), "peak_rss_mb", 0));
        cells.push(number(run.as_ref(), "us_per_step", 1));
    } else {
        cells.extend([String::new(), String::new(), String::new()]);
    }
    format!("| {} |\n", cells.join(" | "))
}

fn table(folder: &Path, launch_file: &Path, programs: &Programs<'_>) -> (usize, String) {
    let headings: Vec<_> = ["file", "kind", "loads"].into_iter().chain(ELEMENTS.map(|(heading, _)| heading)).collect();
    let columns = headings.len() + 4;
    let mut table = format!("| {} | meshes missing | load, s | load, MB | step, µs |\n", headings.join(" | "));
    let _ = writeln!(table, "|{}", "---|".repeat(columns));
    let files = scene_files(folder);
    for file in &files {
        let name = file.strip_prefix(folder).unwrap_or(file).display().to_string();
        eprintln!("{name}");
        table += &line(&name, file, launch_file, programs);
    }
    (files.len(), table)
}

/// The processor and the number of its cores.
fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ")).map(|(_, name)| name);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{}, {cores} cores", model.unwrap_or("processor unknown"))
}

fn run() -> Result<(), String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().map_err(|error| error.to_string())?;
    // Programs lie in the folder above that of examples.
    let own = std::env::current_exe().map_err(|error| error.to_string())?;
    let batch = own.ancestors().nth(2).map(|folder| folder.join("ambf_batch")).filter(|file| file.is_file());
    let batch = batch.ok_or("ambf_batch is not built beside this program; call scripts/legacy")?;
    let legacy = std::env::args_os().nth(1).map(PathBuf::from).ok_or("usage: legacy_report DESCRIPTIONS")?;
    let world = root.join("resources/world/world.yaml");
    let programs = Programs { batch: &batch, world: &world };
    let (count, original) = table(&legacy, &legacy.join("launch.yaml"), &programs);
    let (own_count, own) = table(&root.join("resources"), &root.join("resources/launch.yaml"), &programs);
    let text = TEXT
        .replace("{count}", &count.to_string())
        .replace("{steps}", &STEPS.to_string())
        .replace("{machine}", &machine())
        .replace("{original}", &original)
        .replace("{own_count}", &own_count.to_string())
        .replace("{own}", &own);
    let file = root.join("docs/legacy.md");
    std::fs::write(&file, text).map_err(|error| format!("{}: {error}", file.display()))
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

//! Runs `ambf_batch` in a folder of its own and reads what it writes.
#![allow(dead_code, missing_docs)]

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

/// A folder that is removed in the end.
pub struct Folder(TempDir);

/// What a run of the program gave.
#[derive(Debug)]
pub struct Ran {
    pub status: i32,
    pub stdout: String,
    pub stderr: String,
}

/// A trace file: heading, and the cells of each line.
pub struct Csv {
    pub heading: Vec<String>,
    pub lines: Vec<Vec<String>>,
}

pub fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

impl Folder {
    pub fn new() -> Self {
        Self(TempDir::new().expect("a temporary folder"))
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn write(&self, name: &str, text: &str) {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(path, text).expect("written");
    }

    pub fn exists(&self, name: &str) -> bool {
        self.0.path().join(name).exists()
    }

    /// Runs `ambf_batch` here with words between blanks.
    ///
    /// A run that takes more than 120 s of processor time, whatever else the machine does, is killed, which fails the
    /// test.
    pub fn run(&self, arguments: &str) -> Ran {
        self.run_in_shell("exec \"$0\" \"$@\"", arguments)
    }

    /// The same by a command of the shell, in which `"$0" "$@"` is the program with its arguments.
    pub fn run_in_shell(&self, command: &str, arguments: &str) -> Ran {
        let output = Command::new("sh")
            .args(["-c", &format!("ulimit -t 120 && {command}"), env!("CARGO_BIN_EXE_ambf_batch")])
            .args(arguments.split_whitespace())
            .current_dir(self.0.path())
            .env("AMBF_RESOURCES", resources())
            .env_remove("AMBF_ROOT_PATH")
            .output()
            .expect("ambf_batch runs");
        Ran {
            status: output.status.code().expect("ends by itself, within its processor time"),
            stdout: String::from_utf8(output.stdout).expect("text"),
            stderr: String::from_utf8(output.stderr).expect("text"),
        }
    }

    /// Names of all that is here.
    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).expect("a folder");
        let name = |entry: std::io::Result<std::fs::DirEntry>| entry.expect("an entry").file_name();
        let mut names: Vec<_> = entries.map(|entry| name(entry).into_string().expect("text")).collect();
        names.sort();
        names
    }

    /// [`run`](Self::run); anything but success fails the test.
    pub fn succeed(&self, arguments: &str) -> Ran {
        let ran = self.run(arguments);
        assert_eq!(ran.status, 0, "{arguments}: {ran:?}");
        ran
    }

    /// Runs `model` without an environment and without gravity, under `commands`; the traces are `t_bodies.csv` and
    /// `t_joints.csv`.
    pub fn float(&self, model: &str, commands: &str, steps: u64) -> Csv {
        self.write("world.yaml", "gravity: {x: 0, y: 0, z: 0}\n");
        self.write("model.yaml", model);
        self.write("commands.txt", commands);
        self.succeed(&format!(
            "-a model.yaml --world world.yaml --commands commands.txt --steps {steps} --trace t --full"
        ));
        self.csv("t_bodies.csv")
    }

    pub fn csv(&self, name: &str) -> Csv {
        let text = std::fs::read_to_string(self.0.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let mut lines = text.lines();
        let heading = cells(lines.next().expect("a heading"));
        let lines: Vec<_> = lines.map(cells).collect();
        assert!(lines.iter().all(|line| line.len() == heading.len()), "{name}: lines of different length");
        Csv { heading, lines }
    }
}

impl Csv {
    pub fn text<'a>(&self, line: &'a [String], column: &str) -> &'a str {
        let place = self.heading.iter().position(|name| name == column);
        &line[place.unwrap_or_else(|| panic!("no column {column}"))]
    }

    /// The number in `column` of the object `name` at `step`.
    pub fn at(&self, step: u64, name: &str, column: &str) -> f64 {
        let is_wanted = |line: &&Vec<String>| line[0] == step.to_string() && line[2] == name;
        let line = self.lines.iter().find(is_wanted).unwrap_or_else(|| panic!("no `{name}` at step {step}"));
        self.text(line, column).parse().expect("a number")
    }

    pub fn vector(&self, step: u64, name: &str, columns: [&str; 3]) -> [f64; 3] {
        columns.map(|column| self.at(step, name, column))
    }

    /// Different values of a column in order of their first occurrence.
    pub fn distinct(&self, column: &str) -> Vec<String> {
        let mut found = Vec::new();
        for line in &self.lines {
            let text = self.text(line, column);
            if found.iter().all(|known| known != text) {
                found.push(text.to_owned());
            }
        }
        found
    }
}

/// Fails unless two numbers are closer than `tolerance`.
#[track_caller]
pub fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} instead of {expected} ± {tolerance}");
}

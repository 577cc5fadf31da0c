//! The model linter, `--check`: reads files and builds what they describe, without running it, and says everything
//! there is to say.
//!
//! A file is taken for what its keys say it is. What it names is checked too: a launch file's world, models, input
//! devices and colours, a world's environment, an input device's simulated end-effector. Each model is built on its
//! own, in the launch file's world if there is one; what it does not find then is looked for in the other models of the
//! launch file. The models of `-l` and `-a` are built together.

mod checker;
mod companions;
mod device;
mod files;
mod finding;
mod model;
mod original;
mod pass;
mod summary;
mod view;

use serde_json::{json, Value};

use crate::cli::CheckOptions;
use crate::print_line;
use crate::report::print_document;
use checker::Checker;

pub use finding::{Finding, Level};
pub use summary::{built, written, Counts, Presence, Row};

/// Checks what a command line names.
pub fn run(options: &CheckOptions) -> Checked {
    let mut checker = Checker::new(&options.launch_file);
    options.files.iter().for_each(|file| checker.named(file));
    if let Some((model_files, indexes)) = &options.together {
        checker.together(options, model_files, indexes);
    }
    checker.finish()
}

/// Checks what a command line names and prints it on standard output; the exit status.
pub fn print(options: &CheckOptions) -> i32 {
    let checked = run(options);
    match options.json {
        true => print_document(&format!("{:#}", checked.to_json())),
        false => print_line!("{}", checked.to_text().trim_end()),
    }
    checked.status()
}

/// What the linter found.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// Findings by file in the order of [`rows`](Self::rows), then by place.
    pub findings: Vec<Finding>,
    /// One a file, in the order in which they were named.
    pub rows: Vec<Row>,
}

impl Checked {
    fn count(&self, level: Level) -> usize {
        self.findings.iter().filter(|finding| finding.level == level).count()
    }

    /// Exit status of the program: 2 when anything was refused or dropped, else 0.
    pub fn status(&self) -> i32 {
        if self.count(Level::Error) > 0 {
            2
        } else {
            0
        }
    }

    /// One line a finding, a table of the files, the numbers of findings.
    pub fn to_text(&self) -> String {
        let mut text: String = self.findings.iter().map(|finding| format!("{finding}\n")).collect();
        if !text.is_empty() {
            text.push('\n');
        }
        text += &summary::table(&self.rows);
        let [errors, warnings, infos] = [Level::Error, Level::Warning, Level::Info].map(|level| self.count(level));
        text + &format!("errors: {errors}, warnings: {warnings}, infos: {infos}\n")
    }

    /// Everything as one JSON document.
    pub fn to_json(&self) -> Value {
        json!({
            "status": self.status(),
            "errors": self.count(Level::Error),
            "warnings": self.count(Level::Warning),
            "infos": self.count(Level::Info),
            "files": self.rows.iter().map(Row::to_json).collect::<Vec<_>>(),
            "problems": self.findings.iter().map(Finding::to_json).collect::<Vec<_>>(),
        })
    }
}

//! What was found, as text: on the terminal and in a page of `docs`.

use std::fmt::{self, Write as _};
use std::fs::{create_dir_all, read_to_string, write};
use std::path::{Path, PathBuf};

use crate::plot::{self, Figure};

/// A table with words before and after it.
#[derive(Debug, Default)]
pub struct Section {
    pub title: &'static str,
    pub intro: &'static str,
    pub header: &'static [&'static str],
    pub rows: Vec<Vec<String>>,
    /// Goals, and whether they were met; figures.
    pub remarks: Vec<String>,
}

impl fmt::Display for Section {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "### {}\n\n{}\n", self.title, self.intro)?;
        writeln!(f, "| {} |\n|{}", self.header.join(" | "), "---|".repeat(self.header.len()))?;
        for row in &self.rows {
            writeln!(f, "| {} |", row.join(" | "))?;
        }
        writeln!(f)?;
        for remark in &self.remarks {
            writeln!(f, "{remark}\n")?;
        }
        Ok(())
    }
}

/// A goal in words and whether it was met.
pub fn goal(words: &str, met: bool, found: &str) -> String {
    format!("Goal: {words}. Found: {found} – {}.", if met { "**met**" } else { "**missed**" })
}

/// What the numbers were taken on.
pub fn machine(quick: bool) -> String {
    let cpu = read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find_map(|line| line.strip_prefix("model name")?.split(':').nth(1));
    let kernel = read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let load = read_to_string("/proc/loadavg").unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let mut text = format!(
        "{}, {cores} cores, Linux {}; load average before: {}.",
        model.unwrap_or("unknown processor").trim(),
        kernel.trim(),
        load.split_whitespace().take(3).collect::<Vec<_>>().join(" ")
    );
    if quick {
        text += " Quick run: fewer scenes and repetitions.";
    }
    text + " Nothing is random: there is no seed."
}

const BEGIN: &str = "<!-- measured: begin -->";
const END: &str = "<!-- measured: end -->";

/// Where reports belong.
pub fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace").join("docs")
}

/// Replaces what is between the markers of a page in `docs` and has the figures drawn into a folder there.
pub fn publish(page: &str, folder: &str, machine: &str, sections: &[Section], figures: &[(impl AsRef<str>, Figure)]) {
    let path = docs().join(page);
    let text = read_to_string(&path).unwrap_or_else(|error| panic!("docs/{page} can be read: {error}"));
    let (before, rest) = text.split_once(BEGIN).unwrap_or_else(|| panic!("docs/{page} has its first marker"));
    let (_, after) = rest.split_once(END).unwrap_or_else(|| panic!("docs/{page} has its second marker"));
    let mut measured = format!("Machine: {machine}\n\n");
    for section in sections {
        write!(measured, "{section}").expect("a text takes everything");
    }
    write(&path, format!("{before}{BEGIN}\n{measured}{END}{after}")).expect("a page can be written");
    let folder = docs().join(folder);
    create_dir_all(&folder).expect("a folder of docs can be made");
    plot::draw(&folder, figures);
}

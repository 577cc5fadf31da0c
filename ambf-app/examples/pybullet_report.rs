//! Writes `docs/pybullet.md`; called by `scripts/pybullet_traces`.

#[path = "../tests/pybullet_common/mod.rs"]
mod pybullet_common;

use std::fmt::Write as _;
use std::path::Path;

use ambf_core::scene::SceneOptions;
use pybullet_common::{compare, runs, same_until, Differences, Method};

const TEXT: &str = include_str!("pybullet_report.md");

fn main() {
    let mut rigid = String::from(
        "| run | steps | position | rotation | velocity | angular velocity |\n|---|---|---|---|---|---|\n",
    );
    let mut articulated = String::from(
        "| run | simulated, s | position, m | rotation, rad | velocity, m/s | angular velocity, rad/s | joint |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for run in runs() {
        let mut rows = compare(&run, &SceneOptions::default());
        let steps = same_until(&run);
        rows.retain(|row| row.0 <= steps);
        let Differences { position, rotation, linear, angular, joint } = Differences::of(&rows);
        match run.method {
            Method::Rigid => {
                let cells = [position, rotation, linear, angular].map(cell).join(" | ");
                writeln!(rigid, "| {} | {steps} | {cells} |", run.name)
            }
            Method::Articulated => {
                let cells = [position, rotation, linear, angular, joint].map(cell).join(" | ");
                let name = match run.name.strip_suffix("_half") {
                    Some(scene) => format!("{scene}, half"),
                    None => format!("{}, whole", run.name),
                };
                writeln!(articulated, "| {name} | {} | {cells} |", run.dt * run.steps as f64)
            }
        }
        .expect("a string takes all");
    }
    let page = TEXT.replace("@RIGID@\n", &rigid).replace("@ARTICULATED@\n", &articulated);
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/pybullet.md");
    std::fs::write(&file, page).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
}

fn cell(difference: f64) -> String {
    if difference == 0.0 {
        "0".into()
    } else {
        format!("{difference:.1e}")
    }
}

//! The command line of `fake_dvrk`.

use std::path::PathBuf;
use std::sync::Arc;

use ambf_model::files::read_text;
use ambf_model::text::lines;
use clap::{CommandFactory, Parser, ValueEnum};
use dvrk_arm::{isometry, Dialect};
use nalgebra::{UnitQuaternion, Vector3};

use crate::{parse_dialect, Curve, FakeOptions, Hand, Machine, Motion, Script};

/// Largest script that is read, bytes.
const MAX_SCRIPT: u64 = 16 << 20;

/// Grippers of hands on the curve, where no script moves them: the first time that they are closed switches forces on.
const GRIPPERS: &str = "0 gripper 1\n1 gripper 0\n2 gripper 0\n3 gripper 1\n4 loop";

/// Arms of a da Vinci Research Kit that are not there: publishes what their node would, and records the forces that
/// they are told to show.
#[derive(Debug, Parser)]
#[command(name = "fake_dvrk", version = ambf_version::VERSION)]
#[command(
    after_help = "Example: two masters on the paper's curve, as dVRK 2.2 and later speaks:\n  fake_dvrk MTMR MTML --dialect crtk --rate 1000\n\n\
    A script has one line an event: a time in s, then for example `pose 0 0 0.05 0 0 0`, `gripper 0.2`, `press clutch`, `release clutch`, \
    `tap camera`, `fault`, `stop`, `start`, `dialect legacy`, `loop`. docs/dvrk.md explains all of them."
)]
pub struct Arguments {
    /// Names of the arms.
    #[arg(default_values = ["MTMR", "MTML"])]
    pub arms: Vec<String>,
    /// Which release of the robot's software it speaks like: legacy (dVRK up to 1.7), ambf (AMBF 2.0), crtk-2.0 (dVRK
    /// 2.0, 2.1), crtk (2.2 and later).
    #[arg(long, default_value = "crtk", value_parser = parse_dialect)]
    pub dialect: Dialect,
    /// Namespace of arms and pedals.
    #[arg(long)]
    pub namespace: Option<String>,
    /// Samples a second, 1 to 2000. A real robot publishes 100 unless it is told otherwise.
    #[arg(long, default_value_t = 100.0, value_parser = rate)]
    pub rate: f64,
    /// How the hands move where the script does not say.
    #[arg(long, value_enum, default_value_t = Moves::Curve)]
    pub motion: Moves,
    /// Size of the curve, m.
    #[arg(long, default_value_t = 0.1, value_parser = finite)]
    pub size: f64,
    /// Speed of the curve, rad/s.
    #[arg(long, default_value_t = 4.0, value_parser = finite)]
    pub speed: f64,
    /// Where the curve's middle or the resting hand is in the device frame: x,y,z in m and roll,pitch,yaw in rad.
    #[arg(long, default_value = "0,0,0,0,0,0", value_parser = six, allow_hyphen_values = true)]
    pub at: [f64; 6],
    /// Hands give way to forces: mass,stiffness,damping in kg, N/m, N·s/m, or "default" (0.3,200,5).
    #[arg(long, value_parser = hand)]
    pub hand: Option<Hand>,
    /// What arms, pedals and the node do, and when.
    #[arg(long, value_name = "FILE")]
    pub script: Option<PathBuf>,
    /// State at the start: DISABLED, ENABLED, PAUSED or FAULT.
    #[arg(long, default_value = "ENABLED")]
    pub state: String,
    /// The arms are not homed at the start.
    #[arg(long)]
    pub not_homed: bool,
    /// Samples have no time, as a robot marks those that are not valid.
    #[arg(long)]
    pub zero_stamps: bool,
    /// Seconds before the node appears.
    #[arg(long, default_value_t = 0.0, value_parser = finite)]
    pub start_after: f64,
    /// Seconds after which the program ends; without it, it runs until it is interrupted.
    #[arg(long, value_parser = finite)]
    pub duration: Option<f64>,
    /// Writes every wrench with the time of its arrival to a CSV file.
    #[arg(long, value_name = "FILE")]
    pub wrenches: Option<PathBuf>,
    /// Starts a ROS master if there is none. The simulator does so too: start one of the two with it.
    #[arg(long)]
    pub start_master: bool,
    /// No line a second about what comes and goes.
    #[arg(long, short)]
    pub quiet: bool,
}

/// How hands move where a script does not say.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Moves {
    /// The curve of the paper, its equation 9; without a script, grippers close and open every 4 s.
    Curve,
    /// At rest.
    Still,
}

fn finite(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x: &f64| x.is_finite() && *x >= 0.0)
        .ok_or_else(|| "expected a number, not negative".into())
}

fn rate(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x| (1.0..=2000.0).contains(x)).ok_or_else(|| "expected 1 to 2000".into())
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .filter(|numbers: &[f64; N]| numbers.iter().all(|x| x.is_finite()))
}

fn six(text: &str) -> Result<[f64; 6], String> {
    numbers(text).ok_or_else(|| "expected six numbers with commas between".into())
}

fn hand(text: &str) -> Result<Hand, String> {
    if text == "default" {
        return Ok(Hand::default());
    }
    let parts = numbers(text).filter(|parts: &[f64; 3]| parts[0] > 0.0 && parts[1] >= 0.0 && parts[2] >= 0.0);
    let [mass, stiffness, damping] = parts.ok_or("expected mass,stiffness,damping, or default")?;
    Ok(Hand { mass, stiffness, damping })
}

/// The command line as clap knows it, for completions and manual pages.
pub fn command() -> clap::Command {
    Arguments::command()
}

/// What a command line asks for; what the fake reports goes to standard error.
///
/// # Errors
/// A sentence about a script that cannot be read, or a state that is none.
pub fn options(arguments: &Arguments) -> Result<FakeOptions, String> {
    let script = match (&arguments.script, arguments.motion) {
        (None, Moves::Curve) => Script::parse("grippers", GRIPPERS).map_err(|error| error.to_string())?,
        (None, Moves::Still) => Script::default(),
        (Some(path), _) => {
            let name = path.display().to_string();
            let text = read_text(path, MAX_SCRIPT).map_err(|error| format!("{name}: {error}"))?;
            Script::parse(&name, &text).map_err(|error| error.to_string())?
        }
    };
    let [x, y, z, roll, pitch, yaw] = arguments.at;
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    let curve =
        Curve { offset: Vector3::new(x, y, z), size: arguments.size, speed: arguments.speed, ..Curve::default() };
    let machine = Machine::new(&arguments.state, !arguments.not_homed);
    let machine = machine
        .ok_or_else(|| format!("\"{}\" is no state, expected DISABLED, ENABLED, PAUSED or FAULT", arguments.state))?;
    Ok(FakeOptions {
        arms: arguments.arms.clone(),
        dialect: arguments.dialect,
        namespace: arguments.namespace.clone(),
        rate: arguments.rate,
        motion: match arguments.motion {
            Moves::Curve => Motion::Curve(curve, rotation),
            Moves::Still => Motion::Still(isometry(arguments.at)),
        },
        hand: arguments.hand,
        script,
        machine,
        zero_stamps: arguments.zero_stamps,
        present: arguments.start_after <= 0.0,
        embedded_master: arguments.start_master,
        report: Arc::new(|line| eprintln!("{}", lines(&line.to_string()))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn arguments_become_options() {
        let line =
            "fake_dvrk MTML2 --dialect legacy --rate 500 --motion still --at=0,0,-0.05,0,0,0 --hand 1,2,3 --not-homed";
        let options = options(&Arguments::parse_from(line.split(' '))).unwrap();
        assert_eq!(
            (&options.arms[..], options.dialect, options.rate),
            (&["MTML2".to_owned()][..], Dialect::Legacy, 500.0)
        );
        assert_eq!(options.motion.pose(0.0).translation.z, -0.05);
        assert_eq!(options.hand, Some(Hand { mass: 1.0, stiffness: 2.0, damping: 3.0 }));
        assert!(!options.machine.homed && options.present);
        for bad in ["--rate 0", "--dialect french", "--at 1,2", "--hand 0,1,1", "--duration -1"] {
            assert!(Arguments::try_parse_from(format!("fake_dvrk {bad}").split(' ')).is_err(), "{bad}");
        }
    }
}

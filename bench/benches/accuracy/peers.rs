//! Other simulators, through a Python program that takes a request a line and answers with a line.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde_json::{json, Value};

use super::case::{Case, Family, Run};
use super::reference::State;

/// Another simulator and how it is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Peer {
    /// pybullet with Featherstone's algorithm, which is its way to build bodies.
    Featherstone,
    /// pybullet with rigid bodies in maximal coordinates.
    Maximal,
    MujocoEuler,
    MujocoImplicit,
    MujocoRk4,
    /// MuJoCo 3, beside the newest version: 4.0.0 has a defect of its solver.
    Mujoco3Euler,
    Mujoco3Rk4,
}

impl Peer {
    /// Those that can build the cases of a family.
    pub fn of(family: Family) -> &'static [Self] {
        use Peer::*;
        match family {
            Family::Free => &[Featherstone, Maximal, MujocoEuler, MujocoRk4, Mujoco3Rk4],
            // Joints of pybullet are Featherstone's.
            Family::Tree | Family::Loop => &[Featherstone, MujocoEuler, MujocoImplicit, MujocoRk4, Mujoco3Rk4],
            Family::Contact => &[Featherstone, Maximal, MujocoEuler, Mujoco3Euler],
            // MuJoCo has no coefficient of restitution.
            Family::Bounce => &[Featherstone, Maximal],
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Featherstone => "pybullet",
            Self::Maximal => "pybullet maximal",
            Self::MujocoEuler => "MuJoCo Euler",
            Self::MujocoImplicit => "MuJoCo implicit",
            Self::MujocoRk4 => "MuJoCo RK4",
            Self::Mujoco3Euler => "MuJoCo 3 Euler",
            Self::Mujoco3Rk4 => "MuJoCo 3 RK4",
        }
    }
}

/// A running Python program.
struct Program {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    /// Versions, as it says them.
    versions: String,
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The running Python programs.
pub struct Peers {
    newest: Program,
    /// With MuJoCo 3.
    older: Result<Program, String>,
}

impl Peers {
    /// Starts them with the Python interpreter that `AMBF_PEERS_PYTHON` names, and with the packages in
    /// `AMBF_PEERS_MUJOCO3` for MuJoCo 3; `Err` says why there are no peers.
    pub fn start() -> Result<Self, String> {
        let newest = Program::start(None)?;
        let packages = std::env::var_os("AMBF_PEERS_MUJOCO3").ok_or("AMBF_PEERS_MUJOCO3 is not set".to_owned());
        Ok(Self { newest, older: packages.and_then(|packages| Program::start(Some(packages))) })
    }

    /// All versions.
    pub fn versions(&self) -> String {
        let older = self.older.as_ref().map_or(String::new(), |older| format!("; {}", older.versions));
        format!("{}{older}", self.newest.versions)
    }

    /// Runs a case; `Ok(None)` when it takes longer than `most`.
    pub fn run(&mut self, case: &Case, peer: Peer, step: f64, most: Duration) -> Result<Option<Run>, String> {
        let program = match peer {
            Peer::Mujoco3Euler | Peer::Mujoco3Rk4 => self.older.as_mut().map_err(|problem| problem.clone())?,
            _ => &mut self.newest,
        };
        program.run(case, peer, step, most)
    }
}

impl Program {
    /// packages: a folder of packages that come before those of the interpreter.
    fn start(packages: Option<OsString>) -> Result<Self, String> {
        let python = std::env::var_os("AMBF_PEERS_PYTHON").ok_or("AMBF_PEERS_PYTHON is not set")?;
        let program = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/accuracy/peers.py");
        let mut command = Command::new(python);
        // MuJoCo writes its log where it runs.
        command.current_dir(ambf_bench::folder());
        command.envs(packages.map(|packages| ("PYTHONPATH", packages)));
        command.arg(program).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(|error| error.to_string())?;
        let input = child.stdin.take().expect("it is piped");
        let output = BufReader::new(child.stdout.take().expect("it is piped"));
        let mut program = Self { child, input, output, versions: String::new() };
        let hello = program.answer()?;
        program.versions = hello["versions"].as_str().ok_or("it did not say its versions")?.to_owned();
        Ok(program)
    }

    fn answer(&mut self) -> Result<Value, String> {
        let mut line = String::new();
        match self.output.read_line(&mut line) {
            Ok(0) => Err("the Python program ended".into()),
            Ok(_) => serde_json::from_str(&line).map_err(|error| format!("{error}: {line}")),
            Err(error) => Err(error.to_string()),
        }
    }

    fn run(&mut self, case: &Case, peer: Peer, step: f64, most: Duration) -> Result<Option<Run>, String> {
        let request = json!({
            "peer": peer.name(), "system": case.system.json(), "step": step, "times": case.times, "most": most.as_secs_f64(),
        });
        writeln!(self.input, "{request}").map_err(|error| error.to_string())?;
        let answer = self.answer()?;
        if let Some(problem) = answer["problem"].as_str() {
            return Err(problem.to_owned());
        }
        if answer["late"] == json!(true) {
            return Ok(None);
        }
        let seconds = |key: &str| answer[key].as_f64().ok_or("an answer without a time");
        let (cpu, tail) = (Duration::from_secs_f64(seconds("cpu")?), Duration::from_secs_f64(seconds("tail")?));
        let samples: Option<Vec<Vec<State>>> = answer["samples"]
            .as_array()
            .and_then(|samples| samples.iter().map(|bodies| bodies.as_array()?.iter().map(state).collect()).collect());
        Ok(Some(Run { cpu, tail, samples: samples.ok_or("an answer without samples")? }))
    }
}

/// Position, quaternion (x, y, z, w), velocity, angular velocity; numbers that are not finite come as null.
fn state(numbers: &Value) -> Option<State> {
    let numbers: Vec<f64> = numbers.as_array()?.iter().map(|number| number.as_f64().unwrap_or(f64::NAN)).collect();
    let &[x, y, z, i, j, k, w, ..] = numbers.as_slice() else { return None };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Some(State {
        pose: Isometry3::from_parts(Translation3::new(x, y, z), rotation),
        velocity: Vector3::from_column_slice(numbers.get(7..10)?),
        spin: Vector3::from_column_slice(numbers.get(10..13)?),
    })
}

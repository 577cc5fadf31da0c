//! The ways to simulate a case, run in turn.

use std::time::Duration;

use super::case::{Case, STEPS, USUAL};
use super::own::{self, Setting};
use super::peers::{Peer, Peers};
use super::statistics::Spread;

/// Runs of a step are repeated until they took this long together, or [`Effort::rounds`] times.
const ENOUGH: Duration = Duration::from_millis(300);

/// How much to measure.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    pub rounds: usize,
    /// Runs that would take longer are left out.
    pub most: Duration,
}

enum Way {
    Own(Setting),
    Peer(Peer),
}

/// What was found for one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// s.
    pub step: f64,
    /// µs of CPU time a simulated ms; at a step of 1 ms the cost of a step.
    pub cost: Spread,
    /// Infinite: failed.
    pub error: f64,
}

/// A way to simulate with all that was found, in order of falling steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    pub name: String,
    pub points: Vec<Point>,
    /// Why there is less than there could be.
    pub problem: Option<String>,
}

impl Lane {
    /// What was found for a step, s.
    pub fn at(&self, step: f64) -> Option<&Point> {
        self.points.iter().find(|point| point.step == step)
    }
}

struct Running<'a> {
    way: Way,
    lane: Lane,
    case: &'a Case,
    /// CPU time of the step before, s.
    last: f64,
    over: bool,
    costs: Vec<f64>,
    error: f64,
}

impl Running<'_> {
    /// One run; `false`: no further one is wanted at this step.
    fn run(&mut self, peers: &mut Option<Peers>, step: f64, effort: Effort) {
        let result = match &self.way {
            Way::Own(setting) => own::run(self.case, setting, step, effort.most * 2),
            Way::Peer(peer) => match peers {
                Some(peers) => peers.run(self.case, *peer, step, effort.most * 2),
                None => Err("not installed".into()),
            },
        };
        match result {
            Ok(Some(run)) => {
                let span = self.case.times[run.samples.len().clamp(1, self.case.times.len()) - 1];
                self.last = run.cpu.as_secs_f64();
                self.costs.push(self.last * 1e6 / (span * 1e3));
                self.error = self.case.error(&run);
            }
            Ok(None) => self.over = true,
            Err(problem) => {
                self.lane.problem = Some(problem.lines().next_back().unwrap_or("it failed").to_owned());
                self.over = true;
            }
        }
    }

    fn wants_more(&self, effort: Effort) -> bool {
        let spent = self.last * self.costs.len() as f64;
        !self.over && self.costs.len() < effort.rounds && spent < ENOUGH.as_secs_f64()
    }

    fn close(&mut self, step: f64) {
        if let Some(cost) = Spread::of(self.costs.drain(..)) {
            self.lane.points.push(Point { step, cost, error: self.error });
        }
    }
}

/// Runs a case in all ways, from large steps to small ones.
pub fn measure(case: &Case, peers: &mut Option<Peers>, effort: Effort) -> Vec<Lane> {
    let own = own::settings(case).into_iter().map(|setting| (setting.name.to_owned(), Way::Own(setting)));
    let others = Peer::of(case.family).iter().map(|&peer| (peer.name().to_owned(), Way::Peer(peer)));
    let mut running: Vec<Running> = own
        .chain(others)
        .map(|(name, way)| Running {
            way,
            lane: Lane { name, points: Vec::new(), problem: None },
            case,
            last: 0.0,
            over: false,
            costs: Vec::new(),
            error: f64::INFINITY,
        })
        .collect();
    for &step in STEPS.iter().rev() {
        // What others are compared with should not be missing.
        let effort = if step >= USUAL { Effort { most: effort.most * 4, ..effort } } else { effort };
        for round in 0..effort.rounds {
            for way in &mut running {
                // Half the step is twice the work.
                way.over |= round == 0 && 2.0 * way.last > effort.most.as_secs_f64();
                if !way.over && (round == 0 || way.wants_more(effort)) {
                    way.run(peers, step, effort);
                }
            }
        }
        running.iter_mut().for_each(|way| way.close(step));
    }
    running.into_iter().map(|way| way.lane).collect()
}

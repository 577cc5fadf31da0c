//! Replaying recordings.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::time::Duration;

use ambf_core::comm::Rates;
use ambf_core::comm::{CartesianCommandType, JointCommandType, RigidBodyCommand};
use ambf_core::ids::{BodyId, JointId};
use ambf_core::plugin::Command;
use ambf_core::scene::SceneReport;
use ambf_core::sim::{
    playback, EarlyEnd, Entry, LostState, Playback, ReplayError, Replayed, Replayer, Simulation, AHEAD_BYTES,
};
use thiserror::Error;

use crate::{reason, Header, Recording, RecordingError, Timed, STOPPED};

/// How often a thread that has read far enough ahead looks again.
const FULL: Duration = Duration::from_millis(5);

/// Most entries that are read ahead for what they command: some thousand bodies and joints.
const AHEAD: usize = 4096;

/// Why a replay does not go on.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReplayFailure {
    /// Error when the recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Error when what it says cannot be done, or leads somewhere else.
    #[error("{file}: {error}")]
    Replay {
        /// The recording.
        file: String,
        /// Why.
        error: ReplayError,
    },
}

/// A recording that a simulation follows, update by update.
pub struct Replay {
    recording: Recording,
    /// Entries that were read for what they command, and not yet followed.
    ahead: VecDeque<Timed>,
    /// Why no more could be read.
    damage: Option<RecordingError>,
    replayer: Replayer,
    /// Updates of the recording.
    updates: u64,
    /// Simulated times at its beginning and its end, s.
    start: f64,
    end: f64,
    notes: Vec<(f64, String)>,
    /// Mean interval of its updates, s.
    interval: f64,
    targets: Targets,
    ended: String,
    problem: Option<String>,
}

/// What was commanded last, for data sets of actions: with what was commanded in the present state, which acts from the next
/// update on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Targets {
    /// Positions of joints, rad or m; without those that are commanded otherwise or not at all.
    pub joints: HashMap<JointId, f64>,
    /// Poses of body frames in the world: position, m, and quaternion x, y, z, w.
    pub bodies: HashMap<BodyId, [f64; 7]>,
    /// Those of root links that input devices move: these go on after a reset, and beside what others command.
    hands: HashMap<BodyId, [f64; 7]>,
}

impl Targets {
    fn note(&mut self, entry: &Entry<'_>, simulation: &Simulation) {
        let is_there = |body: usize| body < simulation.scene().bodies.len();
        match entry {
            Entry::Body { body, command } if is_there(*body) => {
                self.command(BodyId::new(*body), command, simulation);
            }
            Entry::Joint { body, index, kind, value } if is_there(*body) => {
                let joints = simulation.scene().active_joints(BodyId::new(*body));
                joints.get(*index).into_iter().for_each(|&joint| self.joint(joint, *kind, *value));
            }
            Entry::Plugin { command: Command::Joint { joint, kind, value }, .. } => {
                self.joint(JointId::new(*joint), *kind, *value);
            }
            Entry::Plugin { command: Command::FollowPose { body, pose }, .. } => {
                let pose = seven(pose.translation.vector.into(), pose.rotation.coords.into());
                self.bodies.insert(BodyId::new(*body), pose);
            }
            Entry::Plugin { command: Command::Wrench { body, .. } | Command::Velocity { body, .. }, .. } => {
                self.release(BodyId::new(*body));
            }
            Entry::Hand { device, reference, .. } => {
                if let Some(root) = simulation.device_root(*device) {
                    let pose = seven(reference.translation.vector.into(), reference.rotation.coords.into());
                    self.hands.insert(root, pose);
                    self.bodies.insert(root, pose);
                }
            }
            Entry::ResetWorld {} | Entry::Restore { .. } => {
                self.joints.clear();
                self.bodies.clone_from(&self.hands);
            }
            Entry::RemoveModel { .. } | Entry::RemoveBody { .. } => {
                let is_gone = |body: BodyId| simulation.scene().body_is_gone(body);
                self.hands.retain(|&body, _| !is_gone(body));
                self.bodies.retain(|&body, _| !is_gone(body));
            }
            _ => (),
        }
    }

    fn command(&mut self, body: BodyId, command: &RigidBodyCommand, simulation: &Simulation) {
        if command.cartesian == CartesianCommandType::Position {
            self.bodies.insert(body, seven(command.position.into(), command.orientation));
        } else {
            self.release(body);
        }
        let kinds = command.joint_command_types.iter().copied().chain(std::iter::repeat(JointCommandType::Effort));
        let joints = simulation.scene().active_joints(body).iter();
        for ((&joint, &value), kind) in joints.zip(&command.joint_commands).zip(kinds) {
            self.joint(joint, kind, value);
        }
    }

    /// A body is not to follow a pose any more, but that of its input device.
    fn release(&mut self, body: BodyId) {
        match self.hands.get(&body) {
            Some(&pose) => self.bodies.insert(body, pose),
            None => self.bodies.remove(&body),
        };
    }

    fn joint(&mut self, joint: JointId, kind: JointCommandType, value: f64) {
        match kind {
            JointCommandType::Position => {
                self.joints.insert(joint, value);
            }
            JointCommandType::Effort | JointCommandType::Velocity => {
                self.joints.remove(&joint);
            }
            JointCommandType::Unknown(_) => (),
        }
    }
}

/// A pose as [`Targets::bodies`] has it.
fn seven([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> [f64; 7] {
    [x, y, z, i, j, k, w]
}

/// How far a replay came.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// The next update was made.
    Update,
    /// The next update was made, and the state was lost in it, as it was when it was recorded.
    Lost(LostState),
    /// The recording is over.
    End,
}

impl Replay {
    /// Opens a recording for replaying. Reads it once, to know where it goes back to earlier states and how long it is.
    ///
    /// # Errors
    /// [`RecordingError`], but damage behind the beginning: the recording is replayed up to there.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut scan = Recording::open(path)?;
        let (mut restored, mut updates, mut end, mut notes) = (Vec::new(), 0, 0.0, Vec::new());
        let (mut start, mut moved) = (0.0, 0.0);
        let damage = loop {
            let timed = match scan.next_entry() {
                Ok(Some(timed)) => timed,
                Ok(None) => break None,
                Err(error) => break Some(error),
            };
            end = timed.sim_time;
            match timed.entry {
                Entry::Start { sim_time, .. } => (start, end) = (sim_time, sim_time),
                Entry::Restore { position, .. } => restored.push(position),
                Entry::Update { interval, .. } => {
                    updates += 1;
                    end += interval;
                    moved += interval;
                }
                Entry::Note { text } => notes.push((timed.sim_time, text)),
                _ => (),
            }
        };
        let (ended, problem) = ending(&scan, damage);
        let interval = if updates > 0 { moved / updates as f64 } else { 0.0 };
        let recording = Recording::open(path)?;
        Ok(Self {
            recording,
            ahead: VecDeque::new(),
            damage: None,
            replayer: Replayer::new(restored),
            updates,
            start,
            end,
            notes,
            interval,
            targets: Targets::default(),
            ended,
            problem,
        })
    }

    /// How the recording ended: `stopped`, as it was to; `overflow`, `too large` or `went back`, before that; `cut off`: its
    /// program was killed, or it could not be written or copied to its end; `damaged`.
    pub fn ended(&self) -> &str {
        &self.ended
    }

    /// A sentence where the recording is not whole. It is replayed as far as it goes.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    /// What the recording says about its scene.
    pub fn header(&self) -> &Header {
        self.recording.header()
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Updates of the recording.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Simulated time at its beginning, s: above 0 where it begins with a reset, which that time goes on over.
    pub fn start_time(&self) -> f64 {
        self.start
    }

    /// Simulated time at its end, s.
    pub fn end_time(&self) -> f64 {
        self.end
    }

    /// Mean interval of its updates, s; 0 without any.
    pub fn mean_interval(&self) -> f64 {
        self.interval
    }

    /// What was commanded last.
    pub fn targets(&self) -> &Targets {
        &self.targets
    }

    /// Simulated times, s, and texts of what somebody noted.
    pub fn notes(&self) -> &[(f64, String)] {
        &self.notes
    }

    /// Lets objects of the scene be published at other rates than their files say; before [`load`](Self::load).
    pub fn set_rates(&mut self, rates: Option<Rates>) {
        self.recording.set_rates(rates);
    }

    /// Loads the scene, and brings it to where the recording begins; to be called once. `tolerant`: also when files of the
    /// scene have changed.
    ///
    /// # Errors
    /// Those of [`Header::load`]; [`ReplayFailure::Replay`] when the recording has no beginning.
    pub fn load(&mut self, tolerant: bool) -> Result<(Simulation, SceneReport), ReplayFailure> {
        let (mut simulation, report) = self.header().load(tolerant)?;
        if let Some(timed) = self.recording.next_entry()? {
            self.apply(&mut simulation, &timed.entry)?;
        }
        self.look_ahead(&simulation);
        Ok((simulation, report))
    }

    /// Lets the simulation that [`load`](Self::load) gave do what it did up to and with its next update.
    ///
    /// # Errors
    /// [`ReplayFailure`].
    pub fn step(&mut self, simulation: &mut Simulation) -> Result<Step, ReplayFailure> {
        while let Some(timed) = self.next_entry()? {
            let step = match self.apply(simulation, &timed.entry)? {
                Replayed::Update => Step::Update,
                Replayed::Lost(lost) => Step::Lost(lost),
                _ => continue,
            };
            self.look_ahead(simulation);
            return Ok(step);
        }
        Ok(Step::End)
    }

    fn next_entry(&mut self) -> Result<Option<Timed>, RecordingError> {
        if let Some(timed) = self.ahead.pop_front() {
            return Ok(Some(timed));
        }
        self.damage.take().map_or_else(|| self.recording.next_entry(), Err)
    }

    /// Notes what is commanded before anything moves, of at most [`AHEAD`] entries and about [`AHEAD_BYTES`]. It is followed
    /// when the simulation goes on.
    fn look_ahead(&mut self, simulation: &Simulation) {
        let mut written = Vec::new();
        self.ahead.iter().for_each(|timed| timed.entry.write(&mut written));
        let mut bytes = written.len();
        let has_room = |ahead: &VecDeque<Timed>, bytes| ahead.len() < AHEAD && bytes < AHEAD_BYTES;
        while has_room(&self.ahead, bytes) && self.ahead.back().is_none_or(|timed| !moves(&timed.entry)) {
            match self.recording.next_entry() {
                Ok(Some(timed)) => {
                    if !moves(&timed.entry) {
                        self.targets.note(&timed.entry, simulation);
                    }
                    written.clear();
                    timed.entry.write(&mut written);
                    bytes += written.len();
                    self.ahead.push_back(timed);
                }
                Ok(None) => return,
                Err(error) => {
                    self.damage = Some(error);
                    return;
                }
            }
        }
    }

    /// Hands what is left of the recording to a simulation that runs in real time: it is read ahead by a thread of its own.
    ///
    /// # Errors
    /// When no thread can be made.
    pub fn play(self) -> std::io::Result<Playback> {
        let Self { mut recording, mut ahead, mut damage, replayer, .. } = self;
        let (mut feed, playback) = playback(replayer);
        let mut next = move || match (ahead.pop_front(), damage.take()) {
            (Some(timed), kept) => {
                damage = kept;
                Ok(Some(timed))
            }
            (None, Some(error)) => Err(error),
            (None, None) => recording.next_entry(),
        };
        let read = move || loop {
            let mut entry = match next() {
                Ok(Some(timed)) => timed.entry,
                Ok(None) => return,
                Err(error) => return feed.fail(error.to_string()),
            };
            while let Some(waits) = feed.push(entry) {
                if feed.is_abandoned() {
                    return;
                }
                entry = waits;
                std::thread::sleep(FULL);
            }
        };
        std::thread::Builder::new().name("replay".into()).spawn(read)?;
        Ok(playback)
    }

    fn apply(&mut self, simulation: &mut Simulation, entry: &Entry<'_>) -> Result<Replayed, ReplayFailure> {
        let file = || self.recording.path().display().to_string();
        let replayed =
            self.replayer.apply(simulation, entry).map_err(|error| ReplayFailure::Replay { file: file(), error })?;
        // What it names is there, or the replay had failed.
        self.targets.note(entry, simulation);
        Ok(replayed)
    }
}

/// Whether a state is another one after an entry, or objects are others, so that what follows is not commanded in the state before.
fn moves(entry: &Entry<'_>) -> bool {
    matches!(
        entry,
        Entry::Update { .. }
            | Entry::Again {}
            | Entry::LoseTime { .. }
            | Entry::ResetBodies {}
            | Entry::ResetWorld {}
            | Entry::Restore { .. }
            | Entry::State { .. }
            | Entry::AddModel { .. }
            | Entry::RemoveModel { .. }
            | Entry::RemoveBody { .. }
    )
}

/// [`Replay::ended`] and [`Replay::problem`] of a recording that was read to its end, or up to `damage`.
fn ending(scan: &Recording, damage: Option<RecordingError>) -> (String, Option<String>) {
    let (ended, why) = match (damage, scan.end()) {
        (Some(error), _) => return ("damaged".into(), Some(error.to_string())),
        (None, Some(STOPPED)) => return (STOPPED.into(), None),
        (None, Some(early)) => {
            let known = [EarlyEnd::Slow, EarlyEnd::TooLarge, EarlyEnd::WentBack];
            let why = known.into_iter().find(|why| reason(*why) == early);
            (early, why.map_or_else(|| early.to_owned(), |why| why.to_string()))
        }
        (None, None) => {
            ("cut off", "its program was killed, or the file was not written or copied to its end".to_owned())
        }
    };
    (ended.to_owned(), Some(format!("{}: the recording is not whole: {why}", scan.path().display())))
}

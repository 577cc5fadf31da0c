//! Adding models to a running simulation and taking them out again.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crossbeam_channel::{bounded, Receiver, Sender};
use thiserror::Error;

use super::session::{recorded_path, Entry};
use super::Simulation;
use crate::adf::Severity;
use crate::scene::{Note, PreparedModel};

/// Why a model was not added or removed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ModelError {
    /// Error when the file is of no use; with all problems in it.
    #[error("{0}")]
    Load(String),
    /// Error when all that the file describes had to be dropped; with all problems, one line each.
    #[error("nothing of the model could be built:\n{0}")]
    Nothing(String),
    /// Error when no model, or more than one, has the name; also for the world's environment, which cannot be removed.
    #[error("there is no model `{name}` to remove: {why}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// What was found instead.
        why: String,
    },
    /// Error when the physics thread does not answer within [`ANSWER_TIMEOUT`], because it has ended or is held up.
    #[error("the simulation does not answer")]
    NoAnswer,
    /// Error when a recording is replayed.
    #[error("a recording is replayed: models come and go as in the recording until it is over or left")]
    Replaying,
}

/// What came of adding a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AddedModel {
    /// Key of the model: what it is removed by.
    pub key: String,
    /// Problems of its file and of what was built, one line each; empty if there were none.
    pub report: String,
    /// Whether elements had to be dropped.
    pub incomplete: bool,
}

/// How long the physics thread may take to answer.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(10);

type Answer<T> = Sender<Result<T, ModelError>>;

enum Request {
    Add(Box<PreparedModel>, Answer<AddedModel>),
    Remove(String, Answer<String>),
    List(Answer<Vec<(String, PathBuf)>>),
}

/// Adds models to a running simulation and removes them, from any thread. Files are read in the calling thread; the
/// physics thread only builds, which for a large model can take longer than an iteration.
#[derive(Clone)]
pub struct Models(Sender<Request>);

/// Requests that may wait.
const REQUESTS: usize = 16;

impl Models {
    /// Reads a model file and adds what it describes. Waits for the physics thread; a paused simulation answers too.
    ///
    /// # Errors
    /// [`ModelError::Load`], [`ModelError::Nothing`], [`ModelError::NoAnswer`].
    pub fn add(&self, file: &Path) -> Result<AddedModel, ModelError> {
        let prepared = Box::new(PreparedModel::read(file).map_err(ModelError::Load)?);
        self.ask(|answer| Request::Add(prepared, answer))
    }

    /// Removes the model whose key is `name`, or the only one whose key holds `name`. Returns its key.
    ///
    /// # Errors
    /// [`ModelError::Unknown`], [`ModelError::NoAnswer`].
    pub fn remove(&self, name: &str) -> Result<String, ModelError> {
        self.ask(|answer| Request::Remove(name.to_owned(), answer))
    }

    /// Keys and files of all models, the environment first.
    ///
    /// # Errors
    /// [`ModelError::NoAnswer`].
    pub fn list(&self) -> Result<Vec<(String, PathBuf)>, ModelError> {
        self.ask(Request::List)
    }

    fn ask<T>(&self, request: impl FnOnce(Answer<T>) -> Request) -> Result<T, ModelError> {
        let (answer, answered) = bounded(1);
        self.0.send_timeout(request(answer), ANSWER_TIMEOUT).map_err(|_| ModelError::NoAnswer)?;
        answered.recv_timeout(ANSWER_TIMEOUT).unwrap_or(Err(ModelError::NoAnswer))
    }
}

/// The physics thread's end.
pub(super) struct ModelRequests(Receiver<Request>);

impl Simulation {
    /// The handle through which other threads add and remove models. Replaces an earlier one.
    pub fn models(&mut self) -> Models {
        let (sender, requests) = bounded(REQUESTS);
        self.requests = Some(ModelRequests(requests));
        Models(sender)
    }

    /// Cuts off who has a handle: asking for changes fails at once.
    pub(super) fn refuse_models(&mut self) {
        self.requests = None;
    }

    /// Whether somebody waits for a change of the scene.
    pub(super) fn change_is_requested(&self) -> bool {
        self.requests.as_ref().is_some_and(|requests| !requests.0.is_empty())
            || self.window_is_waiting()
            || self.recordings.is_asked()
    }

    /// Does what windows and holders of [`Models`] have asked for, for callers that step a simulation themselves.
    pub fn serve_requests(&mut self) {
        self.do_requested_changes();
    }

    /// Physics thread: does what was asked for; true if the scene has changed. Costs next to nothing when nothing was.
    pub(super) fn do_requested_changes(&mut self) -> bool {
        let mut changed = self.serve_window();
        self.serve_recordings();
        while let Some(Ok(request)) = self.requests.as_ref().map(|requests| requests.0.try_recv()) {
            // An answer that nobody waits for any more is dropped.
            match request {
                Request::Add(_, answer) if self.refuses() => {
                    let _ = answer.send(Err(ModelError::Replaying));
                }
                Request::Remove(_, answer) if self.refuses() => {
                    let _ = answer.send(Err(ModelError::Replaying));
                }
                Request::Add(prepared, answer) => {
                    let _ = answer.send(self.add_model(*prepared));
                    changed = true;
                }
                Request::Remove(name, answer) => {
                    let outcome = self.remove_model(&name);
                    changed |= outcome.is_ok();
                    let _ = answer.send(outcome);
                }
                Request::List(answer) => {
                    let live = self.physics.scene.models.iter().filter(|model| !model.removed);
                    let list = live.map(|model| (model.key.clone(), model.description.file.to_path_buf()));
                    let _ = answer.send(Ok(list.collect()));
                }
            }
        }
        changed
    }

    /// Builds a model into the scene. Objects of other models keep their state.
    ///
    /// # Errors
    /// [`ModelError::Nothing`]; the scene is as before.
    pub fn add_model(&mut self, mut prepared: PreparedModel) -> Result<AddedModel, ModelError> {
        self.physics.note(&Entry::AddModel { file: recorded_path(prepared.file()) });
        let mut report = std::mem::take(&mut prepared.report);
        let (index, notes) = self.physics.scene.add_model(prepared);
        let incomplete = report.errors() > 0 || notes.iter().any(|note: &Note| note.severity > Severity::Warning);
        report.notes.extend(notes);
        if incomplete && !self.physics.scene.has_objects_of(index) {
            self.physics.scene.remove_model(index);
            self.grow();
            return Err(ModelError::Nothing(report.to_string().trim_end().to_owned()));
        }
        self.grow();
        if let Some(link) = &mut self.link {
            link.hub.add_objects(self.physics.scene.objects_of(|model| model == index));
            link.follow_scene(&self.physics.scene, &self.physics.wrenches);
        }
        let key = self.physics.scene.models[index].key.clone();
        let mut report = report.to_string().trim_end().to_owned();
        let tools = self.physics.scene.tool_count();
        for problem in self.start_model_plugins(index) {
            report += &format!("{}{problem}", if report.is_empty() { "" } else { "\n" });
        }
        if self.physics.scene.tool_count() != tools {
            self.show_changed_looks();
        }
        Ok(AddedModel { key, report, incomplete })
    }

    /// Removes the model whose key is `name`, or the only one whose key holds `name`. Returns its key.
    ///
    /// # Errors
    /// [`ModelError::Unknown`].
    pub fn remove_model(&mut self, name: &str) -> Result<String, ModelError> {
        let unknown = |why| ModelError::Unknown { name: name.to_owned(), why };
        let model = self.physics.scene.find_model(name).map_err(unknown)?;
        // What plugins have left for objects of the model may not reach the same model when it is added again.
        self.execute_posted();
        self.end_model_plugins(model);
        self.physics.note(&Entry::RemoveModel { key: self.physics.scene.models[model].key.clone() });
        self.release_picked_of(|scene, held| scene.model_of(held) == Some(model));
        self.physics.scene.remove_model(model);
        self.grow();
        if let Some(link) = &mut self.link {
            link.remove_objects(&self.physics.scene);
            link.follow_scene(&self.physics.scene, &self.physics.wrenches);
        }
        Ok(self.physics.scene.models[model].key.clone())
    }

    /// Lets those who draw see that objects look otherwise.
    pub(super) fn show_changed_looks(&self) {
        if let Some(link) = &self.link {
            link.hub.set_visuals(self.physics.scene.visuals(link.hub.generation()));
        }
    }

    /// Makes place for what the scene has now.
    pub(super) fn grow(&mut self) {
        self.physics.grow();
        self.find_device_parts();
    }
}

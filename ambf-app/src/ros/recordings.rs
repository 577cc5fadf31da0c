//! Services that begin and end recordings while the simulation runs.

use std::path::PathBuf;
use std::sync::Arc;

use ros_node::Announcement;

use super::messages::ambf_msgs::{
    StartRecording, StartRecordingReq, StartRecordingRes, StopRecording, StopRecordingRes,
};
use super::service::service_of;

/// The answer to a client about a recording.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordReply {
    /// Its file.
    pub file: PathBuf,
    /// What became of it.
    pub message: String,
}

/// Begins and ends recordings of the simulation on behalf of clients.
///
/// Each client is served in a thread of its own, so that the functions are called from several at once; they may block,
/// but not for ever: the client waits. A call may still be going on when the middleware has stopped.
pub trait RecordHost: Send + Sync {
    /// Begins a recording: with a reset of the world that is done for it, or where the simulation is. `file`: as the client
    /// wrote it; empty: one that the host names.
    ///
    /// # Errors
    /// One sentence for the client; nothing is recorded.
    fn start(&self, file: &str, reset: bool) -> Result<RecordReply, String>;

    /// Ends the recording.
    ///
    /// # Errors
    /// Nothing was recorded, or not all of it: a sentence for the client, and the file if there is one.
    fn stop(&self) -> Result<RecordReply, RecordReply>;
}

/// The services `start_recording` and `stop_recording`; `name` gives the full name of each.
pub(super) fn services(name: impl Fn(&str) -> String, host: &Arc<dyn RecordHost>) -> [Arc<dyn Announcement>; 2] {
    let (starter, stopper) = (Arc::clone(host), Arc::clone(host));
    [
        service_of::<StartRecording>(name("start_recording"), move |request| start(&*starter, &request)),
        service_of::<StopRecording>(name("stop_recording"), move |_| stop(&*stopper)),
    ]
}

pub(super) fn start(host: &dyn RecordHost, request: &StartRecordingReq) -> StartRecordingRes {
    let (success, RecordReply { file, message }) = outcome(
        host.start(&request.file, request.reset).map_err(|message| RecordReply { message, ..RecordReply::default() }),
    );
    StartRecordingRes { success, file: file.to_string_lossy().into_owned(), message }
}

pub(super) fn stop(host: &dyn RecordHost) -> StopRecordingRes {
    let (success, RecordReply { file, message }) = outcome(host.stop());
    StopRecordingRes { success, file: file.to_string_lossy().into_owned(), message }
}

fn outcome(done: Result<RecordReply, RecordReply>) -> (bool, RecordReply) {
    match done {
        Ok(reply) => (true, reply),
        Err(reply) => (false, reply),
    }
}

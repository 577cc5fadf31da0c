//! Recordings of the running simulation: begun and ended by the command line, by services and by a key.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use ambf_core::sim::{Beginning, Recordings, StartError};
use ambf_recording::{LaterHeader, Writer};
use parking_lot::Mutex;

use crate::ros::{RecordHost, RecordReply};
use crate::{report, warn};

/// Begins and ends recordings of a simulation that others run.
pub(crate) struct RecordingDesk {
    requests: Recordings,
    /// What headers say; a sentence where that is not known.
    header: Result<LaterHeader, String>,
    /// The recording that is written.
    writer: Mutex<Option<Writer>>,
}

impl RecordingDesk {
    /// For the simulation behind `requests`, which `writer` records already.
    pub fn new(requests: Recordings, header: std::io::Result<LaterHeader>, writer: Option<Writer>) -> Self {
        Self { requests, header: header.map_err(|error| error.to_string()), writer: Mutex::new(writer) }
    }

    /// Begins a recording; its file, and whether it has begun or waits for a reset.
    ///
    /// # Errors
    /// A sentence; nothing is recorded.
    fn begin(&self, file: Option<&Path>, beginning: Beginning) -> Result<(PathBuf, bool), String> {
        let mut current = self.writer.lock();
        if let Some(writer) = current.take() {
            if !writer.is_over() {
                let shown = writer.file().display().to_string();
                *current = Some(writer);
                return Err(format!("{shown} is recorded: end that first"));
            }
            // It has ended by itself, which was said.
            let _ = self.requests.stop();
            let _ = end(writer);
        }
        let header = self.header.as_ref().map_err(String::clone)?;
        let header = header.read().map_err(|error| format!("the files of the scene cannot be read for it: {error}"))?;
        let file = file.map_or_else(free_name, Path::to_owned);
        let (recorder, writer) = Writer::create(&file, &header, false).map_err(|error| error.to_string())?;
        match self.requests.start(recorder, beginning) {
            Ok(begun) => {
                *current = Some(writer);
                Ok((file, begun))
            }
            Err(error) => {
                // Nothing is in it.
                let _ = end(writer);
                Err(match error {
                    StartError::Moved => format!("{error}; reset the world with it"),
                    error => error.to_string(),
                })
            }
        }
    }

    /// Ends the recording.
    fn end(&self) -> Result<RecordReply, String> {
        let mut current = self.writer.lock();
        let writer = current.take().ok_or("nothing is recorded")?;
        // A simulation that does not answer records no more for whoever reads the file.
        let _ = self.requests.stop();
        end(writer)
    }

    /// Begins a recording, with the next reset of the world where it cannot begin at once, or ends it; a sentence.
    ///
    /// # Errors
    /// A sentence.
    #[cfg_attr(not(feature = "view"), allow(dead_code))]
    pub fn switch(&self) -> Result<String, String> {
        if self.writer.lock().as_ref().is_some_and(|writer| !writer.is_over()) {
            return self.end().map(|reply| reply.message);
        }
        self.begin(None, Beginning::NextReset).map(|(file, begun)| match begun {
            true => format!("recording into {}", file.display()),
            false => format!("{} is recorded from the next reset of the world on", file.display()),
        })
    }

    /// Says what has become of a recording that ended by itself. Never waits.
    pub fn look_after(&self) {
        let Some(mut current) = self.writer.try_lock() else { return };
        let Some(writer) = current.as_mut() else { return };
        if let Some(problem) = writer.problem() {
            warn!("{problem}");
        } else if writer.is_over() && writer.is_whole() {
            // It was to begin with a reset, and could not.
            current.take().map(end);
        }
    }

    /// Completes the file, after the simulation has ended.
    pub fn finish(&self) {
        let Some(mut writer) = self.writer.lock().take() else { return };
        let told = writer.problem();
        told.iter().for_each(|problem| warn!("{problem}"));
        let was_told = told.is_some() || !writer.is_whole();
        match end(writer) {
            Ok(reply) => report!("{}", reply.message),
            Err(problem) if !was_told => warn!("{problem}"),
            Err(_) => (),
        }
    }
}

/// Completes a file; one in which nothing is, is removed.
fn end(writer: Writer) -> Result<RecordReply, String> {
    let recorded = writer.finish();
    let shown = recorded.file.display();
    if recorded.entries == 0 {
        let removed = std::fs::remove_file(&recorded.file);
        let removed = removed.map_or_else(|error| format!("{shown}: {error}"), |()| format!("{shown} is not written"));
        return Err(format!("nothing was recorded: {removed}"));
    }
    match recorded.problem {
        Some(problem) => Err(problem),
        None => {
            let message = format!("recorded {} updates in {shown}", recorded.updates);
            Ok(RecordReply { file: recorded.file, message })
        }
    }
}

/// A name in the working directory that no file has.
fn free_name() -> PathBuf {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let names = std::iter::once(format!("ambf_{seconds}.mcap"));
    let mut names = names.chain((1..).map(|n: u32| format!("ambf_{seconds}_{n}.mcap"))).map(PathBuf::from);
    names.find(|name| !name.exists()).unwrap_or_default()
}

impl RecordHost for RecordingDesk {
    fn start(&self, file: &str, reset: bool) -> Result<RecordReply, String> {
        let beginning = if reset { Beginning::Reset } else { Beginning::Here };
        let named = (!file.is_empty()).then(|| Path::new(file));
        let (file, _) = self.begin(named, beginning)?;
        let message = format!("recording into {}", file.display());
        report!("{message}");
        Ok(RecordReply { file, message })
    }

    fn stop(&self) -> Result<RecordReply, String> {
        let reply = self.end()?;
        report!("{}", reply.message);
        Ok(reply)
    }
}

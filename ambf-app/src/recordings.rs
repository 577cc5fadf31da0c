//! Recordings of the running simulation: begun and ended by the command line, by services and by a key.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use ambf_core::sim::{Beginning, Recordings, StartError};
use ambf_recording::{LaterHeader, Replay, Writer};
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
                // Nothing is in it, nor comes into it later from a simulation that did not answer.
                let _ = self.requests.stop();
                let _ = end(writer);
                Err(match error {
                    StartError::Moved => format!("{error}; reset the world with it"),
                    error => error.to_string(),
                })
            }
        }
    }

    /// Ends the recording.
    fn end(&self) -> Result<RecordReply, RecordReply> {
        let mut current = self.writer.lock();
        let nothing = || RecordReply { message: "nothing is recorded".into(), ..RecordReply::default() };
        let writer = current.take().ok_or_else(nothing)?;
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
            return self.end().map(|reply| reply.message).map_err(|reply| reply.message);
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
            Err(reply) if !was_told => warn!("{}", reply.message),
            Err(_) => (),
        }
    }
}

/// Completes a file; one in which nothing is, is removed. The error says why it is not whole, and names it if it is there.
fn end(writer: Writer) -> Result<RecordReply, RecordReply> {
    let recorded = writer.finish();
    let shown = recorded.file.display();
    if recorded.entries == 0 {
        let removed = std::fs::remove_file(&recorded.file);
        let removed = removed.map_or_else(|error| format!("{shown}: {error}"), |()| format!("{shown} is not written"));
        let why = recorded.problem.unwrap_or_else(|| "nothing was recorded".into());
        return Err(RecordReply { message: format!("{why}: {removed}"), ..RecordReply::default() });
    }
    match recorded.problem {
        Some(message) => Err(RecordReply { file: recorded.file, message }),
        None => {
            let message = format!("recorded {} updates in {shown}", recorded.updates);
            Ok(RecordReply { file: recorded.file, message })
        }
    }
}

/// Clients may name recordings only: what other files are called is not theirs to make.
fn check_name(named: Option<&Path>) -> Result<(), String> {
    match named {
        Some(named) if named.extension().is_none_or(|extension| extension != "mcap") => {
            Err(format!("{}: a recording is a file .mcap: add that to the name", named.display()))
        }
        _ => Ok(()),
    }
}

/// Whether a recording reaches back to the simulated time that an option names; a sentence where it does not.
pub(crate) fn check_reached(option: &str, time: Option<f64>, replay: &Replay) -> Result<(), String> {
    let (start, end, file) = (replay.start_time(), replay.end_time(), replay.recording().path().display());
    match time {
        Some(time) if time < start => Err(format!(
            "{option} {time}: {file} goes from {start:.3} to {end:.3} s of simulated time: give a time in it"
        )),
        _ => Ok(()),
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
        check_name(named)?;
        let (file, _) = self.begin(named, beginning)?;
        let message = format!("recording into {}", file.display());
        report!("{message}");
        Ok(RecordReply { file, message })
    }

    fn stop(&self) -> Result<RecordReply, RecordReply> {
        let reply = self.end()?;
        report!("{}", reply.message);
        Ok(reply)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clients_name_recordings_only() {
        let check = |name: &str| check_name(Some(Path::new(name)));
        assert_eq!(check("a/b.mcap").and(check_name(None)), Ok(()));
        for name in [".bashrc", "a/b.mcap.sh", "mcap", "a.MCAP"] {
            assert!(check(name).is_err_and(|why| why.contains(name)), "{name}");
        }
    }
}

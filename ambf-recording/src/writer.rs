//! The thread that writes a recording.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ambf_core::files;
use ambf_core::sim::{recorder, EarlyEnd, Entry, Recorder, Simulation, StartError, Tap};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions};
use parking_lot::Mutex;
use thiserror::Error;

use crate::{reason, Header, END, HEADER, NOTES, STOPPED, TOPIC};

/// How often entries are taken.
const POLL: Duration = Duration::from_millis(20);
/// Entries that wait this long become a message.
const MESSAGE: Duration = Duration::from_millis(100);
/// Bytes from which on entries become a message at once.
const MESSAGE_BYTES: usize = 64 << 10;
/// How often a chunk is closed: what is lost when the program is killed.
const FLUSH: Duration = Duration::from_millis(900);
/// Largest description that is kept as an attachment, bytes.
const MAX_DESCRIPTION: u64 = 4 << 20;

/// Why there is no recording.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecordError {
    /// Error when the file is there already: recordings are not overwritten.
    #[error("{0} is there already; recordings are not overwritten: choose another name or remove it")]
    Exists(PathBuf),
    /// Error when the file cannot be made or written.
    #[error("{file}: {why}")]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        why: String,
    },
    /// Error when a file of the scene cannot be read.
    #[error("the files of the scene cannot be read for the recording: {0}")]
    Scene(std::io::Error),
    /// Error when the simulation is not where a recording can begin.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// What a recording holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// The file.
    pub file: PathBuf,
    /// Entries written.
    pub entries: u64,
    /// Updates written.
    pub updates: u64,
    /// Why it ended before it was to; `None`: it is whole.
    pub problem: Option<String>,
}

#[derive(Debug, Default)]
struct Status {
    stop: AtomicBool,
    entries: AtomicU64,
    updates: AtomicU64,
    problem: Mutex<Option<String>>,
}

/// Writes a recording in a thread of its own, for as long as it is told or the simulation lives.
#[derive(Debug)]
pub struct Writer {
    file: PathBuf,
    status: Arc<Status>,
    thread: Option<JoinHandle<()>>,
    told: bool,
}

impl Writer {
    /// Begins a recording of `simulation`, which must be at its start or directly after a reset, by `program`. `waits`: the
    /// simulation waits for a disk that is slow, as one without a clock can; else that ends the recording. Makes the
    /// file's folder.
    ///
    /// # Errors
    /// [`RecordError`]; there is no file then.
    pub fn start(path: &Path, simulation: &mut Simulation, program: &str, waits: bool) -> Result<Self, RecordError> {
        let header = Header::of(simulation, program).map_err(RecordError::Scene)?;
        files::folder_for(path)
            .map_err(|error| RecordError::Write { file: path.to_owned(), why: error.to_string() })?;
        let (recorder, writer) = Self::create(path, &header, waits)?;
        if let Err(error) = simulation.start_recording(recorder) {
            drop(writer);
            let _ = std::fs::remove_file(path);
            return Err(error.into());
        }
        Ok(writer)
    }

    /// Makes the file, in a folder that is there, and a recorder for the simulation whose header this is; `waits`: see [`start`](Self::start).
    ///
    /// # Errors
    /// [`RecordError`]; there is no file then.
    pub fn create(path: &Path, header: &Header, waits: bool) -> Result<(Recorder, Self), RecordError> {
        let failed = |why: String| RecordError::Write { file: path.to_owned(), why };
        let file = OpenOptions::new().write(true).create_new(true).open(path).map_err(|error| match error.kind() {
            std::io::ErrorKind::AlreadyExists => RecordError::Exists(path.to_owned()),
            _ => failed(error.to_string()),
        })?;
        let mut output = Output::new(file, header).map_err(|error| {
            let _ = std::fs::remove_file(path);
            failed(error.to_string())
        })?;
        let (recorder, tap) = recorder(waits);
        let status = Arc::new(Status::default());
        let of_thread = Arc::clone(&status);
        let shown = path.to_owned();
        let work = move || {
            let problem = output.follow(tap, &of_thread).err();
            if let Some(problem) = problem {
                *of_thread.problem.lock() =
                    Some(format!("{}: {problem}; the recording has ended, the simulation goes on", shown.display()));
            }
            output.close();
        };
        let thread = std::thread::Builder::new().name("recording".into()).spawn(work);
        let thread = thread.map_err(|error| failed(format!("no thread can be started: {error}")))?;
        Ok((recorder, Self { file: path.to_owned(), status, thread: Some(thread), told: false }))
    }

    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Why the recording has ended before it was to, once.
    pub fn problem(&mut self) -> Option<String> {
        let problem = self.status.problem.lock().clone().filter(|_| !self.told);
        self.told |= problem.is_some();
        problem
    }

    /// Whether nothing more comes: the simulation records no more, or the recording has ended by itself.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Whether it has not ended before it was to.
    pub fn is_whole(&self) -> bool {
        self.status.problem.lock().is_none()
    }

    /// Completes the file. The simulation must have stopped recording before, or what it does meanwhile is lost.
    pub fn finish(mut self) -> Summary {
        self.end();
        Summary {
            file: self.file.clone(),
            entries: self.status.entries.load(Ordering::Acquire),
            updates: self.status.updates.load(Ordering::Acquire),
            problem: self.status.problem.lock().clone(),
        }
    }

    fn end(&mut self) {
        self.status.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A panic was printed by its thread; the file is readable up to its last chunk.
            let _ = thread.join();
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.end();
    }
}

/// What went wrong: the words of the system where it was one of its calls, which the library leaves to the cause.
fn cause(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(error) => error.to_string(),
        error => error.to_string(),
    }
}

/// Why a recording ends early.
#[derive(Debug, Error)]
enum Failure {
    #[error("{0}")]
    Early(EarlyEnd),
    #[error("{}", cause(.0))]
    Write(#[from] mcap::McapError),
}

/// The file, and what waits to be a message in it.
struct Output {
    /// `None` after something could not be written.
    file: Option<mcap::Writer<BufWriter<File>>>,
    channel: u16,
    notes: u16,
    sequence: u32,
    batch: Vec<u8>,
    /// Simulated time at the beginning of the batch, and now, s.
    times: [f64; 2],
    entries: u64,
    updates: u64,
}

impl Output {
    fn new(file: File, header: &Header) -> mcap::McapResult<Self> {
        let options = WriteOptions::new()
            .profile("")
            .library(format!("ambf {}", ambf_version::VERSION))
            .compression(Some(Compression::Zstd))
            // Level 1: entries are numbers that no level compresses much.
            .compression_level(1);
        let mut file = options.create(BufWriter::new(file))?;
        file.write_metadata(&Metadata { name: HEADER.into(), metadata: header.to_fields() })?;
        for used in header.used.iter().filter(|used| is_description(&used.path)) {
            let Ok(text) = files::read(&used.path, MAX_DESCRIPTION) else { continue };
            file.attach(&Attachment {
                log_time: 0,
                create_time: now_ns(),
                name: used.path.display().to_string(),
                media_type: "text/plain".into(),
                data: text.into(),
            })?;
        }
        let channel = file.add_channel(0, TOPIC, "ambf", &BTreeMap::new())?;
        let schema = file.add_schema("ambf/Note", "jsonschema", NOTE_SCHEMA.as_bytes())?;
        let notes = file.add_channel(schema, NOTES, "json", &BTreeMap::new())?;
        file.flush()?;
        Ok(Self {
            file: Some(file),
            channel,
            notes,
            sequence: 0,
            batch: Vec::new(),
            times: [0.0; 2],
            entries: 0,
            updates: 0,
        })
    }

    /// Writes what comes until nothing more comes.
    fn follow(&mut self, mut tap: Tap, status: &Status) -> Result<(), Failure> {
        let (mut written, mut flushed) = (Instant::now(), Instant::now());
        loop {
            // Looked at first, so that nothing comes after what is taken now.
            let is_last = tap.is_last() || status.stop.load(Ordering::Acquire);
            let early_end = tap.early_end();
            let mut failed = None;
            tap.drain(|entry| {
                if failed.is_none() {
                    failed = self.add(entry).err();
                }
            });
            status.entries.store(self.entries, Ordering::Release);
            status.updates.store(self.updates, Ordering::Release);
            failed.map_or(Ok(()), Err)?;
            if is_last || early_end.is_some() || written.elapsed() >= MESSAGE {
                written = Instant::now();
                self.write_batch()?;
            }
            if let Some(why) = early_end {
                self.finish(reason(why))?;
                return Err(Failure::Early(why));
            }
            if is_last {
                return Ok(self.finish(STOPPED)?);
            }
            if flushed.elapsed() >= FLUSH {
                flushed = Instant::now();
                self.file().flush()?;
            }
            std::thread::park_timeout(POLL);
        }
    }

    fn file(&mut self) -> &mut mcap::Writer<BufWriter<File>> {
        self.file.as_mut().expect("it is taken in the end only")
    }

    fn add(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        // What the recorder has written can be read.
        match Entry::read(bytes) {
            Ok(Entry::Update { interval, .. }) => {
                self.updates += 1;
                self.times[1] += interval;
            }
            Ok(Entry::LoseTime { seconds }) => self.times[1] += seconds,
            Ok(Entry::Start { sim_time, .. } | Entry::Restore { sim_time, .. } | Entry::Hash { sim_time, .. }) => {
                self.times[1] = sim_time;
            }
            Ok(Entry::Note { text }) => self.write_note(&text)?,
            _ => (),
        }
        if self.batch.is_empty() {
            self.times[0] = self.times[1];
        }
        self.batch.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        self.batch.extend_from_slice(bytes);
        self.entries += 1;
        match self.batch.len() >= MESSAGE_BYTES {
            true => self.write_batch(),
            false => Ok(()),
        }
    }

    fn write_batch(&mut self) -> Result<(), Failure> {
        if self.batch.is_empty() {
            return Ok(());
        }
        let (channel, time) = (self.channel, self.times[0]);
        let batch = std::mem::take(&mut self.batch);
        self.write(channel, time, &batch)?;
        self.batch = batch;
        self.batch.clear();
        Ok(())
    }

    fn write_note(&mut self, text: &str) -> Result<(), Failure> {
        let (channel, time) = (self.notes, self.times[1]);
        self.write(channel, time, serde_json::json!({ "text": text }).to_string().as_bytes())
    }

    fn write(&mut self, channel_id: u16, sim_time: f64, data: &[u8]) -> Result<(), Failure> {
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: (sim_time * 1e9) as u64,
            publish_time: now_ns(),
        };
        self.sequence = self.sequence.wrapping_add(1);
        Ok(self.file().write_to_known_channel(&header, data)?)
    }

    fn finish(&mut self, reason: &str) -> mcap::McapResult<()> {
        let entries = self.entries.to_string();
        let fields = [("reason", reason.to_owned()), ("entries", entries)];
        let metadata = fields.map(|(key, value)| (key.to_owned(), value)).into();
        self.file().write_metadata(&Metadata { name: END.into(), metadata })?;
        self.file().finish()?;
        Ok(())
    }

    /// Closes the file as it is: what could not be written is not tried again.
    fn close(&mut self) {
        if let Some(file) = self.file.take() {
            let _ = file.into_inner().into_parts();
        }
    }
}

fn is_description(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| ["yaml", "yml", "urdf", "xacro"].contains(&extension.as_str()))
}

fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

const NOTE_SCHEMA: &str = r#"{"type": "object", "properties": {"text": {"type": "string"}}, "required": ["text"]}"#;

//! Reading recordings.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use ambf_core::files;
use ambf_core::sim::{CodeError, Entry, Unpacker};
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use thiserror::Error;

use crate::{Header, END, HEADER, TOPIC};

/// Largest record and chunk that is taken into memory, bytes: far above what is written.
const MAX_RECORD: usize = 64 << 20;

/// Why a recording cannot be read, or not further.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// Error when the file cannot be read.
    #[error("{file}: {source}")]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Error when the file is something else.
    #[error("{file} is no recording of AMBF: {why}")]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Why.
        why: String,
    },
    /// Error when the file is damaged.
    #[error("{file} is damaged after {entries} entries (simulated time {sim_time:.3} s): {why}")]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Entries before the damage.
        entries: u64,
        /// Simulated time of the last of them, s.
        sim_time: f64,
        /// What is wrong.
        why: String,
    },
    /// Error when the recording was made by a later version.
    #[error("the recording has the format {0:?}, made by a later version; this one reads format {known}", known = crate::FORMAT)]
    Format(String),
    /// Error when what it says about its scene is of no use.
    #[error("what the recording says about its scene is damaged: {0}")]
    Header(String),
    /// Error when files of the scene are not what they were; a line each.
    #[error("the scene of the recording cannot be loaded as it was:\n{0}")]
    Files(String),
    /// Error when a file of the scene is of no use.
    #[error("the scene of the recording cannot be loaded:\n{0}")]
    Scene(String),
}

/// An entry, and the simulated time before it, s.
#[derive(Debug, Clone, PartialEq)]
pub struct Timed {
    /// Simulated time before the entry, s.
    pub sim_time: f64,
    /// The entry.
    pub entry: Entry<'static>,
}

/// A recording, whose entries are read one after the other.
pub struct Recording {
    path: PathBuf,
    header: Header,
    source: Source,
    unpacker: Unpacker,
    /// The message that is read, and where its next entry begins. Its entries are unpacked one by one: those that repeat
    /// others are far larger in memory than in the file.
    message: Vec<u8>,
    place: usize,
    sim_time: f64,
    count: u64,
    ended: Option<String>,
}

/// Records of an MCAP file.
struct Source {
    reader: LinearReader,
    file: BufReader<File>,
    channel: Option<u16>,
    /// The file has no more bytes.
    at_end: bool,
    done: bool,
}

enum Found {
    Header(Header),
    Entries(Vec<u8>),
    End(String),
    /// The file ends, or ends too early.
    Nothing,
}

enum Problem {
    Read(std::io::Error),
    Mcap(String),
    Header(RecordingError),
}

impl Source {
    fn open(path: &Path) -> std::io::Result<Self> {
        let (file, _) = files::open(path)?;
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(MAX_RECORD);
        Ok(Self {
            reader: LinearReader::new_with_options(options),
            file: BufReader::new(file),
            channel: None,
            at_end: false,
            done: false,
        })
    }

    fn next(&mut self) -> Result<Found, Problem> {
        while !self.done {
            let Some(event) = self.reader.next_event() else {
                self.done = true;
                break;
            };
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    if self.at_end {
                        // What is there is not enough for another record: the writer was killed.
                        self.done = true;
                        break;
                    }
                    let read = self.file.read(self.reader.insert(wanted)).map_err(Problem::Read)?;
                    self.reader.notify_read(read);
                    self.at_end = read == 0;
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    // Others are not needed, and not parsed.
                    const NEEDED: [u8; 3] =
                        [mcap::records::op::CHANNEL, mcap::records::op::MESSAGE, mcap::records::op::METADATA];
                    if !NEEDED.contains(&opcode) {
                        continue;
                    }
                    match mcap::parse_record(opcode, data).map_err(|error| Problem::Mcap(error.to_string()))? {
                        Record::Channel(channel) if channel.topic == TOPIC => self.channel = Some(channel.id),
                        Record::Message { header, data } if Some(header.channel_id) == self.channel => {
                            return Ok(Found::Entries(data.into_owned()));
                        }
                        Record::Metadata(metadata) if metadata.name == HEADER => {
                            return Header::from_fields(&metadata.metadata).map(Found::Header).map_err(Problem::Header);
                        }
                        Record::Metadata(metadata) if metadata.name == END => {
                            let reason = metadata.metadata.get("reason");
                            return Ok(Found::End(reason.cloned().unwrap_or_default()));
                        }
                        _ => (),
                    }
                }
                // It was cut off there: at the end of the file, or in a chunk whose size was not written yet.
                Err(_) if self.at_end => self.done = true,
                Err(mcap::McapError::UnexpectedEoc) => self.done = true,
                Err(error) => {
                    self.done = true;
                    return Err(Problem::Mcap(error.to_string()));
                }
            }
        }
        Ok(Found::Nothing)
    }
}

impl Recording {
    /// Opens a recording and reads its header.
    ///
    /// # Errors
    /// [`RecordingError::Read`], [`RecordingError::Foreign`], [`RecordingError::Format`], [`RecordingError::Header`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = || path.to_owned();
        let mut source = Source::open(path).map_err(|source| RecordingError::Read { file: file(), source })?;
        let foreign = |why: &str| RecordingError::Foreign { file: file(), why: why.to_owned() };
        let header = match source.next() {
            Ok(Found::Header(header)) => header,
            Ok(Found::Entries(_) | Found::End(_)) => return Err(foreign("it does not begin with a header")),
            Ok(Found::Nothing) => return Err(foreign("it ends before its header")),
            Err(Problem::Read(source)) => return Err(RecordingError::Read { file: file(), source }),
            Err(Problem::Mcap(why)) => return Err(foreign(&why)),
            Err(Problem::Header(error)) => return Err(error),
        };
        Ok(Self {
            path: file(),
            header,
            source,
            unpacker: Unpacker::default(),
            message: Vec::new(),
            place: 0,
            sim_time: 0.0,
            count: 0,
            ended: None,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What it says about its scene.
    pub fn header(&self) -> &Header {
        &self.header
    }

    pub(crate) fn set_rates(&mut self, rates: Option<ambf_core::comm::Rates>) {
        self.header.options.rates = rates;
    }

    /// How the recording ended, once all entries were read: `stopped`; `overflow`, `too large`, `went back`, where it ended
    /// before it was to; `None`: its writer was killed or the file was cut off.
    pub fn end(&self) -> Option<&str> {
        self.ended.as_deref()
    }

    /// The next entry; `None` after the last. What a killed writer had not completed is left out.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`], [`RecordingError::Read`].
    pub fn next_entry(&mut self) -> Result<Option<Timed>, RecordingError> {
        loop {
            if let Some(entry) = self.unpack().map_err(|error| self.damaged(&error.to_string()))? {
                let sim_time = self.sim_time;
                match &entry {
                    Entry::Update { interval, .. } => self.sim_time += interval,
                    Entry::LoseTime { seconds } => self.sim_time += seconds,
                    Entry::Start { sim_time, .. } | Entry::Restore { sim_time, .. } | Entry::Hash { sim_time, .. } => {
                        self.sim_time = *sim_time;
                    }
                    _ => (),
                }
                self.count += 1;
                return Ok(Some(Timed { sim_time, entry }));
            }
            match self.source.next() {
                Ok(Found::Entries(bytes)) => (self.message, self.place) = (bytes, 0),
                Ok(Found::End(reason)) => self.ended = Some(reason),
                Ok(Found::Header(_)) => return Err(self.damaged("it begins twice")),
                Ok(Found::Nothing) => return Ok(None),
                Err(Problem::Read(source)) => return Err(RecordingError::Read { file: self.path.clone(), source }),
                Err(Problem::Mcap(why)) => return Err(self.damaged(&why)),
                Err(Problem::Header(error)) => return Err(error),
            }
        }
    }

    fn damaged(&self, why: &str) -> RecordingError {
        RecordingError::Damaged {
            file: self.path.clone(),
            entries: self.count,
            sim_time: self.sim_time,
            why: why.to_owned(),
        }
    }

    /// The next entry of the message; `None` after the last. Nothing of a message is read behind an error.
    fn unpack(&mut self) -> Result<Option<Entry<'static>>, CodeError> {
        let rest = &self.message[self.place..];
        if rest.is_empty() {
            return Ok(None);
        }
        self.place = self.message.len();
        let (length, behind) = rest.split_first_chunk::<4>().ok_or(CodeError::Short)?;
        let entry = behind.get(..u32::from_le_bytes(*length) as usize).ok_or(CodeError::Short)?;
        let unpacked = self.unpacker.unpack(entry)?;
        self.place -= behind.len() - entry.len();
        Ok(Some(unpacked))
    }
}

impl Iterator for Recording {
    type Item = Result<Timed, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_entry().transpose()
    }
}

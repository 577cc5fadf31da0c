//! Videos, by the program `ffmpeg`.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use ambf_core::files::{Unfinished, WriteError};
use thiserror::Error;

/// Most that is kept of what `ffmpeg` prints, bytes.
const MAX_OUTPUT: u64 = 4096;

/// Why there is no video.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VideoError {
    /// Error when there may be no such file.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Error when `ffmpeg` cannot be started.
    #[error("no video: ffmpeg cannot be started ({0}); install it (apt install ffmpeg)")]
    NoFfmpeg(io::Error),
    /// Error when `ffmpeg` gives up, or complains.
    #[error("the video {} cannot be written: {why}", file.display())]
    Failed {
        /// The video.
        file: PathBuf,
        /// What it printed.
        why: String,
    },
}

/// When the frames of a video are shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FrameTimes {
    /// So many a second.
    Rate(f64),
    /// When they were added, in a video of so many a second.
    Clock(f64),
}

/// A video that grows. The file is there when it is complete, and not before: one that is dropped before that is removed.
#[derive(Debug)]
pub struct Video {
    // Dropped first: it still writes the file.
    encoder: Encoder,
    place: Unfinished,
}

impl Video {
    /// Starts a video of `size` (width, height) pixels; the extension of its name says how it is encoded.
    ///
    /// # Errors
    /// [`VideoError::Write`], [`VideoError::NoFfmpeg`].
    pub fn start(file: &Path, size: (u32, u32), times: FrameTimes) -> Result<Self, VideoError> {
        let place = Unfinished::new(file)?;
        let encoder = Encoder::start(place.path(), size, times).map_err(VideoError::NoFfmpeg)?;
        Ok(Self { encoder, place })
    }

    /// Adds a frame: (height x width x 3), top row first.
    ///
    /// # Errors
    /// [`VideoError::Failed`]; there will be no video then.
    pub fn add(&mut self, rgb: &[u8]) -> Result<(), VideoError> {
        if self.encoder.add(rgb) {
            return Ok(());
        }
        let why = self.encoder.end().err();
        Err(failure(&self.place, why.unwrap_or_else(|| "ffmpeg ended before the last frame".to_owned())))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`VideoError::Failed`], [`VideoError::Write`]; there is no such file then, or that of before.
    pub fn finish(self) -> Result<(), VideoError> {
        let Self { mut encoder, place } = self;
        encoder.end().map_err(|why| failure(&place, why))?;
        let failed = |source| WriteError::new(place.file(), source);
        let found = std::fs::metadata(place.path()).map_err(failed)?;
        if found.is_file() {
            if found.len() == 0 {
                return Err(failure(&place, "it is empty".to_owned()));
            }
            // Some file systems say only now that there was no room.
            File::open(place.path()).and_then(|file| file.sync_all()).map_err(failed)?;
        }
        Ok(place.complete()?)
    }
}

fn failure(place: &Unfinished, why: String) -> VideoError {
    // `ffmpeg` knows the file by another name.
    let why = why.replace(&*place.path().to_string_lossy(), &place.file().to_string_lossy());
    VideoError::Failed { file: place.file().to_owned(), why }
}

/// A process `ffmpeg`, which ends when this is dropped.
#[derive(Debug)]
struct Encoder {
    child: Child,
    frames: Option<ChildStdin>,
    /// What it prints.
    said: Option<JoinHandle<String>>,
}

impl Encoder {
    fn start(file: &Path, (width, height): (u32, u32), times: FrameTimes) -> io::Result<Self> {
        // A name that begins with a dash or names a protocol is a file all the same.
        let target = match file.is_absolute() {
            true => file.to_owned(),
            false => Path::new(".").join(file),
        };
        let mut command = Command::new("ffmpeg");
        command
            .args(["-hide_banner", "-nostdin", "-loglevel", "error", "-y", "-f", "rawvideo", "-pixel_format", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}")]);
        match times {
            FrameTimes::Rate(rate) => command.args(["-framerate", &format!("{rate:.6}"), "-i", "pipe:0"]),
            FrameTimes::Clock(rate) => command.args(["-use_wallclock_as_timestamps", "1", "-i", "pipe:0"]).args([
                "-fps_mode",
                "cfr",
                "-r",
                &rate.to_string(),
            ]),
        };
        let mut child = command
            // Players want 4:2:0, for which both sizes have to be even. Nothing about the time or the encoder is
            // written.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"])
            .arg(&target)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Ctrl+C is for the program that films: its last frames still come.
            .process_group(0)
            .spawn()?;
        let frames = child.stdin.take();
        let said = child.stderr.take().map(|stderr| std::thread::spawn(move || listen(stderr)));
        Ok(Self { child, frames, said })
    }

    /// Whether it took the frame.
    fn add(&mut self, rgb: &[u8]) -> bool {
        self.frames.as_mut().is_some_and(|frames| frames.write_all(rgb).is_ok())
    }

    /// Waits for its end. It has failed if it says so, or anything at all: version 5.1 ends with status 0 when there was no
    /// room for the index of the file, without which nobody can play it.
    fn end(&mut self) -> Result<(), String> {
        self.frames = None;
        let ended = self.child.wait();
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        match (ended, said.trim()) {
            (Ok(status), "") if status.success() => Ok(()),
            (Ok(status), "") => Err(format!("ffmpeg ended without a word ({status})")),
            (Err(error), "") => Err(format!("ffmpeg cannot be waited for: {error}")),
            (_, said) => Err(format!("ffmpeg says: {}", said.replace('\n', "; "))),
        }
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // It has ended already, except where there is to be no video.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn listen(stderr: impl Read) -> String {
    let mut reader = BufReader::new(stderr);
    let mut said = Vec::new();
    let _ = reader.by_ref().take(MAX_OUTPUT).read_to_end(&mut said);
    // The rest is read too, so that it does not wait for a reader.
    let _ = io::copy(&mut reader, &mut io::sink());
    String::from_utf8_lossy(&said).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `None` without `ffmpeg`.
    fn video(file: &Path) -> Option<Video> {
        match Video::start(file, (16, 16), FrameTimes::Rate(30.0)) {
            Err(VideoError::NoFfmpeg(_)) => {
                eprintln!("SKIPPED: there is no ffmpeg on this machine");
                None
            }
            started => Some(started.expect("started")),
        }
    }

    #[test]
    fn a_video_is_there_when_it_is_complete() {
        let folder = tempfile::TempDir::new().expect("a folder");
        let file = folder.path().join("v.mp4");
        let Some(mut film) = video(&file) else { return };
        film.add(&[7; 768]).expect("added");
        assert!(!file.exists());
        film.finish().expect("complete");
        assert!(file.is_file());
        let mut second = video(&file).expect("as before");
        second.add(&[7; 768]).expect("added");
        drop(second);
        let left = std::fs::read_dir(folder.path()).expect("a folder").count();
        assert_eq!(left, 1, "the one of before; nothing of the second");
    }

    #[test]
    fn what_ffmpeg_complains_of_is_an_error_whatever_its_status() {
        let folder = tempfile::TempDir::new().expect("a folder");
        let end = |script: &str| {
            let mut child = Command::new("sh").args(["-c", script]).stderr(Stdio::piped()).spawn().expect("a shell");
            let said = child.stderr.take().map(|stderr| std::thread::spawn(move || listen(stderr)));
            let place = Unfinished::new(&folder.path().join("v.mp4")).expect("a place");
            std::fs::write(place.path(), "a part").expect("written");
            let video = Video { encoder: Encoder { child, frames: None, said }, place };
            video.finish().map_err(|error| error.to_string())
        };
        assert_eq!(end("true"), Ok(()));
        // So ended a video on a full disk, which was said to be there.
        let full = "echo '[mp4 @ 0x1] Error writing trailer: No space left on device' >&2";
        let error = end(full).expect_err("no video");
        assert!(
            error.contains("v.mp4 cannot be written: ffmpeg says: [mp4") && error.contains("No space left"),
            "{error}"
        );
        assert!(end("exit 3").expect_err("no video").contains("without a word (exit status: 3)"));
    }
}

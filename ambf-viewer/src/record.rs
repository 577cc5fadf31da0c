//! Pictures and videos of a window as files.

use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ambf_render::{write_rgb_png, FrameTimes, VideoError};
use crossbeam_channel::{bounded, Sender};

use crate::Said;

/// Pixels of a window: (height x width x 3), the top row first.
pub(crate) struct Pixels {
    pub width: u32,
    pub height: u32,
    pub rgb: Vec<u8>,
}

/// Reads what was drawn into the window of the current context, before it is shown.
pub(crate) fn read(gl: &glow::Context, (width, height): (u32, u32)) -> Pixels {
    use glow::HasContext;
    let row = width as usize * 3;
    let mut rows = vec![0; row * height as usize];
    // SAFETY: the context is current in this thread, and the array has room for all rows, which are packed without
    // gaps.
    unsafe {
        gl.bind_framebuffer(glow::READ_FRAMEBUFFER, None);
        gl.bind_buffer(glow::PIXEL_PACK_BUFFER, None);
        gl.pixel_store_i32(glow::PACK_ALIGNMENT, 1);
        let into = glow::PixelPackData::Slice(Some(&mut rows));
        gl.read_pixels(0, 0, width as i32, height as i32, glow::RGB, glow::UNSIGNED_BYTE, into);
    }
    // OpenGL's first row is the lowest.
    let rgb = rows.chunks(row.max(1)).rev().flatten().copied().collect();
    Pixels { width, height, rgb }
}

/// Names of files in the working directory that no file has yet.
#[derive(Debug, Default)]
pub(crate) struct Names {
    /// Second and number of the last one: its file may not be there yet.
    last: (u64, u32),
}

impl Names {
    pub fn next(&mut self, extension: &str) -> PathBuf {
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        self.at(seconds, extension, Path::exists)
    }

    fn at(&mut self, seconds: u64, extension: &str, exists: impl Fn(&Path) -> bool) -> PathBuf {
        let first = if self.last.0 == seconds { self.last.1 + 1 } else { 0 };
        let name = |n: u32| match n {
            0 => PathBuf::from(format!("ambf_{seconds}.{extension}")),
            n => PathBuf::from(format!("ambf_{seconds}_{n}.{extension}")),
        };
        let number = (first..u32::MAX).find(|&n| !exists(&name(n))).unwrap_or(first);
        self.last = (seconds, number);
        name(number)
    }
}

/// Writes a PNG file in a thread of its own; `done` gets a sentence.
pub(crate) fn save(pixels: Pixels, file: PathBuf, done: Sender<Said>) -> Option<JoinHandle<()>> {
    let finished = done.clone();
    let shown = file.display().to_string();
    let work = move || {
        let Pixels { width, height, rgb } = pixels;
        let saved = write_rgb_png(&file, &rgb, (width, height));
        let _ = finished.send(match saved {
            Ok(()) => Said::well(format!("saved {}", file.display())),
            Err(error) => Said::failure(error.to_string()),
        });
    };
    let thread = std::thread::Builder::new().name("picture".into()).spawn(work);
    thread.inspect_err(|error| drop(done.send(Said::failure(format!("{shown} cannot be written: {error}"))))).ok()
}

/// Frames a second of videos.
const RATE: f64 = 30.0;
/// Frames that may wait for the encoder; more are left out.
const FRAMES: usize = 8;

/// A video of a window.
pub(crate) struct Video {
    frames: Option<Sender<Vec<u8>>>,
    writer: Option<JoinHandle<Result<(), VideoError>>>,
    pub file: PathBuf,
    size: (u32, u32),
    next: Instant,
}

impl Video {
    /// Starts the encoder.
    ///
    /// # Errors
    /// A sentence when it does not start, or may not write such a file.
    pub fn start(file: PathBuf, size: (u32, u32)) -> Result<Self, String> {
        let video =
            ambf_render::Video::start(&file, size, FrameTimes::Clock(RATE)).map_err(|error| error.to_string())?;
        let (frames, received) = bounded::<Vec<u8>>(FRAMES);
        let write = move || {
            let mut video = video;
            received.into_iter().try_for_each(|frame| video.add(&frame))?;
            video.finish()
        };
        let writer = std::thread::Builder::new().name("video".into()).spawn(write);
        let writer = writer.map_err(|error| format!("no video: {error}"))?;
        Ok(Self { frames: Some(frames), writer: Some(writer), file, size, next: Instant::now() })
    }

    /// Whether a frame is due, and fits.
    pub fn wants(&mut self, size: (u32, u32), now: Instant) -> bool {
        let due = now >= self.next;
        if due {
            self.next = (self.next + Duration::from_secs_f64(1.0 / RATE)).max(now);
        }
        due && size == self.size
    }

    /// Whether the window still has the size with which the video began.
    pub fn fits(&self, size: (u32, u32)) -> bool {
        size == self.size
    }

    /// Whether the encoder has ended by itself.
    pub fn is_broken(&self) -> bool {
        self.writer.as_ref().is_some_and(JoinHandle::is_finished)
    }

    /// Hands a frame over; it is left out when the encoder is behind.
    pub fn add(&self, pixels: Pixels) {
        if let Some(frames) = &self.frames {
            let _ = frames.try_send(pixels.rgb);
        }
    }

    /// Ends the video. Waits for the encoder.
    pub fn finish(mut self) -> Said {
        self.frames = None;
        match self.writer.take().map(JoinHandle::join) {
            Some(Ok(Ok(()))) | None => Said::well(format!("saved {}", self.file.display())),
            Some(Ok(Err(error))) => Said::failure(error.to_string()),
            Some(Err(_)) => {
                Said::failure(format!("no video {}: its thread panicked, which is a bug", self.file.display()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_the_same_second_differ_before_there_are_files() {
        let mut names = Names::default();
        let mut next = |seconds, extension| names.at(seconds, extension, |path| path == Path::new("ambf_5_1.png"));
        assert_eq!(next(5, "png"), Path::new("ambf_5.png"));
        // The first used to be written over when its thread was slow.
        assert_eq!(next(5, "png"), Path::new("ambf_5_2.png"), "1 is there");
        assert_eq!(next(5, "mp4"), Path::new("ambf_5_3.mp4"));
        assert_eq!(next(6, "png"), Path::new("ambf_6.png"));
    }

    #[test]
    fn a_picture_that_cannot_be_written_is_a_failure() {
        let (done, said) = bounded(2);
        let pixels = || Pixels { width: 1, height: 1, rgb: vec![0; 3] };
        save(pixels(), PathBuf::from("/no/such/folder/a.png"), done.clone())
            .expect("a thread")
            .join()
            .expect("no panic");
        let line = said.recv().expect("a sentence");
        assert!(line.is_failure && line.text.starts_with("/no/such/folder/a.png cannot be written: "), "{line:?}");
        save(pixels(), PathBuf::from("/dev/full"), done).expect("a thread").join().expect("no panic");
        assert!(said.recv().expect("a sentence").is_failure);
    }
}

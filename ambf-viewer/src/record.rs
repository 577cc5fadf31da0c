//! Pictures and videos of a window as files.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crossbeam_channel::{bounded, Sender};

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

/// A file name in the working directory that no file has yet.
pub(crate) fn free_name(extension: &str) -> PathBuf {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let name = |n: u32| match n {
        0 => PathBuf::from(format!("ambf_{seconds}.{extension}")),
        n => PathBuf::from(format!("ambf_{seconds}_{n}.{extension}")),
    };
    (0..).map(name).find(|name| !name.exists()).unwrap_or_else(|| name(0))
}

/// Writes a PNG file in a thread of its own; `done` gets a sentence.
pub(crate) fn save(pixels: Pixels, file: PathBuf, done: Sender<String>) {
    let work = move || {
        let Pixels { width, height, rgb } = pixels;
        let saved = image::save_buffer(&file, &rgb, width, height, image::ExtendedColorType::Rgb8);
        let _ = done.send(match saved {
            Ok(()) => format!("saved {}", file.display()),
            Err(error) => format!("{} cannot be written: {error}", file.display()),
        });
    };
    // Without a thread there is no picture, and nobody to tell.
    let _ = std::thread::Builder::new().name("picture".into()).spawn(work);
}

/// Frames a second of videos.
const RATE: f64 = 30.0;
/// Frames that may wait for the encoder; more are left out.
const FRAMES: usize = 8;

/// A video that is being made by ffmpeg.
pub(crate) struct Video {
    frames: Option<Sender<Vec<u8>>>,
    writer: Option<JoinHandle<Result<(), String>>>,
    pub file: PathBuf,
    size: (u32, u32),
    next: Instant,
}

impl Video {
    /// Starts the encoder.
    ///
    /// # Errors
    /// A sentence when ffmpeg does not start.
    pub fn start(file: &Path, size: (u32, u32)) -> Result<Self, String> {
        let child = Command::new("ffmpeg")
            .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &format!("{}x{}", size.0, size.1), "-use_wallclock_as_timestamps", "1", "-i", "-"])
            // Encoders want even sizes.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-fps_mode", "cfr", "-r", "30", "-pix_fmt", "yuv420p"])
            .arg(file)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| format!("no video: ffmpeg does not start (Debian package ffmpeg): {error}"))?;
        let (frames, received) = bounded::<Vec<u8>>(FRAMES);
        let write = move || encode(child, received.into_iter());
        let writer = std::thread::Builder::new().name("video".into()).spawn(write);
        let writer = writer.map_err(|error| format!("no video: {error}"))?;
        Ok(Self { frames: Some(frames), writer: Some(writer), file: file.to_owned(), size, next: Instant::now() })
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

    /// Ends the video; a sentence. Waits for the encoder.
    pub fn finish(mut self) -> String {
        self.frames = None;
        let outcome = self.writer.take().map(JoinHandle::join);
        match outcome {
            Some(Ok(Ok(()))) | None => format!("saved {}", self.file.display()),
            Some(Ok(Err(why))) => format!("{} is not complete: {why}", self.file.display()),
            Some(Err(_)) => format!("{} is not complete: its thread panicked, which is a bug", self.file.display()),
        }
    }
}

fn encode(mut child: Child, frames: impl Iterator<Item = Vec<u8>>) -> Result<(), String> {
    let mut failed = None;
    if let Some(mut input) = child.stdin.take() {
        for frame in frames {
            if let Err(error) = input.write_all(&frame) {
                failed = Some(error.to_string());
                break;
            }
        }
    }
    let output = child.wait_with_output().map_err(|error| error.to_string())?;
    match (output.status.success(), failed) {
        (true, None) => Ok(()),
        (_, failed) => {
            let said = String::from_utf8_lossy(&output.stderr);
            Err(said.lines().next_back().map(str::to_owned).or(failed).unwrap_or_else(|| output.status.to_string()))
        }
    }
}

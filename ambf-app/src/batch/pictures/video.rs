//! Videos, by the program `ffmpeg`.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use super::{failed, PictureError};

/// Most that is kept of what `ffmpeg` prints, bytes.
const MAX_OUTPUT: u64 = 4096;

/// A video that grows.
pub struct Video {
    file: PathBuf,
    child: Child,
    frames: Option<ChildStdin>,
    /// What it prints.
    said: Option<JoinHandle<String>>,
}

/// The file of one of several cameras: `FOLDER/STEM_CAMERA.EXTENSION`.
pub fn file_of(file: &Path, camera: &str) -> PathBuf {
    let text = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let (stem, extension) = (text(file.file_stem()), text(file.extension()));
    match extension.is_empty() {
        true => file.with_file_name(format!("{stem}_{camera}")),
        false => file.with_file_name(format!("{stem}_{camera}.{extension}")),
    }
}

impl Video {
    /// Starts a video of `rate` frames a second; the extension of its name says how it is encoded.
    ///
    /// # Errors
    /// [`PictureError::NoFfmpeg`], [`PictureError::Write`].
    pub fn start(file: PathBuf, (width, height): (u32, u32), rate: f64) -> Result<Self, PictureError> {
        if let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(failed(folder))?;
        }
        // A name that begins with a dash or names a protocol is a file all the same.
        let target = match file.is_absolute() {
            true => file.clone(),
            false => Path::new(".").join(&file),
        };
        let mut child = Command::new("ffmpeg")
            .args(["-hide_banner", "-nostdin", "-loglevel", "error", "-y", "-f", "rawvideo", "-pixel_format", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &format!("{rate:.6}"), "-i", "pipe:0"])
            // Players want 4:2:0, for which both sizes have to be even. Nothing about the time or the encoder is
            // written.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"])
            .arg(&target)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(PictureError::NoFfmpeg)?;
        let frames = child.stdin.take();
        let said = child.stderr.take().map(|stderr| std::thread::spawn(move || listen(stderr)));
        Ok(Self { file, child, frames, said })
    }

    /// Adds a frame: (height x width x 3), top row first.
    ///
    /// # Errors
    /// [`PictureError::Video`].
    pub fn add(&mut self, color: &[u8]) -> Result<(), PictureError> {
        let written = self.frames.as_mut().is_some_and(|frames| frames.write_all(color).is_ok());
        match written {
            true => Ok(()),
            false => Err(self.failure()),
        }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`PictureError::Video`].
    pub fn finish(mut self) -> Result<(), PictureError> {
        self.frames = None;
        match self.child.wait() {
            Ok(status) if status.success() => Ok(()),
            _ => Err(self.failure()),
        }
    }

    fn failure(&mut self) -> PictureError {
        self.frames = None;
        let _ = self.child.wait();
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        let said = if said.trim().is_empty() { "it ended without a word".to_owned() } else { said.trim().to_owned() };
        PictureError::Video { file: self.file.clone(), said }
    }
}

impl Drop for Video {
    /// What was taken before a run ended early is a video too.
    fn drop(&mut self) {
        self.frames = None;
        let _ = self.child.wait();
    }
}

fn listen(stderr: impl Read) -> String {
    let mut reader = std::io::BufReader::new(stderr);
    let mut said = Vec::new();
    let _ = reader.by_ref().take(MAX_OUTPUT).read_to_end(&mut said);
    // The rest is read too, so that it does not wait for a reader.
    let _ = std::io::copy(&mut reader, &mut std::io::sink());
    String::from_utf8_lossy(&said).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_camera_has_its_file() {
        assert_eq!(file_of(Path::new("a/film.mp4"), "left"), Path::new("a/film_left.mp4"));
        assert_eq!(file_of(Path::new("film"), "left"), Path::new("film_left"));
    }
}

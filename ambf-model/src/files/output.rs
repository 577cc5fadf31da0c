//! Files that are written: there when they are complete, and not before.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use thiserror::Error;

/// Error when a file, or standard output, cannot be written.
#[derive(Debug, Error)]
#[error("{place} cannot be written: {source}")]
pub struct WriteError {
    /// The file as it was asked for, or "standard output".
    pub place: String,
    /// Why.
    pub source: io::Error,
}

impl WriteError {
    /// The error for `file`.
    pub fn new(file: &Path, source: io::Error) -> Self {
        Self { place: file.display().to_string(), source }
    }

    /// Whether who should read has gone: `| head` has seen enough, and nothing is wrong.
    pub fn is_unread(&self) -> bool {
        self.source.kind() == ErrorKind::BrokenPipe
    }
}

/// Makes the folder in which `file` shall be, with those above.
///
/// # Errors
/// [`WriteError`], which names the file.
pub fn folder_for(file: &Path) -> Result<(), WriteError> {
    let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) else { return Ok(()) };
    fs::create_dir_all(folder).map_err(|error| {
        let why = format!("the folder {} cannot be made: {error}", folder.display());
        WriteError::new(file, io::Error::new(error.kind(), why))
    })
}

/// A file that some program writes beside its final place, to which it moves when it is complete. Dropped before that,
/// it is removed, and what was at the final place is still there.
///
/// What is no regular file – a device, a named pipe, standard output by its name in `/dev` – has no place beside it and
/// is written itself. A link to a file stays a link.
#[derive(Debug)]
pub struct Unfinished {
    /// As it was asked for.
    file: PathBuf,
    /// Where it will be.
    target: PathBuf,
    /// Where it is now; `None`: where it will be.
    beside: Option<PathBuf>,
}

impl Unfinished {
    /// Makes an empty file beside `file`, which has the same extension.
    ///
    /// # Errors
    /// [`WriteError`] when there may be no file: its folder is missing or not writable, or it is there and not writable.
    pub fn new(file: &Path) -> Result<Self, WriteError> {
        let failed = |source| WriteError::new(file, source);
        let mut made = Self { file: file.to_owned(), target: target_of(file), beside: None };
        let before = match fs::metadata(&made.target) {
            Ok(found) if !found.is_file() || is_open_elsewhere(file) => return Ok(made),
            Ok(found) => {
                // Who may write the folder need not be meant to replace this file.
                OpenOptions::new().write(true).open(&made.target).map_err(failed)?;
                Some(found.permissions())
            }
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(failed(error)),
        };
        let beside = made.beside.insert(create_beside(&made.target).map_err(failed)?);
        if let Some(permissions) = before {
            fs::set_permissions(beside, permissions).map_err(failed)?;
        }
        Ok(made)
    }

    /// The file as it was asked for.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Where to write.
    pub fn path(&self) -> &Path {
        self.beside.as_deref().unwrap_or(&self.target)
    }

    /// Moves it to its final place.
    ///
    /// # Errors
    /// [`WriteError`]; it is removed then.
    pub fn complete(mut self) -> Result<(), WriteError> {
        let Some(beside) = self.beside.take() else { return Ok(()) };
        fs::rename(&beside, &self.target).map_err(|source| {
            let _ = fs::remove_file(&beside);
            WriteError::new(&self.file, source)
        })
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(beside) = &self.beside {
            // Nobody is left to whom a failure could be told; the name says that it is unfinished.
            let _ = fs::remove_file(beside);
        }
    }
}

/// The file that is meant where `file` is a link, be there such a file or not.
fn target_of(file: &Path) -> PathBuf {
    match (fs::canonicalize(file), fs::read_link(file)) {
        (Ok(target), _) => target,
        (Err(_), Ok(target)) => file.parent().unwrap_or(Path::new("")).join(target),
        (Err(_), Err(_)) => file.to_owned(),
    }
}

/// Whether a name stands for what a process has open, such as `/dev/stdout`.
fn is_open_elsewhere(file: &Path) -> bool {
    ["/dev", "/proc"].iter().any(|folder| file.starts_with(folder))
}

/// A new file in the folder of `target`: `.unfinished-PROCESS-NUMBER.EXTENSION`.
fn create_beside(target: &Path) -> io::Result<PathBuf> {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    if target.file_name().is_none() {
        return Err(ErrorKind::IsADirectory.into());
    }
    loop {
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let mut name = OsString::from(format!(".unfinished-{}-{number}", std::process::id()));
        if let Some(extension) = target.extension() {
            name.push(".");
            name.push(extension);
        }
        let beside = target.with_file_name(name);
        match OpenOptions::new().write(true).create_new(true).open(&beside) {
            Ok(_) => return Ok(beside),
            // Of a process of the same number, on another machine or killed.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => (),
            Err(error) => return Err(error),
        }
    }
}

/// A file that this program writes, as [`Unfinished`] says. A write that fails ends it: what was written is removed at
/// once, so that others have its room.
#[derive(Debug)]
pub struct Output {
    place: Unfinished,
    /// `None` after a write has failed.
    writer: Option<BufWriter<File>>,
}

impl Output {
    /// Begins a file.
    ///
    /// # Errors
    /// As [`Unfinished::new`].
    pub fn create(file: &Path) -> Result<Self, WriteError> {
        let place = Unfinished::new(file)?;
        let opened = OpenOptions::new().write(true).create(true).truncate(true).open(place.path());
        let writer = Some(BufWriter::new(opened.map_err(|source| WriteError::new(file, source))?));
        Ok(Self { place, writer })
    }

    /// Writes a whole file with what `write` writes.
    ///
    /// # Errors
    /// [`WriteError`]; the file of before, or none, is there then.
    pub fn write_whole(file: &Path, write: impl FnOnce(&mut Self) -> io::Result<()>) -> Result<(), WriteError> {
        let mut output = Self::create(file)?;
        output.add(write)?;
        output.finish()
    }

    /// Writes what `write` writes.
    ///
    /// # Errors
    /// [`WriteError`]; the file is given up then.
    pub fn add(&mut self, write: impl FnOnce(&mut Self) -> io::Result<()>) -> Result<(), WriteError> {
        write(self).map_err(|source| {
            self.give_up();
            WriteError::new(&self.place.file, source)
        })
    }

    /// Writes what is left, closes the file and moves it to its final place.
    ///
    /// # Errors
    /// [`WriteError`], also when a write has failed before; the file of before, or none, is there then.
    pub fn finish(self) -> Result<(), WriteError> {
        let Self { place, writer } = self;
        let close = |writer: BufWriter<File>| -> io::Result<()> {
            let file = writer.into_inner().map_err(io::IntoInnerError::into_error)?;
            // Some file systems say only now that there was no room; dropping the file would not tell.
            Ok(nix::unistd::close(file)?)
        };
        let closed = writer.ok_or_else(given_up).and_then(close);
        closed.map_err(|source| WriteError::new(&place.file, source))?;
        place.complete()
    }

    fn give_up(&mut self) {
        if let Some(writer) = self.writer.take() {
            // Without another attempt to write what is left.
            drop(writer.into_parts());
            if let Some(beside) = self.place.beside.take() {
                let _ = fs::remove_file(beside);
            }
        }
    }
}

fn given_up() -> io::Error {
    io::Error::other("a part of it could not be written before")
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.writer.as_mut().ok_or_else(given_up)?.write(bytes);
        written.inspect_err(|_| self.give_up())
    }

    fn flush(&mut self) -> io::Result<()> {
        let flushed = self.writer.as_mut().ok_or_else(given_up)?.flush();
        flushed.inspect_err(|_| self.give_up())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{symlink, PermissionsExt};

    fn folder() -> tempfile::TempDir {
        tempfile::TempDir::new().expect("a folder")
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder");
        let mut names: Vec<_> =
            entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("text")).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_there_when_it_is_complete_and_not_before() {
        let folder = folder();
        let file = folder.path().join("a.csv");
        fs::write(&file, "before").expect("written");
        let mut output = Output::create(&file).expect("begun");
        output.write_all(b"after").expect("written");
        assert_eq!(fs::read(&file).expect("still there"), b"before");
        drop(output);
        assert_eq!((names(folder.path()), fs::read(&file).expect("there")), (vec!["a.csv".into()], b"before".to_vec()));
        Output::write_whole(&file, |out| out.write_all(b"after")).expect("written");
        assert_eq!((names(folder.path()), fs::read(&file).expect("there")), (vec!["a.csv".into()], b"after".to_vec()));
    }

    #[test]
    fn a_write_that_fails_leaves_nothing_and_says_which_file() {
        let folder = folder();
        let file = folder.path().join("a.csv");
        let why = Output::write_whole(&file, |out| {
            out.write_all(b"half")?;
            Err(io::Error::from(ErrorKind::StorageFull))
        });
        assert_eq!(
            why.expect_err("full").to_string(),
            format!("{} cannot be written: no storage space", file.display())
        );
        let mut output = Output::create(&file).expect("begun");
        output.add(|_| Err(ErrorKind::StorageFull.into())).expect_err("full");
        assert!(names(folder.path()).is_empty(), "its room is free at once");
        assert!(output.write_all(b"more").is_err() && output.finish().is_err());
        let gone = folder.path().join("none/a.csv");
        let error = Output::create(&gone).expect_err("no folder").to_string();
        assert!(error.starts_with(&format!("{} cannot be written: No such file", gone.display())), "{error}");
        folder_for(&gone).expect("made");
        Output::write_whole(&gone, |out| out.write_all(b"x")).expect("written");
        let error = Output::create(folder.path()).expect_err("a folder").to_string();
        assert!(error.contains("cannot be written: Is a directory"), "{error}");
    }

    #[test]
    fn what_does_not_fit_is_noticed_when_it_is_closed() {
        // What is buffered goes out in the end only.
        let full = Path::new("/dev/full");
        let error = Output::write_whole(full, |out| out.write_all(b"x")).expect_err("full");
        assert!(error.to_string().starts_with("/dev/full cannot be written: No space left on device"), "{error}");
        Output::write_whole(Path::new("/dev/null"), |out| out.write_all(b"x")).expect("a device is written itself");
    }

    #[test]
    fn links_and_permissions_stay() {
        let folder = folder();
        let place = |name: &str| folder.path().join(name);
        fs::write(place("file"), "").expect("written");
        fs::set_permissions(place("file"), fs::Permissions::from_mode(0o640)).expect("set");
        symlink("file", place("link")).expect("a link");
        symlink("new", place("dangling")).expect("a link");
        for link in ["link", "dangling"] {
            Output::write_whole(&place(link), |out| out.write_all(b"x")).expect("written");
            assert!(place(link).is_symlink());
        }
        assert_eq!(names(folder.path()), ["dangling", "file", "link", "new"]);
        assert_eq!(fs::metadata(place("file")).expect("there").permissions().mode() & 0o777, 0o640);
        assert_eq!(fs::read(place("new")).expect("there"), b"x");
    }

    #[test]
    fn an_unfinished_file_has_the_extension_that_programs_go_by() {
        let folder = folder();
        let file = folder.path().join(format!("{}.mp4", "n".repeat(250)));
        let unfinished = Unfinished::new(&file).expect("a name of any length");
        assert_eq!(unfinished.path().extension(), Some("mp4".as_ref()));
        unfinished.complete().expect("moved");
        assert!(file.is_file());
    }
}

//! Reading of regular files.

use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

/// What a path names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// A regular file.
    File,
    /// Something else, in words: "a folder", "a named pipe".
    Other(&'static str),
    /// Nothing that can be looked at.
    Nothing,
}

/// Looks at what a path names, and opens nothing.
pub fn look(path: &Path) -> Found {
    match std::fs::metadata(path).map(|found| kind(found.file_type())) {
        Ok(None) => Found::File,
        Ok(Some(kind)) => Found::Other(kind),
        Err(_) => Found::Nothing,
    }
}

fn kind(found: FileType) -> Option<&'static str> {
    Some(match found {
        kind if kind.is_file() => return None,
        kind if kind.is_dir() => "a folder",
        kind if kind.is_fifo() => "a named pipe",
        kind if kind.is_socket() => "a socket",
        _ => "a device",
    })
}

/// Opens a regular file, without waiting for anybody.
///
/// # Errors
/// What the operating system says; [`ErrorKind::InvalidInput`], with the kind in words, for what is no regular file.
pub fn open(path: &Path) -> io::Result<(File, Metadata)> {
    let regular = |found: Metadata| match kind(found.file_type()) {
        None => Ok(found),
        Some(kind) => Err(io::Error::new(ErrorKind::InvalidInput, format!("it is {kind}, expected a file"))),
    };
    // Asked for before opening, which would do something to a device.
    regular(std::fs::metadata(path)?)?;
    // Something else may have taken its place since: opening a named pipe waits for its writer, unless told not to.
    let file = OpenOptions::new().read(true).custom_flags(nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY).open(path)?;
    let found = regular(file.metadata()?)?;
    Ok((file, found))
}

/// Content of a regular file, at most one byte more than `limit`: more than `limit` bytes are a file that is too large.
///
/// # Errors
/// As [`open`].
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let (file, _) = open(path)?;
    let mut bytes = Vec::new();
    // Not by the length of the file, which some system files lack.
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Text of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open`]; [`ErrorKind::FileTooLarge`]; [`ErrorKind::InvalidData`] for what is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    let bytes = read(path, limit)?;
    if bytes.len() as u64 > limit {
        let why = format!("it is larger than the {limit} bytes that are read");
        return Err(io::Error::new(ErrorKind::FileTooLarge, why));
    }
    String::from_utf8(bytes).map_err(|error| {
        let place = error.utf8_error().valid_up_to();
        io::Error::new(ErrorKind::InvalidData, format!("byte {place} is no UTF-8, expected text"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_file_is_named_and_never_waited_for() {
        let folder = tempfile::TempDir::new().expect("a folder");
        let place = |name: &str| folder.path().join(name);
        nix::sys::stat::mknod(&place("pipe"), nix::sys::stat::SFlag::S_IFIFO, nix::sys::stat::Mode::S_IRWXU, 0)
            .expect("a named pipe");
        let _listener = std::os::unix::net::UnixListener::bind(place("socket")).expect("a socket");
        std::os::unix::fs::symlink("pipe", place("link")).expect("a link");
        let found = [("pipe", "a named pipe"), ("link", "a named pipe"), ("socket", "a socket"), (".", "a folder")];
        for (name, kind) in found {
            let error = read(&place(name), 10).expect_err(name).to_string();
            assert_eq!(error, format!("it is {kind}, expected a file"));
            assert_eq!(look(&place(name)), Found::Other(kind));
        }
        assert_eq!(
            read(Path::new("/dev/zero"), 10).expect_err("a device").to_string(),
            "it is a device, expected a file"
        );
        assert_eq!(read(&place("nothing"), 10).expect_err("nothing").kind(), ErrorKind::NotFound);
        assert_eq!(look(&place("nothing")), Found::Nothing);
    }

    #[test]
    fn a_file_above_the_limit_is_recognised_by_one_byte_more() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), [7; 20]).expect("written");
        assert_eq!(read(file.path(), 10).expect("readable").len(), 11);
        assert_eq!(read(file.path(), 20).expect("readable").len(), 20);
        assert!(read_text(file.path(), 10).expect_err("too large").to_string().contains("larger than the 10 bytes"));
        assert_eq!(read_text(file.path(), 20).expect("text"), "\u{7}".repeat(20));
        std::fs::write(file.path(), b"a\xff").expect("written");
        assert_eq!(read_text(file.path(), 20).expect_err("no text").to_string(), "byte 1 is no UTF-8, expected text");
        assert!(!read(Path::new("/proc/self/stat"), 1 << 20).expect("readable").is_empty(), "of unknown length");
    }
}

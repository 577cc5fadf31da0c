//! Which files something was made of, and whether they are still the same.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// A file that was changed less than this before it was read may be changed again without a sign of it: file systems
/// keep times in ticks of some milliseconds.
const SETTLED: Duration = Duration::from_millis(50);

/// The state of a file, as far as it can be told without reading it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Stamp {
    device: u64,
    inode: u64,
    size: u64,
    modified: (i64, i64),
    changed: (i64, i64),
}

impl Stamp {
    fn of(path: &Path) -> Option<Self> {
        let found = std::fs::metadata(path).ok()?;
        Some(Self {
            device: found.dev(),
            inode: found.ino(),
            size: found.size(),
            modified: (found.mtime(), found.mtime_nsec()),
            changed: (found.ctime(), found.ctime_nsec()),
        })
    }

    fn is_settled(&self) -> bool {
        let (seconds, nanoseconds) = self.modified.max(self.changed);
        let Ok(seconds) = u64::try_from(seconds) else { return true };
        let changed = UNIX_EPOCH + Duration::new(seconds, u32::try_from(nanoseconds).unwrap_or_default());
        SystemTime::now().duration_since(changed).is_ok_and(|age| age >= SETTLED)
    }
}

/// Files that something was read from or that were looked for, each as it was directly before.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Sources(Vec<(PathBuf, Option<Stamp>)>);

impl Sources {
    /// Adds a file that will be read, or looked for, now.
    pub fn add(&mut self, path: &Path) {
        self.0.push((path.to_path_buf(), Stamp::of(path)));
    }

    /// Adds those of something else.
    pub fn extend(&mut self, others: &Sources) {
        self.0.extend_from_slice(&others.0);
    }

    /// The files, also those that were looked for and are not there.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.0.iter().map(|(path, _)| path.as_path())
    }

    /// Whether no file was changed, added or removed since: what would be read now is what was read. Costs a system
    /// call a file.
    pub fn are_current(&self) -> bool {
        self.0.iter().all(|(path, stamp)| Stamp::of(path) == *stamp)
    }

    /// Whether a later change would be seen by [`are_current`](Self::are_current): no file was changed only just
    /// before it was read.
    pub fn are_settled(&self) -> bool {
        self.0.iter().all(|(_, stamp)| stamp.as_ref().is_none_or(Stamp::is_settled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_change_is_seen() {
        let folder = std::env::temp_dir().join(format!("ambf_sources_{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (there, absent) = (folder.join("there"), folder.join("absent"));
        std::fs::write(&there, "one").unwrap();
        let of = |path: &Path| {
            let mut sources = Sources::default();
            sources.add(path);
            sources
        };
        let (first, none) = (of(&there), of(&absent));
        assert!(first.are_current() && none.are_current() && none.are_settled());
        // Written just now.
        assert!(!first.are_settled());
        std::fs::write(&there, "three").unwrap();
        std::fs::write(&absent, "").unwrap();
        assert!(!first.are_current() && !none.are_current());
        let second = of(&there);
        std::fs::remove_file(&there).unwrap();
        assert!(!second.are_current());
        assert!(of(Path::new("/proc/self/exe")).are_current());
        std::fs::remove_dir_all(folder).unwrap();
    }
}

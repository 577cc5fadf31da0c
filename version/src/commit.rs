//! What git says about a working tree.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What programs are made of, as git's path specifications; what is tested, measured or fuzzed is not.
const SOURCES: [&str; 10] = [
    "Cargo.lock",
    ":(glob)**/Cargo.toml",
    ":(glob)**/build.rs",
    ":(glob)**/src/**",
    "ambf-dynamics/cpp",
    "bullet-sys/shim",
    ":(exclude)bench",
    ":(exclude)fuzz",
    ":(exclude)python",
    ":(exclude)tests",
];

/// The commit of a working tree.
#[derive(Debug)]
pub(crate) struct Commit {
    /// Its short hash, with `-dirty` behind where [`SOURCES`] have been changed since.
    pub name: String,
    /// Files that tell by their time that `name` may be another one.
    pub watched: Vec<PathBuf>,
}

/// The commit of the working tree `root`; `None` for a folder that is none, such as an unpacked archive, and where git is
/// missing.
pub(crate) fn of(root: &Path) -> Option<Commit> {
    // The archive may have been unpacked in the working tree of something else.
    let top = git(root, ["rev-parse", "--show-toplevel"])?;
    if Path::new(&top).canonicalize().ok()? != root.canonicalize().ok()? {
        return None;
    }
    let hash = git(root, ["rev-parse", "--short", "HEAD"])?;
    let status = ["--no-optional-locks", "status", "--porcelain", "--untracked-files=no", "--"];
    let is_dirty = !git(root, status.into_iter().chain(SOURCES))?.is_empty();
    let sources = git(root, ["ls-files", "-z", "--"].into_iter().chain(SOURCES))?;
    // The first is written at each commit, checkout and reset; the second where there is no such log.
    let states = ["logs/HEAD", "HEAD"].map(|file| git(root, ["rev-parse", "--git-path", file]));
    let state = states.into_iter().flatten().map(|file| root.join(file)).find(|file| file.is_file());
    // Cargo takes a file that is not there for one that changes all the time.
    let sources = sources.split_terminator('\0').map(|file| root.join(file)).filter(|file| file.is_file());
    let name = if is_dirty { format!("{hash}-dirty") } else { hash };
    Some(Commit { name, watched: state.into_iter().chain(sources).collect() })
}

/// What git prints, without the line's end; `None` where it fails.
fn git<A: AsRef<OsStr>>(root: &Path, arguments: impl IntoIterator<Item = A>) -> Option<String> {
    let output = Command::new("git").arg("-C").arg(root).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok().filter(|_| output.status.success())?;
    Some(text.trim_end_matches('\n').to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn write(root: &Path, file: &str, text: &str) {
        let file = root.join(file);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }

    fn told(root: &Path, arguments: &[&str]) -> String {
        let own = ["-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"];
        git(root, own.iter().chain(arguments)).unwrap_or_else(|| panic!("git {arguments:?}"))
    }

    #[test]
    fn a_commit_is_named_and_changed_sources_make_it_dirty() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        assert!(of(root).is_none(), "an archive");
        told(root, &["init", "--quiet"]);
        assert!(of(root).is_none(), "nothing is committed");
        for file in ["a/src/lib.rs", "bench/src/lib.rs", "docs/page.md", "Cargo.lock"] {
            write(root, file, "1");
        }
        told(root, &["add", "."]);
        told(root, &["commit", "--quiet", "--message", "first"]);
        let hash = told(root, &["rev-parse", "--short", "HEAD"]);
        let commit = of(root).unwrap();
        assert_eq!(commit.name, hash);
        let watched = |file: &str| commit.watched.contains(&root.join(file));
        assert!(watched("a/src/lib.rs") && watched("Cargo.lock") && watched(".git/logs/HEAD"), "{commit:?}");
        assert_eq!(commit.watched.len(), 3, "{commit:?}");

        write(root, "docs/page.md", "2");
        write(root, "bench/src/lib.rs", "2");
        write(root, "a/src/new.rs", "2");
        assert_eq!(of(root).unwrap().name, hash, "no program is made of that");
        write(root, "a/src/lib.rs", "2");
        assert_eq!(of(root).unwrap().name, format!("{hash}-dirty"));
        told(root, &["commit", "--quiet", "--all", "--message", "second"]);
        let next = of(root).unwrap().name;
        assert!(next != hash && !next.ends_with("-dirty"), "{next}");

        write(root, "unpacked/a/src/lib.rs", "1");
        assert!(of(&root.join("unpacked")).is_none(), "an archive in the working tree of something else");
    }

    #[test]
    fn sources_of_this_project_are_found() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let Some(commit) = of(root) else {
            println!("SKIPPED: this is no working tree of git");
            return;
        };
        for file in ["version/src/commit.rs", "ambf-core/src/lib.rs", "bullet-sys/shim/shim.h", "Cargo.lock"] {
            assert!(commit.watched.contains(&root.join(file)), "{file}");
        }
        assert!(!commit.watched.iter().any(|file| file.starts_with(root.join("fuzz"))));
    }
}

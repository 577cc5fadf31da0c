//! Writes the version into the crate: `AMBF_VERSION`.

use std::env;
use std::path::Path;

#[path = "src/commit.rs"]
mod commit;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src");
    let version = env::var("CARGO_PKG_VERSION").expect("cargo sets it");
    let folder = env::var("CARGO_MANIFEST_DIR").expect("cargo sets it");
    let root = Path::new(&folder).parent().expect("the crate is a folder of the project");
    // A new commit compiles what depends on this crate once more. Debug builds do without: all test programs would be
    // linked again.
    let is_release = env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let commit = if is_release { commit::of(root) } else { None };
    for file in commit.iter().flat_map(|commit| &commit.watched) {
        println!("cargo::rerun-if-changed={}", file.display());
    }
    let version = commit.map_or(version.clone(), |commit| format!("{version} ({})", commit.name));
    println!("cargo::rustc-env=AMBF_VERSION={version}");
}

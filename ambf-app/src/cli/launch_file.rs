//! Where the launch file is when the command line doesn't say.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Default launch file: `$AMBF_ROOT_PATH/ambf_models/descriptions/launch.yaml` if that variable is set, else
/// `$AMBF_RESOURCES/launch.yaml`, else `resources/launch.yaml`, or `share/ambf/launch.yaml` of an installed package, in
/// the nearest folder above the program, the place it was built from or the working directory. Empty variables count as
/// not set.
pub(super) fn default() -> PathBuf {
    let program = std::env::current_exe().ok();
    let working = std::env::current_dir().ok();
    let starts =
        [program.as_deref().and_then(Path::parent), Some(Path::new(env!("CARGO_MANIFEST_DIR"))), working.as_deref()];
    search(|name| std::env::var_os(name), starts.into_iter().flatten())
}

fn search<'a>(variable: impl Fn(&str) -> Option<OsString>, starts: impl Iterator<Item = &'a Path>) -> PathBuf {
    let folder = |name| variable(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(root) = folder("AMBF_ROOT_PATH") {
        return root.join("ambf_models/descriptions/launch.yaml");
    }
    if let Some(resources) = folder("AMBF_RESOURCES") {
        return resources.join("launch.yaml");
    }
    let [shipped, installed] = ["resources/launch.yaml", "share/ambf/launch.yaml"].map(Path::new);
    starts
        .flat_map(Path::ancestors)
        .flat_map(|folder| [shipped, installed].map(|file| folder.join(file)))
        .find(|file| file.is_file())
        // Nothing found: the loader's message names the place where it belongs.
        .unwrap_or_else(|| shipped.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(variables: &[(&str, &str)], start: &Path) -> PathBuf {
        let variable =
            |name: &str| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| OsString::from(value));
        search(variable, std::iter::once(start))
    }

    #[test]
    fn variables_go_first_and_empty_ones_do_not_count() {
        let nowhere = Path::new("/nonexistent");
        let both = [("AMBF_ROOT_PATH", "/old"), ("AMBF_RESOURCES", "/new")];
        assert_eq!(with(&both, nowhere), Path::new("/old/ambf_models/descriptions/launch.yaml"));
        assert_eq!(with(&both[1..], nowhere), Path::new("/new/launch.yaml"));
        assert_eq!(
            with(&[("AMBF_ROOT_PATH", ""), ("AMBF_RESOURCES", "")], nowhere),
            Path::new("resources/launch.yaml")
        );
    }

    #[test]
    fn an_installed_program_finds_the_files_of_its_package() {
        let top = tempfile::tempdir().unwrap();
        let [programs, shared] = ["usr/bin", "usr/share/ambf"].map(|folder| top.path().join(folder));
        [&programs, &shared].into_iter().for_each(|folder| std::fs::create_dir_all(folder).unwrap());
        std::fs::write(shared.join("launch.yaml"), "").unwrap();
        assert_eq!(with(&[], &programs), shared.join("launch.yaml"));
    }

    #[test]
    fn the_nearest_folder_above_with_resources_wins() {
        let top = std::env::temp_dir().join(format!("ambf-launch-file-{}", std::process::id()));
        let deep = top.join("target/release");
        std::fs::create_dir_all(&deep).unwrap();
        std::fs::create_dir_all(top.join("resources")).unwrap();
        std::fs::write(top.join("resources/launch.yaml"), "").unwrap();
        let found = with(&[], &deep);
        std::fs::remove_dir_all(&top).unwrap();
        assert_eq!(found, top.join("resources/launch.yaml"));
    }
}

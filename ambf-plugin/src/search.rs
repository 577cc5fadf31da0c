//! Where libraries are looked for, and which names are known not to be ours.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::PluginError;
use ambf_model::adf::PluginEntry;
use ambf_model::files::read;

/// Where libraries are looked for.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Search {
    /// Folders of `AMBF_PLUGIN_PATH`, or the default ones if it is unset or empty.
    pub folders: Vec<PathBuf>,
    /// Folder that relative names with a folder in them start from.
    pub working_folder: PathBuf,
}

/// What a file name leads to.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Found {
    /// A file.
    File(PathBuf),
    /// Nothing of what was tried.
    Nothing(Vec<PathBuf>),
}

impl Search {
    /// As this process was started: `AMBF_PLUGIN_PATH`, else the folder of the program, `plugins` in it, and
    /// `../lib/ambf/plugins` beside it.
    pub fn from_environment() -> Self {
        let program = std::env::current_exe().ok().and_then(|path| path.parent().map(Path::to_owned));
        Self::new(
            std::env::var_os("AMBF_PLUGIN_PATH"),
            &program.unwrap_or_default(),
            std::env::current_dir().unwrap_or_default(),
        )
    }

    fn new(plugin_path: Option<OsString>, program: &Path, working_folder: PathBuf) -> Self {
        let named: Vec<PathBuf> = plugin_path.iter().flat_map(std::env::split_paths).collect();
        let named: Vec<PathBuf> = named.into_iter().filter(|folder| !folder.as_os_str().is_empty()).collect();
        let default = || vec![program.to_owned(), program.join("plugins"), program.join("../lib/ambf/plugins")];
        Self { folders: if named.is_empty() { default() } else { named }, working_folder }
    }

    /// The file that `filename` means, for an entry whose own folder is `path`: an absolute name only itself; otherwise
    /// the first that exists in its own folder, in the folders of the environment or the default ones, in the working
    /// folder. A name with a folder in it is tried in the working folder first.
    fn find(&self, filename: &Path, path: Option<&Path>) -> Found {
        if filename.is_absolute() {
            let is_there = filename.is_file();
            return if is_there { Found::File(filename.to_owned()) } else { Found::Nothing(vec![filename.to_owned()]) };
        }
        let has_folder = filename.components().count() > 1;
        let here = std::iter::once(self.working_folder.as_path());
        let listed = path.into_iter().chain(self.folders.iter().map(PathBuf::as_path));
        let mut tried = Vec::new();
        let folders: Vec<&Path> = if has_folder { here.chain(listed).collect() } else { listed.chain(here).collect() };
        for folder in folders {
            let candidate = folder.join(filename);
            if candidate.is_file() {
                return Found::File(candidate);
            }
            if !tried.contains(&candidate) {
                tried.push(candidate);
            }
        }
        Found::Nothing(tried)
    }

    /// The file of an entry, without opening it.
    ///
    /// # Errors
    /// [`PluginError::NotFound`], [`PluginError::Cpp`].
    pub(crate) fn look_up(&self, entry: &PluginEntry) -> Result<PathBuf, PluginError> {
        let cpp = |advice: &str| PluginError::Cpp { advice: advice.to_owned() };
        let known = known(&entry.filename);
        match self.find(&entry.filename, entry.path.as_deref()) {
            Found::File(file) if is_cpp_plugin(&file) => Err(cpp(known.unwrap_or(REWRITE))),
            Found::File(file) => Ok(file),
            Found::Nothing(tried) => Err(known.map_or(PluginError::NotFound { tried, loader: None }, cpp)),
        }
    }
}

/// Names that libraries of public plugins for the C++ program begin with, and what to do without them.
const KNOWN: [(&str, &str); 7] = [
    (
        "libambf_crtk",
        "this program does not serve the CRTK topics (measured_js, servo_cp, …) of simulated arms, ambf_simulator does \
         (docs/crtk.md); the entry is skipped; clients can command the joints of the arm with `joint_cmds` on the topic `…/Command` \
         of its base body",
    ),
    (
        "libvolumetric_drilling",
        "a volume with `tools` in its file is touched and cut without it, and has its topics (docs/volumes.md)",
    ),
    ("libcamera_override", "give the camera `intrinsics` or a `projection matrix` in its file (docs/user-guide.md)"),
    ("libambf_recording", "record with rosbag, or with the example plugin in resources/plugins/recorder"),
    ("libsimulator_plugin_example", "resources/plugins/recorder is a worked example for this program"),
    ("libworld_plugin_example", "resources/plugins/recorder is a worked example for this program"),
    ("libambf_vol", "volumes are touched, cut and restored without a plugin (docs/volumes.md)"),
];

/// Most bytes of a library that are looked at.
const MAX_LIBRARY: u64 = 256 << 20;

const REWRITE: &str = "write it again against the interface in docs/plugins.md";

fn known(filename: &Path) -> Option<&'static str> {
    let name = filename.file_name()?.to_str()?;
    KNOWN.iter().find(|(start, _)| name.starts_with(start)).map(|(_, advice)| *advice)
}

/// Whether a file exports what plugins of the C++ program do and not what ours do. It is only read, not opened by the
/// dynamic loader, so that nothing in it runs.
fn is_cpp_plugin(file: &Path) -> bool {
    let Ok(bytes) = read(file, MAX_LIBRARY) else { return false };
    let holds = |text: &[u8]| bytes.windows(text.len()).any(|window| window == text);
    holds(b"CreatePlugin\0") && !holds(b"ambf_plugin_abi_version\0")
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_model::adf::SourcePos;
    use tempfile::TempDir;

    struct Folder(TempDir);

    impl Folder {
        fn new() -> Self {
            Self(TempDir::new().unwrap())
        }

        fn with(&self, folder: &str, file: &str, content: &str) -> PathBuf {
            let folder = self.0.path().join(folder);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(file), content).unwrap();
            folder
        }
    }

    #[test]
    fn own_path_then_environment_then_working_folder() {
        let root = Folder::new();
        let (own, first) = (root.with("own", "p.so", ""), root.with("first", "p.so", ""));
        let (second, here) = (root.with("second", "q.so", ""), root.with("here", "r.so", ""));
        root.with("here/sub", "p.so", "");
        root.with("first/sub", "p.so", "");
        let search = Search { folders: vec![first.clone(), second.clone()], working_folder: here.clone() };
        let find = |name: &str, path: Option<&Path>| search.find(Path::new(name), path);
        assert_eq!(find("p.so", Some(&own)), Found::File(own.join("p.so")));
        assert_eq!(find("p.so", None), Found::File(first.join("p.so")));
        assert_eq!(find("q.so", Some(&own)), Found::File(second.join("q.so")));
        assert_eq!(find("r.so", None), Found::File(here.join("r.so")));
        assert_eq!(find("sub/p.so", None), Found::File(here.join("sub/p.so")), "a path is meant from here first");
        let absolute = second.join("q.so");
        assert_eq!(search.find(&absolute, Some(&own)), Found::File(absolute.clone()));
        let tried = ["own", "first", "second", "here"].map(|folder| root.0.path().join(folder).join("x.so"));
        assert_eq!(find("x.so", Some(&own)), Found::Nothing(tried.to_vec()));
        let absent = root.0.path().join("p.so");
        assert_eq!(
            search.find(&absent, Some(&own)),
            Found::Nothing(vec![absent]),
            "an absolute name means itself only"
        );
    }

    #[test]
    fn an_empty_variable_is_as_none() {
        let program = Path::new("/opt/ambf/bin");
        let default = Search::new(None, program, "/w".into());
        assert_eq!(default.folders[0], program);
        assert_eq!(Search::new(Some("".into()), program, "/w".into()), default);
        let named = Search::new(Some("/a::/b".into()), program, "/w".into());
        assert_eq!(named.folders, ["/a", "/b"].map(PathBuf::from));
    }

    #[test]
    fn plugins_of_the_cpp_program_are_known_by_name_and_by_content() {
        let root = Folder::new();
        let folder = root.with("f", "libmine.so", "\u{7f}ELF\0CreatePlugin\0");
        root.with("f", "libours.so", "CreatePlugin\0ambf_plugin_abi_version\0");
        let search = Search { folders: vec![folder], working_folder: root.0.path().to_owned() };
        let check = |name: &str| {
            let source = SourcePos { file: Path::new("w.yaml").into(), line: 1, column: 1 };
            search.look_up(&PluginEntry { name: "p".into(), filename: name.into(), path: None, source })
        };
        let error = check("libambf_crtk_simulator_plugin.so").unwrap_err().to_string();
        assert!(error.contains("C++") && error.contains("CRTK topics"), "{error}");
        assert!(error.contains("the entry is skipped") && error.contains("joint_cmds"), "{error}");
        assert!(!error.contains("dvrk") && !error.contains("input device"), "{error}");
        let error = check("libmine.so").unwrap_err().to_string();
        assert!(error.contains("C++") && error.contains("docs/plugins.md"), "{error}");
        assert!(check("libours.so").is_ok());
        let error = check("libabsent.so").unwrap_err().to_string();
        assert!(error.contains("f/libabsent.so"), "{error}");
    }
}

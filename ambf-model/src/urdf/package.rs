//! Where `package://NAME/FILE` leads.

use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeMap, HashMap};
use std::ffi::OsString;
use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::files;

/// How deep packages are looked for below a folder of `ROS_PACKAGE_PATH`, and how many folders are looked at.
const MAX_DEPTH: usize = 6;
const MAX_FOLDERS: usize = 20_000;

/// Largest `package.xml` that is read, bytes.
const MAX_MANIFEST: u64 = 1 << 20;

/// The ROS packages that a description may refer to.
///
/// The default knows none and never looks at a disk.
#[derive(Debug, Default)]
pub struct Packages {
    /// Folders that are a package, or hold one by its name: those above the description.
    above: Vec<PathBuf>,
    /// Folders that hold packages at any depth.
    roots: Vec<PathBuf>,
    /// Folders that hold packages by their names.
    shares: Vec<PathBuf>,
    /// All packages below `roots`; made when it is first needed.
    index: OnceCell<HashMap<String, PathBuf>>,
    /// What was asked for, and what was found.
    asked: RefCell<BTreeMap<String, Option<PathBuf>>>,
}

/// Where the packages were that a description refers to.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PackagePlaces(BTreeMap<String, Option<PathBuf>>);

impl PackagePlaces {
    /// Whether each of them would be found at the same place for the description `file` now. Looks at no disk for a
    /// description that refers to no package.
    pub fn are_current(&self, file: &Path) -> bool {
        if self.0.is_empty() {
            return true;
        }
        let packages = Packages::around(file);
        self.0.iter().all(|(name, place)| packages.find(name) == *place)
    }
}

impl Packages {
    /// The packages that can be seen from a file: first those the file lies in or beside (each folder above it, and the
    /// folders in there), then those below the folders in `ROS_PACKAGE_PATH`, then those in `share` of the folders in
    /// `AMENT_PREFIX_PATH`.
    pub fn around(file: &Path) -> Self {
        let variable = |name| std::env::var_os(name).unwrap_or_default();
        Self::new(file, variable("ROS_PACKAGE_PATH"), variable("AMENT_PREFIX_PATH"))
    }

    fn new(file: &Path, package_path: OsString, prefix_path: OsString) -> Self {
        let folders = |paths: OsString| -> Vec<PathBuf> {
            std::env::split_paths(&paths).filter(|path| !path.as_os_str().is_empty()).collect()
        };
        let file = file.canonicalize().unwrap_or_else(|_| file.to_path_buf());
        Self {
            above: file.ancestors().skip(1).map(Path::to_path_buf).collect(),
            roots: folders(package_path),
            shares: folders(prefix_path).into_iter().map(|prefix| prefix.join("share")).collect(),
            index: OnceCell::new(),
            asked: RefCell::default(),
        }
    }

    /// The folder of package `name`.
    pub fn find(&self, name: &str) -> Option<PathBuf> {
        let found = self.search(name);
        self.asked.borrow_mut().insert(name.to_owned(), found.clone());
        found
    }

    /// What [`find`](Self::find) was asked for until now.
    pub fn places(&self) -> PackagePlaces {
        PackagePlaces(self.asked.borrow().clone())
    }

    fn search(&self, name: &str) -> Option<PathBuf> {
        // One plain name, so that no path leads out of the folders that are searched.
        let mut parts = Path::new(name).components();
        if !matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None)) {
            return None;
        }
        for folder in &self.above {
            if folder.file_name().is_some_and(|own| own == name) || manifest_name(folder).is_some_and(|own| own == name)
            {
                return Some(folder.clone());
            }
            let inside = folder.join(name);
            if inside.is_dir() {
                return Some(inside);
            }
        }
        let indexed = self.index.get_or_init(|| index(&self.roots)).get(name);
        let in_share = || self.shares.iter().map(|share| share.join(name)).find(|folder| folder.is_dir());
        indexed.cloned().or_else(in_share)
    }
}

/// All packages below `roots`; the first of those that share a name counts.
fn index(roots: &[PathBuf]) -> HashMap<String, PathBuf> {
    let mut packages = HashMap::new();
    let mut left = MAX_FOLDERS;
    for root in roots {
        let mut waiting = vec![(root.clone(), 0)];
        while let Some((folder, depth)) = waiting.pop() {
            if left == 0 {
                return packages;
            }
            left -= 1;
            // A package holds no other packages.
            if folder.join("package.xml").is_file() {
                let own = folder.file_name().map(|name| name.to_string_lossy().into_owned());
                if let Some(name) = manifest_name(&folder).or(own) {
                    packages.entry(name).or_insert(folder);
                }
                continue;
            }
            if depth == MAX_DEPTH || folder.join("CATKIN_IGNORE").exists() {
                continue;
            }
            let mut inside: Vec<_> = fs::read_dir(&folder)
                .into_iter()
                .flatten()
                .flatten()
                .filter(|entry| !entry.file_name().to_string_lossy().starts_with('.'))
                .map(|entry| entry.path())
                .filter(|path| path.is_dir())
                .collect();
            // The order of a folder is that of the file system: not the same everywhere.
            inside.sort_by(|a, b| b.cmp(a));
            waiting.extend(inside.into_iter().map(|path| (path, depth + 1)));
        }
    }
    packages
}

/// The name in the `package.xml` of a folder.
fn manifest_name(folder: &Path) -> Option<String> {
    let manifest = folder.join("package.xml");
    let text = files::read_text(&manifest, MAX_MANIFEST).ok()?;
    let (_, rest) = text.split_once("<name>")?;
    Some(rest.split_once("</name>")?.0.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_are_found_above_beside_and_on_the_path() {
        let base = std::env::temp_dir().join(format!("ambf_packages_{}", std::process::id()));
        let package = |folder: &str, name: &str| {
            fs::create_dir_all(base.join(folder)).expect("a folder");
            let text = format!("<package>\n  <name> {name} </name>\n</package>\n");
            fs::write(base.join(folder).join("package.xml"), text).expect("written");
        };
        package("ws/src/repo/renamed", "arm_description");
        package("ws/src/repo/gripper", "gripper");
        package("other/deep/er/tool", "tool");
        package("other/.hidden", "hidden");
        package("other/deep/er/tool/inner", "inner");
        fs::create_dir_all(base.join("prefix/share/ros2_tool")).expect("a folder");
        fs::create_dir_all(base.join("ws/src/repo/renamed/urdf")).expect("a folder");
        let file = base.join("ws/src/repo/renamed/urdf/arm.urdf");
        fs::write(&file, "").expect("written");

        let join = |folder: &str| Some(base.canonicalize().expect("a folder").join(folder));
        let paths = std::env::join_paths([base.join("no such folder"), base.canonicalize().unwrap().join("other")]);
        let prefix = base.canonicalize().unwrap().join("prefix").into_os_string();
        let packages = Packages::new(&file, paths.unwrap(), prefix);
        assert_eq!(packages.find("arm_description"), join("ws/src/repo/renamed"), "by its package.xml");
        assert_eq!(packages.find("gripper"), join("ws/src/repo/gripper"), "beside it");
        assert_eq!(packages.find("tool"), join("other/deep/er/tool"), "ROS_PACKAGE_PATH");
        assert_eq!(packages.find("ros2_tool"), join("prefix/share/ros2_tool"), "AMENT_PREFIX_PATH");
        for none in ["hidden", "inner", "", ".", "..", "../repo", "/tmp", "nowhere"] {
            assert_eq!(packages.find(none), None, "{none}");
        }
        assert_eq!(Packages::default().find("gripper"), None);
        // The environment of this process names no packages.
        let packages = Packages::around(&file);
        assert!(packages.places().are_current(&file) && packages.find("gripper").is_some());
        let places = packages.places();
        assert!(places.are_current(&file));
        package("ws/src/repo/renamed/gripper", "gripper");
        assert!(!places.are_current(&file), "one that is nearer counts now");
        fs::remove_dir_all(base).expect("removed");
    }
}

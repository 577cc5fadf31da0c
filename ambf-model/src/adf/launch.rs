//! Launch files.

use std::path::PathBuf;

use super::common::{PluginEntry, SourcePos};
use super::reader::Map;
use super::report::ProblemKind;
use super::values::beside;

/// A launch file as written. Relative paths are joined to the file's directory. `None`: the key is missing.
#[derive(Clone, Debug, PartialEq)]
pub struct Launch {
    /// World file.
    pub world_config: Option<PathBuf>,
    /// Input devices file.
    pub input_devices_config: Option<PathBuf>,
    /// Colour table.
    pub color_config: Option<PathBuf>,
    /// Model files in index order.
    pub multibody_configs: Option<Vec<PathBuf>>,
    /// Simulator plugins.
    pub plugins: Vec<PluginEntry>,
    /// Drivers of input devices in shared libraries; the reference has no such key.
    pub device_plugins: Vec<PluginEntry>,
    /// The file.
    pub source: SourcePos,
}

impl Launch {
    /// Keys that the simulator cannot do without and that the file lacks.
    pub fn missing_keys(&self) -> Vec<&'static str> {
        let present = [
            ("world config", self.world_config.is_some()),
            ("input devices config", self.input_devices_config.is_some()),
            ("color config", self.color_config.is_some()),
            ("multibody configs", self.multibody_configs.is_some()),
        ];
        let missing = present.iter().filter(|(_, there)| !there);
        missing.map(|(key, _)| *key).collect()
    }

    pub(super) fn read(root: &Map<'_>) -> Self {
        let dir = root.reader().dir();
        let models = root.strings("multibody configs");
        let launch = Self {
            world_config: root.path_beside("world config"),
            input_devices_config: root.path_beside("input devices config"),
            color_config: root.path_beside("color config"),
            multibody_configs: (root.has("multibody configs"))
                .then(|| models.iter().map(|(path, _)| beside(dir, path)).collect()),
            plugins: root.plugins("plugins"),
            device_plugins: root.plugins("device plugins"),
            source: root.reader().source(root.mark),
        };
        for key in launch.missing_keys() {
            let action = "the simulator does not start without it";
            root.warn(ProblemKind::MissingKey, key, "a path", action);
        }
        root.finish_root();
        launch
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::*;

    #[test]
    fn paths_and_missing_keys() {
        let text = "world config: w.yaml\ninput devices config: /d.yaml\ncolor config: ./c.yaml\n\
                    multibody configs: [a.yaml, 'b c.yaml']\nplugins: [{name: p, filename: libp.so, path: x}]\n\
                    device plugins: [{name: d, filename: libd.so}]\n";
        let launch: Launch = clean(text);
        assert_eq!(launch.world_config, Some("dir/w.yaml".into()));
        assert_eq!(launch.input_devices_config, Some("/d.yaml".into()));
        let models = launch.multibody_configs.as_deref().expect("models");
        assert_eq!(models, ["dir/a.yaml", "dir/b c.yaml"].map(PathBuf::from));
        assert_eq!(launch.plugins[0].path, Some("dir/x".into()));
        assert_eq!((launch.device_plugins.len(), launch.device_plugins[0].name.as_str()), (1, "d"));
        let (launch, problems) = read::<Launch>("multibody configs:\nplugins: [{name: p}]\n");
        assert_eq!(launch.multibody_configs, Some(vec![]));
        assert_eq!(launch.missing_keys().len(), 3);
        assert!(launch.plugins.is_empty());
        assert_eq!(problems.len(), 4, "{problems:#?}");
    }
}

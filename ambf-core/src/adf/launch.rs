//! Launch files.

use std::path::PathBuf;

use super::common::{PluginEntry, SourcePos};

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
    /// The file.
    pub source: SourcePos,
}

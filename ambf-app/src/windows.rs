//! Windows of the simulator, where the program is built with them (feature `view`) and there is a display.

use std::sync::Arc;

use ambf_core::comm::Hub;
use ambf_core::device::host::{DeviceHost, News};
use ambf_core::sim::{Control, Models, WindowLink};

#[cfg(feature = "pictures")]
use crate::cameras::{CameraService, OffscreenCameras};
use crate::recordings::RecordingDesk;
use crate::report;
use crate::simulator::SimulatorError;

/// Whether windows are opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(not(feature = "view"), allow(dead_code))]
pub(crate) enum WindowsWanted {
    /// None.
    No,
    /// If that is possible.
    IfPossible,
    /// Yes: the program ends if that is not possible.
    Yes,
}

/// What windows work with.
#[cfg_attr(not(feature = "view"), allow(dead_code))]
pub(crate) struct WindowParts {
    pub hub: Arc<Hub>,
    pub link: WindowLink,
    pub control: Arc<Control>,
    pub models: Models,
    /// Problems of the files, one line each.
    pub load_report: String,
    pub desk: Arc<RecordingDesk>,
    /// What makes pictures for ROS; `None` without ROS.
    #[cfg(feature = "pictures")]
    pub cameras: Option<CameraService>,
}

/// Lets a thread of its own make pictures for ROS.
#[cfg(feature = "pictures")]
fn offscreen(hub: &Arc<Hub>, cameras: CameraService) -> Option<OffscreenCameras> {
    OffscreenCameras::start(Arc::clone(hub), cameras)
        .inspect_err(|error| {
            report!("cameras: no thread can be made for pictures: {error}; the simulation runs without");
        })
        .ok()
}

#[cfg(feature = "view")]
pub(crate) use with::{are_wanted, Windows};
#[cfg(not(feature = "view"))]
pub(crate) use without::{are_wanted, Windows};

#[cfg(feature = "view")]
mod with {
    use ambf_core::device::host::DeviceEvent;
    use ambf_core::device::law::Mode;
    use ambf_core::device::law::Status;
    use ambf_viewer::{display_is_named, DeviceBoard, Ended, FrameHook, Viewer, ViewerError, ViewerParts};
    use parking_lot::Mutex;

    use super::*;
    use crate::print_line;
    use crate::report::report_failure;

    /// What the option `-g` and the environment say.
    ///
    /// # Errors
    /// [`SimulatorError::Windows`] when windows are asked for and there is no display.
    pub(crate) fn are_wanted(option: Option<bool>) -> Result<WindowsWanted, SimulatorError> {
        match (option, display_is_named()) {
            (Some(false), _) => Ok(WindowsWanted::No),
            (Some(true), true) => Ok(WindowsWanted::Yes),
            (Some(true), false) => Err(SimulatorError::Windows(ViewerError::NoDisplay.to_string())),
            (None, true) => Ok(WindowsWanted::IfPossible),
            (None, false) => {
                report!("there is no display: the simulation runs without windows, as with -g 0");
                Ok(WindowsWanted::No)
            }
        }
    }

    /// Makes pictures for ROS in the thread with the windows, until these are gone.
    type SharedCameras = Arc<Mutex<Option<CameraService>>>;

    /// The windows, if there are any, and what makes pictures for ROS without them.
    pub(crate) struct Windows {
        viewer: Option<Viewer>,
        board: Arc<DeviceBoard>,
        hub: Arc<Hub>,
        shared: SharedCameras,
        offscreen: Option<OffscreenCameras>,
    }

    impl Windows {
        /// # Errors
        /// [`SimulatorError::Windows`] when windows are asked for and cannot be opened.
        pub fn start(wanted: WindowsWanted, parts: WindowParts, devices: &DeviceHost) -> Result<Self, SimulatorError> {
            let WindowParts { hub, link, control, models, load_report, desk, cameras } = parts;
            let has_cameras = cameras.is_some();
            let shared: SharedCameras = Arc::new(Mutex::new(cameras));
            let board = Arc::<DeviceBoard>::default();
            let mut windows = Self { viewer: None, board, hub: Arc::clone(&hub), shared, offscreen: None };
            if wanted == WindowsWanted::No {
                windows.go_offscreen();
                return Ok(windows);
            }
            let cameras = Arc::clone(&windows.shared);
            let hook: Box<FrameHook> = Box::new(move |renderer, stage, visuals, snapshot| {
                let mut cameras = cameras.lock();
                if let Some(cameras) = cameras.as_mut() {
                    cameras.frame(renderer, stage, visuals, snapshot);
                }
            });
            let started = Viewer::start(ViewerParts {
                hub,
                link,
                control,
                models,
                devices: Arc::clone(devices.controls()),
                board: Arc::clone(&windows.board),
                hook: has_cameras.then_some(hook),
                load_report,
                record: Some(Arc::new(move || desk.switch())),
                say: Box::new(|said| match said.is_failure {
                    true => report_failure(format_args!("{}", said.text)),
                    false => print_line!("{}", said.text),
                }),
            });
            match (started, wanted) {
                (Ok(viewer), _) => windows.viewer = Some(viewer),
                (Err(error), WindowsWanted::Yes) => return Err(SimulatorError::Windows(error.to_string())),
                (Err(error), _) => {
                    report!("{error}; the simulation goes on without");
                    windows.go_offscreen();
                }
            }
            Ok(windows)
        }

        /// Lets a thread of its own make pictures for ROS.
        fn go_offscreen(&mut self) {
            // A thread with windows that is lost in a driver keeps what it holds.
            let cameras = match self.shared.try_lock() {
                Some(mut cameras) => cameras.take(),
                None => {
                    report!(
                        "cameras: the thread with the windows hangs while it makes pictures: there are no more of them"
                    );
                    None
                }
            };
            if let Some(cameras) = cameras {
                self.offscreen = offscreen(&self.hub, cameras);
            }
        }

        /// Whether a user has closed a window. Windows that are lost are said to be, once.
        pub fn were_closed(&mut self) -> bool {
            match self.viewer.as_ref().and_then(Viewer::ended) {
                None => false,
                Some(Ended::Closed) => true,
                Some(Ended::Lost(why)) => {
                    report!("the windows are gone: {why}; the simulation goes on without");
                    self.viewer = None;
                    self.go_offscreen();
                    false
                }
            }
        }

        /// Brings what is shown of devices up to date.
        pub fn show_devices(&self, devices: &DeviceHost, news: &[News]) {
            if self.viewer.is_none() || devices.is_empty() {
                return;
            }
            let status = devices.status();
            self.board.update(|board| {
                board.devices = status;
                for news in news {
                    board.lines.push(devices.line(news));
                    match news.event {
                        DeviceEvent::Gain(quantity, value) => board.action = Status::Gain(quantity, value).to_string(),
                        DeviceEvent::Mode(_) => board.action.clear(),
                        _ => (),
                    }
                }
            });
        }

        /// Shows a new gain of an end-effector, of which the physics thread tells.
        pub fn show_notice(&self, notice: &str) {
            let Some((_, said)) = notice.split_once(": ") else { return };
            let quantities = Mode::ALL.iter().filter_map(|mode| mode.quantity());
            if quantities.into_iter().any(|quantity| said.starts_with(&format!("{} = ", quantity.label()))) {
                self.board.update(|board| board.action = said.to_owned());
            }
        }
    }
}

#[cfg(not(feature = "view"))]
mod without {
    use super::*;

    /// There are none in this build.
    ///
    /// # Errors
    /// [`SimulatorError::Windows`] when windows are asked for.
    pub(crate) fn are_wanted(option: Option<bool>) -> Result<WindowsWanted, SimulatorError> {
        match option {
            Some(true) => {
                let why =
                    "this program was built without windows: with DISPLAY or WAYLAND_DISPLAY set, scripts/simulate builds them \
                     (cargo: the feature `view`); or run it with -g 0";
                Err(SimulatorError::Windows(why.into()))
            }
            Some(false) => Ok(WindowsWanted::No),
            None => {
                report!("this program was built without windows: it runs as with -g 0");
                Ok(WindowsWanted::No)
            }
        }
    }

    /// No windows, and what makes pictures for ROS.
    pub(crate) struct Windows {
        #[cfg(feature = "pictures")]
        _offscreen: Option<OffscreenCameras>,
    }

    impl Windows {
        /// # Errors
        /// Never.
        #[cfg_attr(not(feature = "pictures"), allow(unused_variables))]
        pub fn start(_: WindowsWanted, parts: WindowParts, _: &DeviceHost) -> Result<Self, SimulatorError> {
            Ok(Self {
                #[cfg(feature = "pictures")]
                _offscreen: parts.cameras.and_then(|cameras| offscreen(&parts.hub, cameras)),
            })
        }

        /// Never.
        pub fn were_closed(&mut self) -> bool {
            false
        }

        /// Nowhere.
        pub fn show_devices(&self, _: &DeviceHost, _: &[News]) {}

        /// Nowhere.
        pub fn show_notice(&self, _: &str) {}
    }
}

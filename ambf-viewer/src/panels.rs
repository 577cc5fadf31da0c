//! Panels: hidden until a key opens them.

use std::sync::Arc;

use ambf_core::comm::Snapshot;
use ambf_core::scene::VisualScene;
use ambf_render::Stage;

use crate::app::Parts;
use crate::keys::Action;
use crate::outbox::Outbox;

/// What panels work with.
pub(crate) struct PanelContext<'a> {
    pub parts: &'a Parts,
    pub outbox: &'a mut Outbox,
    pub stage: &'a mut Stage,
    pub visuals: &'a Arc<VisualScene>,
    pub snapshot: &'a Arc<Snapshot>,
    /// Camera of the window.
    pub camera: usize,
    pub picked: &'a mut Option<(usize, String)>,
    /// Lines to be said.
    pub messages: Vec<String>,
    /// As if keys had been pressed.
    pub actions: Vec<Action>,
}

/// All panels, in the window in which they were opened.
pub(crate) struct Panels {
    load_report: String,
    camera: usize,
    open: [bool; 8],
}

impl Panels {
    pub fn new(load_report: String) -> Self {
        Self { load_report, camera: 0, open: [false; 8] }
    }
    pub fn are_open(&self, camera: usize) -> bool {
        self.camera == camera && self.open.contains(&true)
    }
    pub fn switch_all(&mut self, camera: usize) {
        let open = !self.are_open(camera);
        (self.camera, self.open) = (camera, [open; 8]);
    }
    pub fn switch(&mut self, panel: usize, camera: usize) {
        if self.camera != camera {
            (self.camera, self.open) = (camera, [false; 8]);
        }
        self.open[panel] = !self.open[panel];
    }
    pub fn add_markers(&self, stage: &mut Stage, visuals: &VisualScene, snapshot: &Snapshot) {
        let _ = (stage, visuals, snapshot);
    }
    pub fn show(&mut self, ui: &egui::Context, with: &mut PanelContext<'_>) {
        let _ = (ui, with, &self.load_report);
    }
}

//! Panels: hidden until a key opens them.

mod plot;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use ambf_core::comm::{BodyKinematics, HubIndex, JointCommandType, ObjectKind, RigidBodyCommand, Snapshot};
use ambf_core::device::host::DeviceState;
use ambf_core::device::DeviceForce;
use ambf_core::ids::{BodyId, CameraId, JointId, ModelId};
use ambf_core::scene::{CameraGesture, JointType, VisualJoint, VisualScene};
use ambf_core::sim::WindowRequest;
use ambf_render::{Marker, MarkerShape, Stage};
use egui::{Context, Slider, Ui};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::app::Parts;
use crate::keys::Action;
use crate::outbox::Outbox;
use plot::Plots;

/// Titles of the panels, in the order of their keys.
const TITLES: [&str; 8] = ["Run", "Objects", "Joints", "Show", "Cameras", "Plots", "Devices", "Files"];
/// Width of all panels at first, points.
const WIDTH: f32 = 290.0;
/// Speeds that the slider reaches, simulated per real time.
const SPEEDS: std::ops::RangeInclusive<f64> = 0.01..=10.0;
/// Objects that are listed at once; a search shows the others.
const LISTED: usize = 300;
/// Colours of what is shown in addition.
const AXIS: [f32; 4] = [0.1, 0.3, 0.9, 1.0];
const CENTRE: [f32; 4] = [1.0, 0.6, 0.0, 1.0];
const INERTIA: [f32; 4] = [0.8, 0.2, 0.8, 0.35];
const CONTACT: [f32; 4] = [0.9, 0.1, 0.1, 1.0];
const FORCE: [f32; 4] = [0.0, 0.6, 0.2, 1.0];
/// Length of arrows, m, that stand for 1 N.
const FORCE_SCALE: f64 = 0.01;

/// What panels work with.
pub(crate) struct PanelContext<'a> {
    pub parts: &'a Parts,
    pub stage: &'a mut Stage,
    pub visuals: &'a Arc<VisualScene>,
    pub snapshot: &'a Arc<Snapshot>,
    /// Camera of the window.
    pub camera: CameraId,
    /// Index and qualified identifier of the body that was picked or chosen last.
    pub picked: &'a mut Option<(BodyId, String)>,
    /// Lines to be said.
    pub messages: Vec<String>,
    /// As if keys had been pressed.
    pub actions: Vec<Action>,
    /// Models to be loaded and removed, in threads of their own.
    pub load: Vec<std::path::PathBuf>,
    pub remove: Vec<Arc<str>>,
    /// For the simulation.
    pub requests: Vec<WindowRequest>,
    /// First and last time that can be looked back at, simulated s.
    pub span: Option<(f64, f64)>,
}

/// What is shown in addition to the scene.
#[derive(Debug, Default)]
struct Shown {
    centres: bool,
    inertias: bool,
    joint_axes: bool,
    contacts: bool,
    forces: bool,
}

/// Joints of a body that are commanded by sliders: goals by active joint.
type Goals = HashMap<HubIndex, Vec<f64>>;

/// A camera that follows a body.
struct Follow {
    camera: CameraId,
    body: BodyId,
    last: Vector3<f64>,
}

/// All panels, in the window in which they were opened.
pub(crate) struct Panels {
    load_report: String,
    camera: CameraId,
    open: [bool; TITLES.len()],
    /// It unfolds in the next frame.
    just_opened: Option<usize>,
    search: String,
    shown: Shown,
    /// By position in the hub's list of objects.
    goals: Goals,
    follow: Option<Follow>,
    plots: Plots,
    files_seen: Option<(Instant, Vec<Option<std::time::SystemTime>>)>,
    changed: Vec<ModelId>,
}

impl Panels {
    pub fn new(load_report: String) -> Self {
        Self {
            load_report,
            camera: CameraId::new(0),
            open: [false; TITLES.len()],
            just_opened: None,
            search: String::new(),
            shown: Shown::default(),
            goals: Goals::new(),
            follow: None,
            plots: Plots::default(),
            files_seen: None,
            changed: Vec::new(),
        }
    }

    /// Whether there are panels in the window of a camera.
    pub fn are_open(&self, camera: CameraId) -> bool {
        self.camera == camera && self.open.contains(&true)
    }

    /// Opens all panels, or closes them.
    pub fn switch_all(&mut self, camera: CameraId) {
        let open = !self.are_open(camera);
        (self.camera, self.open) = (camera, [open; TITLES.len()]);
    }

    /// Opens or closes a panel, in the window of a camera.
    pub fn switch(&mut self, panel: usize, camera: CameraId) {
        if self.camera != camera {
            (self.camera, self.open) = (camera, [false; TITLES.len()]);
        }
        if let Some(open) = self.open.get_mut(panel) {
            *open = !*open;
            self.just_opened = open.then_some(panel);
        }
    }

    /// What goes on whether panels are open or not: commands of sliders, a camera that follows, plots.
    pub fn tick(&mut self, parts: &Parts, outbox: &mut Outbox, snapshot: &Snapshot) {
        let objects = parts.hub.objects();
        self.goals.retain(|&object, _| objects.get(object).is_some_and(|object| !object.is_removed()));
        for (&object, goals) in &self.goals {
            let command = RigidBodyCommand {
                joint_commands: goals.clone(),
                joint_command_types: vec![JointCommandType::Position; goals.len()],
                ..RigidBodyCommand::default()
            };
            // Goals are those of sliders, which are finite.
            let _ = parts.hub.post(object, &command);
        }
        if let Some(follow) = &mut self.follow {
            match (snapshot.bodies.get(follow.body), snapshot.views.get(follow.camera)) {
                (Some(body), Some(view)) => {
                    let now = Vector3::from(body.origin);
                    let moved = view.pose.rotation.inverse() * (now - follow.last);
                    follow.last = now;
                    if moved.norm() > 0.0 && moved.iter().all(|x| x.is_finite()) {
                        let camera = follow.camera;
                        outbox.post(WindowRequest::MoveCamera { camera, gesture: CameraGesture::Shift(moved) });
                    }
                }
                _ => self.follow = None,
            }
        }
        self.plots.record(snapshot);
    }

    /// Puts what is shown in addition among the markers.
    pub fn add_markers(&self, stage: &mut Stage, visuals: &VisualScene, snapshot: &Snapshot) {
        let bodies = || visuals.bodies.iter().zip(&snapshot.bodies).filter(|(body, _)| !body.object.removed);
        if self.shown.centres {
            let points = bodies().map(|(_, state)| state.origin.map(|x| x as f32)).collect();
            stage.markers.push(Marker {
                shape: MarkerShape::Points(points, 8.0),
                pose: Isometry3::identity(),
                color: CENTRE,
            });
        }
        if self.shown.inertias {
            stage.markers.extend(self.inertia_boxes(visuals, snapshot));
        }
        if self.shown.joint_axes {
            for joint in visuals.joints.iter().filter(|joint| !joint.removed) {
                let Some(parent) = snapshot.bodies.get(joint.parent) else { continue };
                let parent = pose_of(parent);
                let from = parent * nalgebra::Point3::from(joint.frames[0].translation.vector);
                stage.markers.extend(arrow(from.coords, parent.rotation * joint.axis * 0.2, AXIS));
            }
        }
        if self.shown.contacts {
            let points = snapshot.contacts.iter().flat_map(|contacts| &contacts.points);
            stage.markers.extend(points.filter_map(|point| arrow(point.point, point.normal * 0.1, CONTACT)));
        }
        if self.shown.forces {
            for (state, wrench) in snapshot.bodies.iter().zip(&snapshot.wrenches) {
                let pose = pose_of(state);
                let force = pose.rotation * wrench.force * FORCE_SCALE;
                stage.markers.extend(arrow(pose.translation.vector, force, FORCE));
            }
        }
    }

    /// Boxes of even density that have the inertia of the bodies.
    fn inertia_boxes(&self, visuals: &VisualScene, snapshot: &Snapshot) -> Vec<Marker> {
        let boxed = |(id, info): (BodyId, &crate::panels::Inertia)| {
            let state = snapshot.bodies.get(id)?;
            let removed = visuals.bodies.get(id)?.object.removed;
            let edges = box_of_inertia(info.mass, &info.inertia)?;
            let shape = MarkerShape::Box(edges.map(|edge| edge as f32));
            (!removed).then(|| Marker { shape, pose: pose_of(state), color: INERTIA })
        };
        self.plots.inertias.iter().map(|(&index, info)| (index, info)).filter_map(boxed).collect()
    }

    /// Draws the panels of the window of a camera.
    pub fn show(&mut self, ui: &Context, with: &mut PanelContext<'_>) {
        if with.camera != self.camera {
            return;
        }
        if self.shown.inertias || self.open[5] {
            self.plots.read_objects(with.parts);
        }
        if !self.open.contains(&true) {
            return;
        }
        egui::SidePanel::left("panels").default_width(WIDTH).show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                for panel in 0..TITLES.len() {
                    if self.open[panel] {
                        self.section(ui, with, panel);
                    }
                }
            });
        });
        self.just_opened = None;
    }

    fn section(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>, panel: usize) {
        let header = egui::CollapsingHeader::new(format!("{} (Alt+{})", TITLES[panel], panel + 1));
        let unfold = (self.just_opened == Some(panel)).then_some(true);
        header.default_open(panel == 0).open(unfold).show(ui, |ui| match panel {
            0 => self.run(ui, with),
            1 => self.objects(ui, with),
            2 => self.joints(ui, with),
            3 => self.shown(ui, with),
            4 => self.cameras(ui, with),
            5 => self.plots.show(ui, with),
            6 => devices(ui, with),
            _ => self.files(ui, with),
        });
    }

    fn run(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        let paused = with.parts.control.is_paused();
        ui.horizontal(|ui| {
            if ui.button(if paused { "Play" } else { "Pause" }).clicked() {
                with.actions.push(Action::Pause);
            }
            ui.add_enabled_ui(paused, |ui| {
                for steps in [1, 10, 100] {
                    if ui.button(format!("{steps} step{}", if steps == 1 { "" } else { "s" })).clicked() {
                        with.actions.push(Action::Step(steps));
                    }
                }
            });
        });
        let mut speed = with.parts.control.speed();
        let slider = Slider::new(&mut speed, SPEEDS).logarithmic(true).text("speed");
        if ui.add(slider).changed() {
            with.parts.control.set_speed(speed);
        }
        ui.horizontal(|ui| {
            if ui.button("Reset bodies").clicked() {
                with.actions.push(Action::ResetBodies);
            }
            if ui.button("Reset world").clicked() {
                with.actions.push(Action::ResetWorld);
            }
            if ui.button("Speed 1").clicked() {
                with.parts.control.set_speed(1.0);
            }
        });
        look_back(ui, with, paused);
        if let Some(lost) = with.parts.hub.lost() {
            ui.colored_label(ui.visuals().error_fg_color, lost.as_str());
        }
        let timing = &with.snapshot.timing;
        let [p50, p90, p99, most] = timing.step_cost.map(|cost| cost * 1e3);
        egui::Grid::new("cost").show(ui, |ui| {
            let mut row = |name: &str, value: String| {
                ui.label(name);
                ui.label(value);
                ui.end_row();
            };
            row("step", with.snapshot.sim_step.to_string());
            row("simulated time", format!("{:.3} s", with.snapshot.sim_time));
            row("physics", format!("{:.0} Hz", timing.physics_frequency));
            row("cost of a step, p50", format!("{p50:.3} ms"));
            row("p90, p99", format!("{p90:.3}, {p99:.3} ms"));
            row("most", format!("{most:.3} ms"));
            row("sub-steps, at most", timing.sub_step_cap.to_string());
            row("lost time", format!("{:.3} s", timing.lost_time));
        });
        ui.horizontal(|ui| {
            if ui.button("Picture (Ctrl+S)").clicked() {
                with.actions.push(Action::Screenshot);
            }
            if ui.button("Video (Ctrl+M)").clicked() {
                with.actions.push(Action::Video);
            }
        });
    }

    fn objects(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        ui.horizontal(|ui| {
            ui.label("search");
            ui.text_edit_singleline(&mut self.search);
        });
        self.chosen(ui, with);
        ui.separator();
        let search = self.search.to_lowercase();
        let matches = |name: &str| search.is_empty() || name.to_lowercase().contains(&search);
        let mut left = LISTED;
        for (index, model) in with.visuals.models.entries().filter(|(_, model)| !model.removed) {
            let bodies = with.visuals.bodies.entries();
            let own = bodies.filter(|(_, body)| body.object.model == index && !body.object.removed);
            let found: Vec<_> = own.filter(|(_, body)| matches(&body.object.identifier)).collect();
            if found.is_empty() {
                continue;
            }
            let header = egui::CollapsingHeader::new(format!("{} ({})", model.key, found.len()));
            let open = (!search.is_empty()).then_some(true);
            header.id_salt(index).open(open).show(ui, |ui| {
                for (body, visual) in found.iter().take(left) {
                    let is_chosen = with.picked.as_ref().is_some_and(|(picked, _)| picked == body);
                    if ui.selectable_label(is_chosen, &*visual.object.name).clicked() {
                        *with.picked = Some((*body, visual.object.identifier.to_string()));
                    }
                }
                if found.len() > left {
                    ui.label("more: search for them");
                }
                left = left.saturating_sub(found.len());
            });
        }
    }

    /// State of the chosen body.
    fn chosen(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        let Some((body, identifier)) = with.picked.clone() else {
            ui.label("no body is chosen");
            return;
        };
        let Some(state) = with.snapshot.bodies.get(body) else { return };
        ui.strong(&identifier);
        let row = |ui: &mut Ui, name: &str, v: &[f64; 3]| {
            ui.monospace(format!("{name:8} {:9.4} {:9.4} {:9.4}", v[0], v[1], v[2]));
        };
        row(ui, "centre", &state.origin);
        let (roll, pitch, yaw) = pose_of(state).rotation.euler_angles();
        row(ui, "rpy", &[roll, pitch, yaw]);
        row(ui, "velocity", &state.linear_velocity);
        row(ui, "rotation", &state.angular_velocity);
        ui.horizontal(|ui| {
            if ui.button("Frame").clicked() {
                with.actions.push(Action::FrameOfPicked);
            }
            if ui.button("Follow").clicked() {
                self.follow = Some(Follow { camera: with.camera, body, last: state.origin.into() });
            }
            if ui.button("Remove").clicked() {
                with.actions.push(Action::RemovePicked);
            }
        });
    }

    fn joints(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        let objects = with.parts.hub.objects();
        let mut any = false;
        for (object, info) in objects.entries().filter(|(_, object)| !object.is_removed()) {
            let ObjectKind::RigidBody(body, details) = &info.info.kind else { continue };
            let drives = |&joint: &JointId| with.visuals.joints.get(joint).is_some_and(has_coordinate);
            // Of a chain only the first body is listed: its joints are those of all below it.
            let is_below = with.visuals.joints.iter().any(|joint| !joint.removed && joint.child == *body);
            if is_below || !details.joints.iter().any(drives) {
                continue;
            }
            any = true;
            egui::CollapsingHeader::new(&info.info.name).id_salt(object).default_open(details.joints.len() < 12).show(
                ui,
                |ui| {
                    let position =
                        |joint: JointId| with.snapshot.joint_positions.get(joint).copied().unwrap_or_default();
                    let mut commands = self.goals.contains_key(&object);
                    if ui.checkbox(&mut commands, "command").changed() {
                        match commands {
                            true => {
                                self.goals.insert(object, details.joints.iter().map(|&joint| position(joint)).collect())
                            }
                            false => self.goals.remove(&object),
                        };
                    }
                    for (i, &joint) in details.joints.iter().enumerate() {
                        let Some(visual) = with.visuals.joints.get(joint).filter(|joint| has_coordinate(joint)) else {
                            continue;
                        };
                        let (low, high) = range(visual);
                        let goal = self.goals.get_mut(&object).and_then(|goals| goals.get_mut(i));
                        let mut value = goal.as_ref().map_or(position(joint), |goal| **goal);
                        let text = format!("{}  ({:.3})", visual.name, position(joint));
                        let slider = Slider::new(&mut value, low..=high).text(text).fixed_decimals(3);
                        let changed = ui.add_enabled(goal.is_some(), slider).changed();
                        if let (true, true, Some(goal)) = (changed, value.is_finite(), goal) {
                            *goal = value;
                        }
                    }
                },
            );
        }
        if !any {
            ui.label("no joint of the scene can be moved");
        }
    }

    fn shown(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        let switch = |ui: &mut Ui, is_on: bool, text: &str, action: Action, actions: &mut Vec<Action>| {
            let mut on = is_on;
            if ui.checkbox(&mut on, text).changed() {
                actions.push(action);
            }
        };
        let (frames, normals) = (with.stage.frames, !with.stage.normal_maps_off);
        let sensors = with.stage.sensors.unwrap_or_else(|| with.visuals.sensors.iter().any(|sensor| sensor.visible));
        let actuators =
            with.stage.actuators.unwrap_or_else(|| with.visuals.actuators.iter().any(|actuator| actuator.visible));
        switch(ui, frames, "frames (v)", Action::Frames, &mut with.actions);
        switch(ui, sensors, "sensors and their rays (s)", Action::Sensors, &mut with.actions);
        switch(ui, actuators, "actuators (a)", Action::Actuators, &mut with.actions);
        switch(ui, normals, "normal maps (Shift+N)", Action::NormalMaps, &mut with.actions);
        ui.checkbox(&mut with.stage.collision_shapes, "collision shapes");
        ui.checkbox(&mut self.shown.centres, "centres of mass");
        ui.checkbox(&mut self.shown.inertias, "boxes of the same inertia");
        ui.checkbox(&mut self.shown.joint_axes, "joint axes");
        ui.checkbox(&mut self.shown.contacts, "contacts of contact sensors");
        ui.checkbox(&mut self.shown.forces, "forces of joints with feedback (0.01 m for 1 N)");
    }

    fn cameras(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        for (index, camera) in with.visuals.cameras.entries().filter(|(_, camera)| !camera.object.removed) {
            let (Some(view), name) = (with.snapshot.views.get(index), &camera.object.name) else { continue };
            let place = view.pose.translation.vector;
            let hidden = if camera.description.visible { "" } else { ", hidden" };
            let here = if index == with.camera { " (this window)" } else { "" };
            ui.label(format!("{name}{here}{hidden}: {:.3} {:.3} {:.3}", place.x, place.y, place.z));
        }
        ui.horizontal(|ui| {
            if ui.button("Fit the scene (Ctrl+F)").clicked() {
                with.actions.push(Action::FitCamera);
            }
            if ui.button("Reset all (Ctrl+V)").clicked() {
                with.actions.push(Action::ResetCameras);
            }
        });
        match &self.follow {
            Some(follow) => {
                let name =
                    with.visuals.bodies.get(follow.body).map(|body| body.object.name.to_string()).unwrap_or_default();
                if ui.button(format!("Stop following {name}")).clicked() {
                    self.follow = None;
                }
            }
            None => {
                ui.label("Choose a body in the panel Objects to follow it.");
            }
        }
    }

    fn files(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        self.look_for_changes(with.visuals);
        for (index, model) in with.visuals.models.entries().filter(|(_, model)| !model.removed) {
            let file = &model.description.file;
            ui.horizontal(|ui| {
                if self.changed.contains(&index) {
                    ui.colored_label(ui.visuals().warn_fg_color, "changed");
                }
                ui.label(&*model.key).on_hover_text(file.display().to_string());
                // The environment belongs to the world and stays.
                if index != ModelId::ENVIRONMENT && ui.button("Reload").clicked() {
                    with.remove.push(Arc::clone(&model.key));
                    with.load.push(file.to_path_buf());
                }
                if index != ModelId::ENVIRONMENT && ui.button("Remove").clicked() {
                    with.remove.push(Arc::clone(&model.key));
                }
            });
        }
        ui.label("Drop a file on the window to load it as a model.");
        ui.separator();
        match self.load_report.is_empty() {
            true => ui.label("The files that were loaded have no problems."),
            false => ui.label(&self.load_report),
        };
    }

    /// Finds out, once a second, which files of models have changed since they were loaded.
    fn look_for_changes(&mut self, visuals: &VisualScene) {
        let times = || {
            let modified = |model: &ambf_core::scene::VisualModel| {
                std::fs::metadata(&*model.description.file).and_then(|data| data.modified()).ok()
            };
            visuals.models.iter().map(modified).collect::<Vec<_>>()
        };
        match &mut self.files_seen {
            Some((seen, known)) if seen.elapsed().as_secs() >= 1 => {
                *seen = Instant::now();
                let now = times();
                let differs = |index: &usize| known.get(*index).is_some_and(|before| *before != now[*index]);
                self.changed = (0..now.len()).filter(differs).map(ModelId::new).collect();
                // Models that came since.
                let new = known.len();
                known.extend(now.into_iter().skip(new));
            }
            Some(_) => (),
            None => self.files_seen = Some((Instant::now(), times())),
        }
    }
}

/// Mass, kg, and principal moments of inertia, kg·m², of a body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Inertia {
    mass: f64,
    inertia: Vector3<f64>,
}

/// Keeping the last minute, and a slider through it while nothing moves.
fn look_back(ui: &mut Ui, with: &mut PanelContext<'_>, paused: bool) {
    let mut keeps = with.span.is_some();
    if ui.checkbox(&mut keeps, "keep the last minute").changed() {
        with.requests.push(WindowRequest::KeepHistory(keeps));
    }
    let Some((first, last)) = with.span else { return };
    if !paused {
        ui.label(format!("{first:.1} s to {last:.1} s: pause to look back"));
        return;
    }
    let mut time = with.snapshot.sim_time;
    let all = first..=last.max(time);
    let slider = Slider::new(&mut time, all).fixed_decimals(1).suffix(" s").text("time");
    if ui.add(slider).changed() {
        with.requests.push(WindowRequest::GoToTime(time));
    }
    if ui.button("Go on from here").clicked() {
        with.actions.push(Action::Pause);
    }
}

fn devices(ui: &mut Ui, with: &mut PanelContext<'_>) {
    let news = with.parts.board.read();
    let switches = with.parts.devices.switches();
    ui.horizontal(|ui| {
        ui.label(format!("mode: {}", switches.mode.name()));
        if ui.button("Next (n)").clicked() {
            with.actions.push(Action::NextMode);
        }
    });
    let mut forces = switches.forces;
    if ui.checkbox(&mut forces, "forces").changed() {
        with.parts.devices.set_forces(forces);
    }
    let mut assist = switches.gripping_assist;
    if ui.checkbox(&mut assist, "gripping assist (t)").changed() {
        with.actions.push(Action::GrippingAssist);
    }
    if news.devices.is_empty() {
        ui.label("No input device is loaded (options -n, -i).");
    }
    for device in &news.devices {
        let state = match device.state {
            DeviceState::Opening => "is being opened",
            DeviceState::Running => "runs",
            DeviceState::Stalled => "its driver does not return",
            DeviceState::Lost => "is away",
            DeviceState::Closed => "is closed",
        };
        ui.strong(format!("{} [{}] {state}", device.name, device.model));
        let [p50, p99, _, most] = device.loops.periods.map(|period| period * 1e3);
        ui.label(format!(
            "{:.0} Hz; period p50 {p50:.2}, p99 {p99:.2}, most {most:.1} ms; samples {:.0} Hz",
            device.loops.latest, device.samples.latest
        ));
        let DeviceForce { force, torque, gripper } = &device.force;
        let vector = |v: &Vector3<f64>| format!("{:6.2} {:6.2} {:6.2}", v.x, v.y, v.z);
        ui.monospace(format!("force  {} N, gripper {gripper:.2} N", vector(force)));
        ui.monospace(format!("torque {} N m", vector(torque)));
    }
    for line in news.lines.iter().rev().take(20) {
        ui.label(line);
    }
}

fn has_coordinate(joint: &VisualJoint) -> bool {
    use JointType::{LinearSpring, Prismatic, Revolute, TorsionSpring};
    !joint.removed && matches!(joint.kind, Revolute | Prismatic | LinearSpring | TorsionSpring)
}

/// What the slider of a joint reaches: its limits, else a turn, or a metre each way.
fn range(joint: &VisualJoint) -> (f64, f64) {
    let free = match joint.kind {
        JointType::Revolute | JointType::TorsionSpring => std::f64::consts::PI,
        _ => 1.0,
    };
    let (low, high) = joint.limits.unwrap_or((-free, free));
    match low.is_finite() && high.is_finite() && low < high {
        true => (low, high),
        false => (-free, free),
    }
}

fn pose_of(state: &BodyKinematics) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&state.basis));
    Isometry3::from_parts(Vector3::from(state.origin).into(), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// An arrow from a point; `None` for one without length.
fn arrow(from: Vector3<f64>, along: Vector3<f64>, color: [f32; 4]) -> Option<Marker> {
    let length = along.norm();
    if !(length > 1e-6 && length.is_finite()) {
        return None;
    }
    let turn = UnitQuaternion::rotation_between(&Vector3::x(), &along)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
    let shape = MarkerShape::Arrow(length as f32, 0.03 * length.min(1.0) as f32);
    Some(Marker { shape, pose: Isometry3::from_parts(from.into(), turn), color })
}

/// Edges of the box of even density with this mass and these principal moments, m; `None` where there is none.
fn box_of_inertia(mass: f64, inertia: &Vector3<f64>) -> Option<[f64; 3]> {
    let square = |a: usize, b: usize, c: usize| 6.0 * (inertia[b] + inertia[c] - inertia[a]) / mass;
    let edges = [square(0, 1, 2), square(1, 2, 0), square(2, 0, 1)].map(|square| square.max(0.0).sqrt());
    (mass > 0.0 && edges.iter().all(|edge| edge.is_finite()) && edges.iter().any(|edge| *edge > 0.0)).then_some(edges)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_have_the_inertia_they_stand_for() {
        let [a, b, c] = [0.2, 0.5, 1.0];
        let moment = |x: f64, y: f64| 3.0 / 12.0 * (x * x + y * y);
        let edges = box_of_inertia(3.0, &Vector3::new(moment(b, c), moment(a, c), moment(a, b))).unwrap();
        for (found, expected) in edges.iter().zip([a, b, c]) {
            assert!((found - expected).abs() < 1e-9, "{edges:?}");
        }
        assert!(box_of_inertia(0.0, &Vector3::zeros()).is_none());
        assert!(box_of_inertia(1.0, &Vector3::zeros()).is_none());
        assert!(box_of_inertia(1.0, &Vector3::repeat(f64::NAN)).is_none());
    }

    #[test]
    fn arrows_point_along_their_vector() {
        for along in [Vector3::x(), -Vector3::x(), Vector3::new(0.1, -2.0, 0.3)] {
            let arrow = arrow(Vector3::zeros(), along, AXIS).unwrap();
            assert!((arrow.pose.rotation * Vector3::x() - along.normalize()).norm() < 1e-12);
        }
        assert!(arrow(Vector3::zeros(), Vector3::zeros(), AXIS).is_none());
        assert!(arrow(Vector3::zeros(), Vector3::repeat(f64::NAN), AXIS).is_none());
    }

    #[test]
    fn sliders_have_an_end_on_each_side() {
        let joint = |kind, limits| VisualJoint {
            name: "j".into(),
            parent: BodyId::new(0),
            child: BodyId::new(1),
            model: ModelId::new(1),
            limits,
            kind,
            axis: Vector3::z(),
            frames: [Isometry3::identity(); 2],
            removed: false,
        };
        assert_eq!(range(&joint(JointType::Revolute, Some((-0.5, 2.0)))), (-0.5, 2.0));
        assert_eq!(range(&joint(JointType::Prismatic, None)), (-1.0, 1.0));
        assert_eq!(range(&joint(JointType::Revolute, Some((1.0, -1.0)))).0, -std::f64::consts::PI);
        assert!(!has_coordinate(&joint(JointType::Fixed, None)));
    }
}

//! Plots of states over simulated time.

use std::collections::{HashMap, VecDeque};

use ambf_core::comm::{ObjectKind, Snapshot};
use ambf_core::ids::{BodyId, JointId};
use egui::{Color32, Pos2, Rect, Sense, Stroke, Ui, Vec2};
use nalgebra::Vector3;

use super::{has_coordinate, Inertia, PanelContext};
use crate::app::Parts;

/// Simulated time that is shown, s.
const SPAN: f64 = 20.0;
/// Values of a curve that are kept.
const VALUES: usize = 3000;
/// Colours of curves, in turn.
const COLORS: [Color32; 6] = [
    Color32::from_rgb(31, 119, 180),
    Color32::from_rgb(214, 39, 40),
    Color32::from_rgb(44, 160, 44),
    Color32::from_rgb(148, 103, 189),
    Color32::from_rgb(255, 127, 14),
    Color32::from_rgb(23, 190, 207),
];

/// What can be plotted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    Joint(JointId),
    JointVelocity(JointId),
    JointEffort(JointId),
    /// Body and axis.
    Position(BodyId, usize),
    Velocity(BodyId, usize),
    AngularVelocity(BodyId, usize),
}

impl Quantity {
    fn read(self, snapshot: &Snapshot) -> Option<f64> {
        let body = |body: BodyId| snapshot.bodies.get(body);
        match self {
            Self::Joint(joint) => snapshot.joint_positions.get(joint).copied(),
            Self::JointVelocity(joint) => snapshot.joint_velocities.get(joint).copied(),
            Self::JointEffort(joint) => snapshot.joint_efforts.get(joint).copied(),
            Self::Position(index, axis) => body(index).map(|body| body.origin[axis]),
            Self::Velocity(index, axis) => body(index).map(|body| body.linear_velocity[axis]),
            Self::AngularVelocity(index, axis) => body(index).map(|body| body.angular_velocity[axis]),
        }
    }
}

struct Curve {
    name: String,
    quantity: Quantity,
    /// Simulated time, s, and value.
    values: VecDeque<(f64, f64)>,
}

/// Curves, and what is known of bodies.
#[derive(Default)]
pub(super) struct Plots {
    curves: Vec<Curve>,
    search: String,
    /// By index of the body.
    pub inertias: HashMap<BodyId, Inertia>,
    generation: Option<u64>,
}

impl Plots {
    /// Takes the values of a snapshot, each once.
    pub fn record(&mut self, snapshot: &Snapshot) {
        for curve in &mut self.curves {
            let Some(value) = curve.quantity.read(snapshot).filter(|value| value.is_finite()) else { continue };
            let time = snapshot.sim_time;
            match curve.values.back() {
                Some((last, _)) if *last == time => continue,
                // Time went back: a state was restored.
                Some((last, _)) if *last > time => curve.values.clear(),
                _ => (),
            }
            curve.values.push_back((time, value));
            while curve.values.len() > VALUES || curve.values.front().is_some_and(|(first, _)| *first < time - SPAN) {
                curve.values.pop_front();
            }
        }
    }

    /// Reads what does not change of bodies, when the list of objects has changed.
    pub fn read_objects(&mut self, parts: &Parts) {
        let generation = parts.hub.generation();
        if self.generation == Some(generation) {
            return;
        }
        self.generation = Some(generation);
        let objects = parts.hub.objects();
        let bodies = objects.iter().filter_map(|object| match &object.info.kind {
            ObjectKind::RigidBody(index, info) => Some((*index, Inertia { mass: info.mass, inertia: info.inertia })),
            _ => None,
        });
        self.inertias = bodies.collect();
    }

    pub fn show(&mut self, ui: &mut Ui, with: &mut PanelContext<'_>) {
        self.draw(ui, with.snapshot.sim_time);
        let mut gone = None;
        for (i, curve) in self.curves.iter().enumerate() {
            ui.horizontal(|ui| {
                let value = curve.values.back().map(|(_, value)| format!("{value:.4}")).unwrap_or_default();
                ui.colored_label(COLORS[i % COLORS.len()], format!("{}: {value}", curve.name));
                if ui.small_button("x").clicked() {
                    gone = Some(i);
                }
            });
        }
        if let Some(gone) = gone {
            self.curves.remove(gone);
        }
        ui.separator();
        ui.horizontal(|ui| {
            ui.label("search");
            ui.text_edit_singleline(&mut self.search);
        });
        let search = self.search.to_lowercase();
        let matches = |name: &str| name.to_lowercase().contains(&search);
        let mut add = None;
        let joints = with.visuals.joints.entries();
        for (index, joint) in joints.filter(|(_, joint)| has_coordinate(joint) && matches(&joint.name)).take(100) {
            ui.horizontal(|ui| {
                ui.label(&*joint.name);
                let kinds = [
                    ("position", Quantity::Joint(index)),
                    ("velocity", Quantity::JointVelocity(index)),
                    ("effort", Quantity::JointEffort(index)),
                ];
                for (kind, quantity) in kinds {
                    if ui.small_button(kind).clicked() {
                        add = Some((format!("{} {kind}", joint.name), quantity));
                    }
                }
            });
        }
        let bodies = with.visuals.bodies.entries();
        for (index, body) in bodies.filter(|(_, body)| !body.object.removed && matches(&body.object.name)).take(100) {
            ui.horizontal(|ui| {
                ui.label(&*body.object.name);
                for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                    let kinds = [
                        (name.to_owned(), Quantity::Position(index, axis)),
                        (format!("v{name}"), Quantity::Velocity(index, axis)),
                        (format!("w{name}"), Quantity::AngularVelocity(index, axis)),
                    ];
                    for (kind, quantity) in kinds {
                        if ui.small_button(&kind).clicked() {
                            add = Some((format!("{} {kind}", body.object.name), quantity));
                        }
                    }
                }
            });
        }
        if let Some((name, quantity)) =
            add.filter(|(_, quantity)| self.curves.iter().all(|curve| curve.quantity != *quantity))
        {
            self.curves.push(Curve { name, quantity, values: VecDeque::new() });
        }
    }

    fn draw(&self, ui: &mut Ui, now: f64) {
        let (place, _) = ui.allocate_exact_size(Vec2::new(ui.available_width().max(200.0), 140.0), Sense::hover());
        let painter = ui.painter_at(place);
        painter.rect_filled(place, 0.0, ui.visuals().extreme_bg_color);
        let values = || self.curves.iter().flat_map(|curve| curve.values.iter().map(|(_, value)| *value));
        let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        if low > high {
            return;
        }
        let (low, high) = widened(low, high);
        let at = |time: f64, value: f64| on_paper(&place, (now - SPAN, now), (low, high), time, value);
        for (i, curve) in self.curves.iter().enumerate() {
            let points = curve.values.iter().map(|(time, value)| at(*time, *value)).collect();
            painter.line(points, Stroke::new(1.5, COLORS[i % COLORS.len()]));
        }
        let text = |value: f64, anchor: egui::Align2, at: Pos2| {
            let font = egui::FontId::proportional(10.0);
            painter.text(at, anchor, format!("{value:.4}"), font, ui.visuals().text_color());
        };
        text(high, egui::Align2::LEFT_TOP, place.left_top());
        text(low, egui::Align2::LEFT_BOTTOM, place.left_bottom());
    }
}

/// A range with an extent.
fn widened(low: f64, high: f64) -> (f64, f64) {
    let least = 1e-6_f64.max(1e-6 * high.abs());
    let missing = (least - (high - low)).max(0.0);
    (low - 0.5 * missing, high + 0.5 * missing)
}

/// Where a value stands in a plot.
fn on_paper(place: &Rect, (begin, end): (f64, f64), (low, high): (f64, f64), time: f64, value: f64) -> Pos2 {
    let x = ((time - begin) / (end - begin)) as f32;
    let y = ((value - low) / (high - low)) as f32;
    Pos2::new(place.left() + x * place.width(), place.bottom() - y * place.height())
}

/// A vector of zeros where nothing is known.
impl Default for Inertia {
    fn default() -> Self {
        Self { mass: 0.0, inertia: Vector3::zeros() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot(time: f64, value: f64) -> Snapshot {
        Snapshot { sim_time: time, joint_positions: vec![value].into(), ..Snapshot::default() }
    }

    #[test]
    fn values_are_kept_once_and_for_the_time_that_is_shown() {
        let curve = |quantity| Curve { name: "q".into(), quantity, values: VecDeque::new() };
        let curves = vec![curve(Quantity::Joint(JointId::new(0))), curve(Quantity::Position(BodyId::new(9), 2))];
        let mut plots = Plots { curves, ..Plots::default() };
        for step in 0..5000 {
            let time = 0.01 * f64::from(step);
            plots.record(&snapshot(time, time));
            plots.record(&snapshot(time, 99.0));
        }
        let values = &plots.curves[0].values;
        assert!((values.back().unwrap().0 - 49.99).abs() < 1e-9);
        assert!(values.front().unwrap().0 >= 49.99 - SPAN - 1e-9);
        assert!(values.iter().all(|(time, value)| time == value));
        assert!(plots.curves[1].values.is_empty(), "there is no such body");
        plots.record(&snapshot(1.0, f64::NAN));
        assert!(plots.curves[0].values.len() > 1000);
        plots.record(&snapshot(1.0, 5.0));
        assert_eq!(plots.curves[0].values, [(1.0, 5.0)], "time went back");
    }

    #[test]
    fn extremes_are_at_the_edges() {
        let place = Rect::from_min_size(Pos2::new(10.0, 20.0), Vec2::new(100.0, 50.0));
        let range = widened(-1.0, 3.0);
        assert_eq!(range, (-1.0, 3.0));
        assert_eq!(on_paper(&place, (0.0, 20.0), range, 20.0, 3.0), Pos2::new(110.0, 20.0));
        assert_eq!(on_paper(&place, (0.0, 20.0), range, 0.0, -1.0), Pos2::new(10.0, 70.0));
        let (low, high) = widened(2.0, 2.0);
        assert!(low < high);
    }
}

//! Point clouds of clients as markers.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use ambf_core::comm::Snapshot;
use ambf_core::ids::BodyId;
use ambf_core::scene::VisualScene;
use ambf_render::{Marker, MarkerShape, Stage};
use nalgebra::Isometry3;

use crate::report;
use crate::ros::{PointCloud, PointClouds};

/// Points are black, as in the C++ program.
const COLOR: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// Keeps one marker for each cloud that clients publish. Other markers of a stage stay as they are.
pub struct CloudMarkers {
    clouds: Arc<PointClouds>,
    /// By topic.
    shown: BTreeMap<String, Shown>,
    /// Frames that have been complained of.
    unknown: BTreeSet<String>,
}

/// A cloud whose marker is in a stage.
struct Shown {
    cloud: Arc<PointCloud>,
    mark: Mark,
    /// Body in whose frame it is; `None`: the world.
    body: Option<BodyId>,
    /// Of the scene in which the body was looked up.
    generation: u64,
}

/// What tells the marker of a cloud from others: where its points are in memory, and how many. A list of markers may be
/// sorted or cleared by others, but nobody else has these points.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Mark(usize, usize);

impl Mark {
    fn of(points: &[[f32; 3]]) -> Self {
        Self(points.as_ptr() as usize, points.len())
    }

    fn is_of(self, marker: &Marker) -> bool {
        matches!(&marker.shape, MarkerShape::Points(points, _) if Self::of(points) == self)
    }
}

impl CloudMarkers {
    /// Markers of `clouds`; none are shown yet.
    pub fn new(clouds: Arc<PointClouds>) -> Self {
        Self { clouds, shown: BTreeMap::new(), unknown: BTreeSet::new() }
    }

    /// Brings the markers of `stage` up to date: clouds that came, changed and went, sizes, and the poses that the
    /// bodies in whose frames they are have in `snapshot`. A frame that names no body of `visuals`, or several, is the
    /// world; it is named once.
    pub fn refresh(&mut self, stage: &mut Stage, visuals: &VisualScene, snapshot: &Snapshot) {
        let all = self.clouds.all();
        let drawn = |topic: &str| all.iter().any(|(other, cloud)| other == topic && !cloud.points.is_empty());
        self.shown.retain(|topic, shown| {
            let stays = drawn(topic);
            if !stays {
                stage.markers.retain(|marker| !shown.mark.is_of(marker));
            }
            stays
        });
        for (topic, cloud) in all {
            if cloud.points.is_empty() {
                continue;
            }
            let place = self
                .shown
                .get(&topic)
                .and_then(|shown| stage.markers.iter().position(|marker| shown.mark.is_of(marker)));
            let marker = match place {
                Some(place) => &mut stage.markers[place],
                None => {
                    let shape = MarkerShape::Points(cloud.points.clone(), cloud.radius);
                    stage.markers.push(Marker { shape, pose: Isometry3::identity(), color: COLOR });
                    let Some(marker) = stage.markers.last_mut() else { continue };
                    marker
                }
            };
            let MarkerShape::Points(points, radius) = &mut marker.shape else { continue };
            *radius = cloud.radius;
            let before = self.shown.get(&topic).filter(|_| place.is_some());
            if before.is_some_and(|shown| !Arc::ptr_eq(&shown.cloud, &cloud)) {
                points.clone_from(&cloud.points);
            }
            let known =
                before.filter(|shown| shown.cloud.frame_id == cloud.frame_id && shown.generation == visuals.generation);
            let body = match known {
                Some(shown) => shown.body,
                None => self.body(&topic, &cloud.frame_id, visuals),
            };
            let pose =
                body.and_then(|body| Some(snapshot.bodies.get(body)?.body_pose(&visuals.bodies.get(body)?.offset)));
            marker.pose = pose.unwrap_or_else(Isometry3::identity);
            let mark = Mark::of(points);
            self.shown.insert(topic, Shown { cloud, mark, body, generation: visuals.generation });
        }
    }

    /// The body whose identifier is `frame`, else the only one whose identifier holds it.
    fn body(&mut self, topic: &str, frame: &str, visuals: &VisualScene) -> Option<BodyId> {
        if frame.is_empty() {
            return None;
        }
        let bodies = || visuals.bodies.entries().filter(|(_, body)| !body.object.removed);
        let exact = bodies().find(|(_, body)| *body.object.identifier == *frame);
        let mut parts = bodies().filter(|(_, body)| body.object.identifier.contains(frame));
        let found = match (exact, parts.next(), parts.next()) {
            (Some((id, _)), ..) | (None, Some((id, _)), None) => Ok(id),
            (None, None, _) => Err("names no body"),
            (None, Some(_), Some(_)) => Err("is part of the names of several bodies"),
        };
        if let (Err(what), true) = (found, frame != "world" && !self.unknown.contains(frame)) {
            report!("point cloud {topic}: its frame \"{frame}\" {what}; it is drawn in the world; this is said once");
            self.unknown.insert(frame.to_owned());
        }
        found.ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(frame: &str, points: usize, radius: f32) -> PointCloud {
        PointCloud { frame_id: frame.into(), points: vec![[1.0, 2.0, 3.0]; points], radius }
    }

    /// Row 53 of the checklist, without a picture.
    #[test]
    fn clouds_follow_their_bodies_and_leave_other_markers_alone() {
        let simulation = crate::cameras::service::tests::simulation();
        let (visuals, mut snapshot) = (simulation.scene().visuals(0), simulation.snapshot());
        let clouds = Arc::<PointClouds>::default();
        let mut markers = CloudMarkers::new(Arc::clone(&clouds));
        let mut stage = Stage::default();
        let other = Marker { shape: MarkerShape::Sphere(1.0), pose: Isometry3::identity(), color: COLOR };
        stage.markers.push(other.clone());

        clouds.set("/a", cloud("BODY Red", 3, 10.0));
        clouds.set("/b", cloud("nobody", 2, 10.0));
        markers.refresh(&mut stage, &visuals, &snapshot);
        let red = visuals.bodies.position(|body| body.object.name.contains("Red")).unwrap();
        let pose = snapshot.bodies[red].body_pose(&visuals.bodies[red].offset);
        assert_eq!((stage.markers.len(), &stage.markers[0]), (3, &other));
        assert_eq!(stage.markers[1].pose, pose);
        assert_eq!(stage.markers[2].pose, Isometry3::identity());
        assert!(markers.unknown.contains("nobody"));

        snapshot.bodies[red].origin[0] += 1.0;
        clouds.set("/a", cloud("BODY Red", 30, 3.0));
        markers.refresh(&mut stage, &visuals, &snapshot);
        assert!(matches!(&stage.markers[1].shape, MarkerShape::Points(points, 3.0) if points.len() == 30));
        assert!((stage.markers[1].pose.translation.x - pose.translation.x - 1.0).abs() < 1e-12);

        // A viewer may make its list of markers anew.
        stage.markers.clear();
        markers.refresh(&mut stage, &visuals, &snapshot);
        assert_eq!(stage.markers.len(), 2);
        clouds.set("/a", cloud("BODY Red", 0, 3.0));
        markers.refresh(&mut stage, &visuals, &snapshot);
        assert_eq!(stage.markers.len(), 1);
    }
}

//! What somebody at a window does to a running simulation: cameras, picking, removing, keys for plugins.
//!
//! Requests wait in a queue that the physics thread empties between iterations, also while it is paused or held by
//! clients. So whatever a mouse does to a camera is done to the simulated one, from which its State is published.

use crossbeam_channel::{bounded, Receiver, Sender, TrySendError};
use nalgebra::{Isometry3, Vector3};
use std::sync::Arc;

use super::session::Entry;
use super::{Simulation, Timeline};
use crate::bullet::{ConstraintHandle, Ray, RayTarget};
use crate::ids::{BodyId, CameraId, SoftBodyId};
use crate::plugin::{Drawings, Input, ObjectId};
use crate::scene::{CameraGesture, Scene};

/// How far a ray of picking reaches, m.
const REACH: f64 = 10_000.0;
/// How near to the hit a node of a soft body must be to be picked, m.
const NODE_RADIUS: f64 = 0.1;
/// Requests that may wait.
const REQUESTS: usize = 256;

/// What is asked of the simulation.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum WindowRequest {
    /// Moves a camera.
    MoveCamera {
        /// Index of the camera.
        camera: CameraId,
        /// How.
        gesture: CameraGesture,
    },
    /// Puts a camera somewhere.
    PlaceCamera {
        /// Index of the camera.
        camera: CameraId,
        /// Pose in the world.
        pose: Isometry3<f64>,
        /// Distance of the point that it looks at, m.
        distance: f64,
    },
    /// All cameras back to where they were in the beginning.
    ResetCameras,
    /// Gravity as the world file says, or none: also of all dynamic bodies that have their own.
    Gravity(bool),
    /// Takes hold of what a ray meets first.
    Pick {
        /// Start of the ray, m, world axes.
        origin: Vector3<f64>,
        /// Direction of the ray, of unit length.
        direction: Vector3<f64>,
    },
    /// Moves what is held: it stays at the distance at which it was picked, along this ray.
    Drag {
        /// Start of the ray, m, world axes.
        origin: Vector3<f64>,
        /// Direction of the ray, of unit length.
        direction: Vector3<f64>,
    },
    /// Lets go of what is held.
    Release,
    /// Takes a rigid body out of the scene, with its joints.
    RemoveBody(BodyId),
    /// A picture was drawn: plugins that want to know are told.
    Drawn,
    /// A use of a window, for plugins of the simulator.
    Input(Input),
    /// Keeps the last minute, or forgets it; see [`Simulation::keep_history`].
    KeepHistory(bool),
    /// Shows the kept state whose simulated time, s, is nearest; see [`Simulation::go_to_time`].
    GoToTime(f64),
}

impl WindowRequest {
    /// Both as one request, where that is the same.
    pub fn merged(&self, next: &Self) -> Option<Self> {
        match (self, next) {
            (Self::MoveCamera { camera, gesture }, Self::MoveCamera { camera: other, gesture: then })
                if camera == other =>
            {
                gesture.merged(*then).map(|gesture| Self::MoveCamera { camera: *camera, gesture })
            }
            (Self::Drag { .. }, Self::Drag { .. })
            | (Self::Drawn, Self::Drawn)
            | (Self::GoToTime(_), Self::GoToTime(_)) => Some(next.clone()),
            _ => None,
        }
    }
}

/// What was picked.
#[derive(Debug, Clone, PartialEq)]
pub enum Picked {
    /// The ray met nothing that can be held.
    Nothing,
    /// A rigid body.
    Body {
        /// Which one.
        body: BodyId,
        /// Its name.
        name: Arc<str>,
        /// Where the ray met it, m, world axes.
        point: Vector3<f64>,
        /// From the start of the ray to there, m.
        distance: f64,
    },
    /// A node of a soft body.
    Node {
        /// Which one.
        soft: SoftBodyId,
        /// Its name.
        name: Arc<str>,
        /// Where the ray met it, m, world axes.
        point: Vector3<f64>,
        /// From the start of the ray to there, m.
        distance: f64,
    },
}

/// What became of a request.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum WindowAnswer {
    /// To [`WindowRequest::Pick`].
    Picked(Picked),
    /// To [`WindowRequest::RemoveBody`]: the body and its name, or why it stays.
    Removed(Result<Arc<str>, String>),
    /// To [`WindowRequest::KeepHistory`] and [`WindowRequest::GoToTime`], if it was not done: why, in a sentence.
    NoHistory(String),
}

/// A window's end of the queue.
pub struct WindowLink {
    requests: Sender<WindowRequest>,
    answers: Receiver<WindowAnswer>,
    drawings: Drawings,
    timeline: Arc<Timeline>,
}

impl WindowLink {
    /// Times of which there are states to look back at.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// What plugins show in windows besides the scene.
    pub fn drawings(&self) -> &Drawings {
        &self.drawings
    }

    /// Leaves a request.
    ///
    /// # Errors
    /// The request, when too many wait: the simulation is busy, and it should be left again later.
    pub fn post(&self, request: WindowRequest) -> Result<(), WindowRequest> {
        self.requests.try_send(request).map_err(|error| match error {
            TrySendError::Full(request) | TrySendError::Disconnected(request) => request,
        })
    }

    /// What came of requests, in their order; `None` when there is nothing new.
    pub fn answer(&self) -> Option<WindowAnswer> {
        self.answers.try_recv().ok()
    }
}

/// What is held.
#[derive(Debug, Clone)]
enum Hold {
    /// A dynamic body.
    Grip { body: BodyId, grip: ConstraintHandle },
    /// A static body, which is moved by its position: from the hit to its body frame.
    Carried { body: BodyId, offset: Vector3<f64> },
    /// A node of a soft body.
    Node { soft: SoftBodyId, node: usize },
}

#[derive(Debug, Clone)]
struct Held {
    what: Hold,
    distance: f64,
}

/// The physics thread's end.
pub(super) struct Window {
    requests: Receiver<WindowRequest>,
    answers: Sender<WindowAnswer>,
}

/// What is picked at present; part of the state of a simulation, because its constraint is.
#[derive(Debug, Clone, Default)]
pub(super) struct Picking(Option<Held>);

impl Simulation {
    /// The handle through which windows work with the simulation. Replaces an earlier one.
    pub fn window_link(&mut self) -> WindowLink {
        let (requests, received) = bounded(REQUESTS);
        // Answers are fewer than requests.
        let (answers, answered) = bounded(REQUESTS);
        self.window = Some(Window { requests: received, answers });
        let (drawings, timeline) = (self.plugin_state.drawings.clone(), Arc::clone(self.timeline()));
        WindowLink { requests, answers: answered, drawings, timeline }
    }

    /// Whether a window wants something.
    pub(super) fn window_is_waiting(&self) -> bool {
        self.window.as_ref().is_some_and(|window| !window.requests.is_empty())
    }

    /// Physics thread: does what windows have asked for; true if there was anything that others can see.
    pub(super) fn serve_window(&mut self) -> bool {
        let mut seen = false;
        // As many as wait now, so that nobody holds the simulation up.
        for _ in 0..self.window.as_ref().map_or(0, |window| window.requests.len()) {
            let Some(Ok(request)) = self.window.as_ref().map(|window| window.requests.try_recv()) else { break };
            seen |= !matches!(request, WindowRequest::Drawn | WindowRequest::Input(_));
            if let (Some(answer), Some(window)) = (self.do_for_window(request), &self.window) {
                // Nobody reads answers: nobody waits for this one either.
                let _ = window.answers.try_send(answer);
            }
        }
        seen
    }

    fn do_for_window(&mut self, request: WindowRequest) -> Option<WindowAnswer> {
        if self.is_replaying() {
            return self.do_in_replay(request);
        }
        match request {
            WindowRequest::MoveCamera { camera, gesture } => self.move_camera(camera, gesture),
            WindowRequest::PlaceCamera { camera, pose, distance } => self.place_camera(camera, &pose, distance),
            WindowRequest::ResetCameras => self.reset_cameras(),
            WindowRequest::Gravity(on) => self.switch_gravity(on),
            WindowRequest::Pick { origin, direction } => {
                return Some(WindowAnswer::Picked(self.pick(&origin, &direction)));
            }
            WindowRequest::Drag { origin, direction } => self.drag(&origin, &direction),
            WindowRequest::Release => self.release_picked(),
            WindowRequest::RemoveBody(body) => return Some(WindowAnswer::Removed(self.remove_body(body))),
            WindowRequest::Drawn => self.plugins_after_picture(),
            WindowRequest::Input(input) => self.plugins_input(&input),
            WindowRequest::KeepHistory(keep) => return self.keep_history(keep).err().map(WindowAnswer::NoHistory),
            WindowRequest::GoToTime(time) => return self.go_to_time(time).err().map(WindowAnswer::NoHistory),
        }
        None
    }

    /// What a window may do while a recording is replayed: look from elsewhere.
    fn do_in_replay(&mut self, request: WindowRequest) -> Option<WindowAnswer> {
        const WHY: &str = "a recording is replayed: nothing can be changed until it is over or left";
        match request {
            WindowRequest::MoveCamera { camera, gesture } => self.move_camera(camera, gesture),
            WindowRequest::PlaceCamera { camera, pose, distance } => self.place_camera(camera, &pose, distance),
            WindowRequest::ResetCameras => self.reset_cameras(),
            // They belong to a pick that was refused. What was picked when it was recorded stays so.
            WindowRequest::Drag { .. } | WindowRequest::Release => (),
            WindowRequest::Drawn | WindowRequest::Input(_) => (),
            WindowRequest::Gravity(_) => {
                self.refuses();
            }
            WindowRequest::Pick { .. } => {
                self.refuses();
                return Some(WindowAnswer::Picked(Picked::Nothing));
            }
            WindowRequest::RemoveBody(_) => return Some(WindowAnswer::Removed(Err(WHY.into()))),
            WindowRequest::KeepHistory(_) | WindowRequest::GoToTime(_) => {
                return Some(WindowAnswer::NoHistory(WHY.into()));
            }
        }
        None
    }

    pub(super) fn move_camera(&mut self, camera: CameraId, gesture: CameraGesture) {
        self.physics.note(&Entry::MoveCamera { camera: camera.index(), gesture });
        if let Some(camera) = self.physics.scene.cameras.get_mut(camera) {
            camera.follow_gesture(gesture);
        }
    }

    pub(super) fn reset_cameras(&mut self) {
        self.physics.note(&Entry::ResetCameras {});
        self.physics.scene.reset_cameras();
    }

    /// Gravity as the world file says, or none.
    pub(super) fn switch_gravity(&mut self, on: bool) {
        self.physics.note(&Entry::Gravity { on });
        let gravity = if on { self.physics.scene.gravity } else { Vector3::zeros() };
        self.physics.scene.world.set_gravity(gravity);
    }

    pub(super) fn place_camera(&mut self, camera: CameraId, pose: &Isometry3<f64>, distance: f64) {
        self.physics.note(&Entry::LookFrom { camera: camera.index(), pose: *pose, distance });
        let numbers = pose.to_homogeneous();
        let is_place = numbers.iter().all(|x| x.is_finite()) && distance > 0.0 && distance.is_finite();
        if !is_place {
            return;
        }
        let Some(parent) = self.physics.scene.cameras.get(camera).map(|camera| camera.attached.parent) else { return };
        let parent = self.physics.scene.global_pose(parent, &Isometry3::identity());
        self.physics.scene.cameras[camera].look_from(&(parent.inverse() * pose), distance);
    }

    /// Takes hold of what a ray meets first, of rigid and soft bodies; `direction` is of unit length, world axes. What
    /// was held is released. A dynamic body hangs on the point that was met by a constraint whose impulse in a sub-step
    /// is at most its mass times 1 m/s; a static one is carried with the offset from there; of a soft body the nearest
    /// node within 0.1 m is drawn along.
    pub fn pick(&mut self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Picked {
        self.physics.note(&Entry::Pick { origin: *origin, direction: *direction });
        self.let_go();
        if !origin.iter().chain(direction).all(|x| x.is_finite()) {
            return Picked::Nothing;
        }
        let mut hits = [None];
        self.physics.scene.world.cast_rays(&[Ray { from: *origin, to: origin + direction * REACH }], &mut hits);
        let Some(hit) = hits[0] else { return Picked::Nothing };
        let distance = (hit.point - origin).norm();
        let Scene { world, bodies, soft_bodies, .. } = &mut self.physics.scene;
        let (what, picked) = match hit.target {
            RayTarget::Body(handle) => {
                let (Some(id), Some(pose)) = (bodies.id_of(handle), world.pose(handle)) else {
                    return Picked::Nothing;
                };
                let body = &bodies[id];
                let what = match body.is_dynamic() {
                    true => {
                        let point = (pose.inverse() * nalgebra::Point3::from(hit.point)).coords;
                        let Some(grip) = world.add_grip(handle, &point, &hit.point, body.mass) else {
                            return Picked::Nothing;
                        };
                        Hold::Grip { body: id, grip }
                    }
                    false => Hold::Carried { body: id, offset: pose.translation.vector - hit.point },
                };
                let name = body.identity.communication_name().into();
                (what, Picked::Body { body: id, name, point: hit.point, distance })
            }
            RayTarget::SoftBody(handle) => {
                let soft = soft_bodies.position(|soft| soft.handle == handle);
                let node = world.nearest_node(handle, &hit.point, NODE_RADIUS);
                let (Some(soft), Some(node)) = (soft, node) else { return Picked::Nothing };
                world.pull_node(handle, node, Some(hit.point));
                let name = soft_bodies[soft].identity.communication_name().into();
                (Hold::Node { soft, node }, Picked::Node { soft, name, point: hit.point, distance })
            }
            RayTarget::Other => return Picked::Nothing,
        };
        self.picking.0 = Some(Held { what, distance });
        picked
    }

    /// Moves what is held to its distance along a ray; `direction` is of unit length, world axes.
    pub fn drag(&mut self, origin: &Vector3<f64>, direction: &Vector3<f64>) {
        let Some(held) = &self.picking.0 else { return };
        self.physics.note(&Entry::Drag { origin: *origin, direction: *direction });
        let goal = origin + direction * held.distance;
        if !goal.iter().all(|x| x.is_finite()) {
            return;
        }
        match held.what {
            Hold::Grip { grip, .. } => {
                self.physics.scene.world.move_grip(grip, &goal);
            }
            Hold::Carried { body, offset } => {
                let Scene { bodies, world, .. } = &mut self.physics.scene;
                if let Some(mut pose) = world.pose(bodies[body].handle) {
                    pose.translation.vector = goal + offset;
                    world.set_pose(bodies[body].handle, &pose);
                }
            }
            Hold::Node { soft, node } => {
                self.pull_soft_node(soft, node, Some(goal));
            }
        }
    }

    /// Lets go of what is held.
    pub fn release_picked(&mut self) {
        if self.picking.0.is_some() {
            self.physics.note(&Entry::Release {});
        }
        self.let_go();
    }

    /// [`release_picked`](Self::release_picked) as part of something else.
    pub(super) fn let_go(&mut self) {
        match self.picking.0.take().map(|held| held.what) {
            Some(Hold::Grip { grip, .. }) => {
                self.physics.scene.world.remove_constraint(grip);
            }
            Some(Hold::Node { soft, node }) => {
                self.pull_soft_node(soft, node, None);
            }
            Some(Hold::Carried { .. }) | None => (),
        }
    }

    /// Lets go of what is held if it, or part of it, is `is_going`.
    pub(super) fn release_picked_of(&mut self, is_going: impl Fn(&Scene, ObjectId) -> bool) {
        let goes = self.picking.0.as_ref().is_some_and(|held| match held.what {
            Hold::Grip { body, .. } | Hold::Carried { body, .. } => is_going(&self.physics.scene, body.into()),
            Hold::Node { soft, .. } => is_going(&self.physics.scene, soft.into()),
        });
        if goes {
            self.let_go();
        }
    }

    /// Takes a rigid body out of the scene, with its joints and what stands on it; its name.
    ///
    /// # Errors
    /// A sentence when there is no such body, or no longer.
    pub fn remove_body(&mut self, body: BodyId) -> Result<Arc<str>, String> {
        let Some(name) = self.physics.scene.bodies.get(body).map(|body| body.identity.communication_name()) else {
            return Err("there is no such body".into());
        };
        if self.physics.scene.body_is_gone(body) {
            return Err(format!("body `{name}` was removed before"));
        }
        self.physics.note(&Entry::RemoveBody { body: body.index() });
        self.release_picked_of(|_, held| held == body.into());
        self.detach_plugins_from(|other| other == body);
        self.physics.scene.remove_body(body);
        self.grow();
        if let Some(link) = &mut self.link {
            link.remove_objects(&self.physics.scene);
            link.follow_scene(&self.physics.scene, &self.physics.wrenches);
        }
        Ok(name.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::shipped::simulation;

    /// Ray straight down onto a body.
    fn above(simulation: &Simulation, name: &str) -> (BodyId, Vector3<f64>) {
        let scene = simulation.scene();
        let found = scene.bodies.position(|body| *body.identity.name == *name);
        let index = found.unwrap_or_else(|| panic!("no body {name}"));
        let place = scene.world.pose(scene.bodies[index].handle).unwrap().translation.vector;
        (index, place + Vector3::new(0.0, 0.0, 5.0))
    }

    fn dynamic_body(simulation: &Simulation) -> String {
        let scene = simulation.scene();
        scene.bodies.iter().find(|body| body.is_dynamic()).expect("one moves").identity.name.to_string()
    }

    fn steps(simulation: &mut Simulation, n: u32) {
        for _ in 0..n {
            simulation.update(0.001).expect("finite");
        }
    }

    #[test]
    fn row_57_a_picked_body_follows_the_ray_at_constant_distance_and_falls_when_released() {
        let mut simulation = simulation("stack.yaml", false);
        let scene = simulation.scene();
        let top = scene.bodies.entries().filter(|(_, body)| body.is_dynamic());
        let height = |index: BodyId| scene.world.pose(scene.bodies[index].handle).unwrap().translation.vector.z;
        let (top, _) = top.max_by(|a, b| height(a.0).total_cmp(&height(b.0))).unwrap();
        let name = scene.bodies[top].identity.name.to_string();
        let (index, origin) = above(&simulation, &name);
        let Picked::Body { body, point, distance, .. } = simulation.pick(&origin, &-Vector3::z()) else {
            panic!("nothing picked")
        };
        assert_eq!(body, index);
        assert!((point - (origin - Vector3::z() * distance)).norm() < 1e-9);
        // The eye goes up by 0.4 m, and the body with it.
        let raised = origin + Vector3::new(0.0, 0.0, 0.4);
        for _ in 0..3000 {
            simulation.drag(&raised, &-Vector3::z());
            simulation.update(0.001).expect("finite");
        }
        let body = &simulation.scene().bodies[index];
        let held = simulation.scene().world.pose(body.handle).unwrap();
        let start = origin - Vector3::new(0.0, 0.0, 5.0);
        let lifted = held.translation.vector.z - start.z;
        assert!((lifted - 0.4).abs() < 0.01, "{lifted}");
        simulation.release_picked();
        steps(&mut simulation, 200);
        let fallen = simulation.scene().world.pose(simulation.scene().bodies[index].handle).unwrap();
        assert!(fallen.translation.vector.z < held.translation.vector.z - 0.05, "it is let go");
    }

    #[test]
    fn a_static_body_is_carried_and_stays() {
        let mut simulation = simulation("stack.yaml", false);
        let scene = simulation.scene();
        let found = scene.bodies.position(|body| !body.is_dynamic()).expect("a floor");
        let before = scene.world.pose(scene.bodies[found].handle).unwrap();
        let origin = before.translation.vector + Vector3::new(1.3, 1.3, 5.0);
        let Picked::Body { body, .. } = simulation.pick(&origin, &-Vector3::z()) else { panic!("no floor there") };
        assert!(!simulation.scene().bodies[body].is_dynamic());
        let place =
            |simulation: &Simulation| simulation.scene().world.pose(simulation.scene().bodies[body].handle).unwrap();
        let before = place(&simulation);
        simulation.drag(&(origin + Vector3::new(0.1, 0.2, -0.3)), &-Vector3::z());
        simulation.release_picked();
        steps(&mut simulation, 10);
        let moved = place(&simulation).translation.vector - before.translation.vector;
        assert!((moved - Vector3::new(0.1, 0.2, -0.3)).norm() < 1e-9, "{moved}");
    }

    #[test]
    fn row_73_a_removed_body_is_gone_for_everybody() {
        let mut simulation = simulation("pendulum.yaml", false);
        let hub = simulation.connect();
        hub.set_listening();
        let name = dynamic_body(&simulation);
        let (index, origin) = above(&simulation, &name);
        let _ = simulation.pick(&origin, &-Vector3::z());
        let (before, joints) = (hub.generation(), simulation.scene().joints.len());
        let object = hub.objects().entries().find(|(_, object)| object.info.name == name).map(|(position, _)| position);
        assert!(joints > 0);
        assert_eq!(&*simulation.remove_body(index).unwrap(), name);
        assert!(simulation.remove_body(index).unwrap_err().contains("before"));
        assert!(simulation.remove_body(BodyId::new(usize::MAX)).is_err());
        assert!(hub.generation() > before);
        assert!(hub.visuals().unwrap().bodies[index].object.removed);
        assert!(hub.objects()[object.unwrap()].is_removed());
        assert!(simulation
            .scene()
            .joints
            .iter()
            .all(|joint| joint.removed || (joint.parent, joint.child) != (index, index)));
        assert!(simulation.scene().joints.iter().any(|joint| joint.removed));
        steps(&mut simulation, 100);
        simulation.reset_world();
        steps(&mut simulation, 100);
    }

    #[test]
    fn gestures_move_the_simulated_camera_and_a_reset_brings_it_back() {
        let mut simulation = simulation("pendulum.yaml", false);
        let link = simulation.window_link();
        assert!(!simulation.serve_window());
        let before = simulation.scene().cameras[CameraId::new(0)].clone();
        for _ in 0..3 {
            let gesture = CameraGesture::Pan { right: -0.5, up: 0.25 };
            link.post(WindowRequest::MoveCamera { camera: CameraId::new(0), gesture }).unwrap();
        }
        link.post(WindowRequest::MoveCamera {
            camera: CameraId::new(99),
            gesture: CameraGesture::Dolly { forward: 1.0 },
        })
        .unwrap();
        link.post(WindowRequest::MoveCamera {
            camera: CameraId::new(0),
            gesture: CameraGesture::Dolly { forward: 1.0 },
        })
        .unwrap();
        assert!(simulation.window_is_waiting() && simulation.serve_window());
        let camera = &simulation.scene().cameras[CameraId::new(0)];
        let moved = before.attached.pose.inverse() * camera.attached.pose;
        assert!((moved.translation.vector - Vector3::new(-1.0, -1.5, 0.75)).norm() < 1e-12);
        assert!((camera.target.x - before.target.x - 1.0).abs() < 1e-12);
        link.post(WindowRequest::ResetCameras).unwrap();
        simulation.serve_window();
        let camera = &simulation.scene().cameras[CameraId::new(0)];
        assert_eq!((camera.attached.pose, camera.target), (before.attached.pose, before.target));
    }

    #[test]
    fn a_full_queue_gives_the_request_back() {
        let mut simulation = simulation("pendulum.yaml", false);
        let link = simulation.window_link();
        let posted = (0..10 * REQUESTS).take_while(|_| link.post(WindowRequest::ResetCameras).is_ok()).count();
        assert_eq!(posted, REQUESTS);
        assert!(matches!(link.post(WindowRequest::Release), Err(WindowRequest::Release)));
        simulation.serve_window();
        assert!(link.post(WindowRequest::Release).is_ok());
    }

    #[test]
    fn a_state_that_was_saved_while_picking_is_restored_without_a_hold() {
        let mut simulation = simulation("stack.yaml", true);
        let name = dynamic_body(&simulation);
        let (_, origin) = above(&simulation, &name);
        assert!(matches!(simulation.pick(&origin, &-Vector3::z()), Picked::Body { .. }));
        steps(&mut simulation, 10);
        let saved = simulation.save().expect("savable");
        simulation.release_picked();
        steps(&mut simulation, 10);
        simulation.restore(&saved).expect("of this simulation");
        simulation.drag(&(origin + Vector3::z()), &-Vector3::z());
        steps(&mut simulation, 500);
        let (_, after) = above(&simulation, &name);
        assert!(after.z < origin.z + 0.1, "nothing draws it up: {}", after.z - origin.z);
    }

    #[test]
    fn gravity_comes_back_as_the_world_file_says() {
        let mut simulation = simulation("stack.yaml", false);
        let link = simulation.window_link();
        let fall = |simulation: &mut Simulation| {
            simulation.reset_bodies();
            let name = dynamic_body(simulation);
            let (index, _) = above(simulation, &name);
            let handle = simulation.scene().bodies[index].handle;
            let pose = simulation.scene().world.pose(handle).unwrap();
            let raised = Isometry3::translation(0.0, 0.0, 3.0) * pose;
            simulation.physics.scene.world.set_pose(handle, &raised);
            steps(simulation, 100);
            raised.translation.z - simulation.scene().world.pose(handle).unwrap().translation.z
        };
        link.post(WindowRequest::Gravity(false)).unwrap();
        simulation.serve_window();
        assert!(fall(&mut simulation).abs() < 1e-9);
        link.post(WindowRequest::Gravity(true)).unwrap();
        simulation.serve_window();
        assert!((fall(&mut simulation) - 0.5 * 9.8 * 0.01).abs() < 3e-3);
    }
}

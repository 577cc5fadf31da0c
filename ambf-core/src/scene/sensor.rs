//! Live sensors: rays that see, rays that also push, and contacts of a body.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::build::Builder;
use super::list::SceneObject;
use super::{Bodies, Body, Identity, ObjectType, Scene};
use crate::adf::{self, RaySource, ResistanceParameters};
use crate::bullet::{Contact, ContactLists, Ray, RayHit, RayTarget, SoftBodyHandle, World};
use crate::comm::{ContactPoint, ContactReading, ObjectKind, RayReading, SensorInfo, Snapshot, TouchingBody};
use crate::control::Profile;
use crate::ids::{BodyId, SensorId};
use crate::mesh::Mesh;

/// A ray in the sensor frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalRay {
    /// Start, m.
    pub start: Vector3<f64>,
    /// From start to end when multiplied by the range; not normalised.
    pub direction: Vector3<f64>,
}

/// What a ray of a sensor hits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sensed {
    /// A rigid body, by index.
    Body(BodyId),
    /// A soft body, at a point in the world, m.
    SoftBody(SoftBodyHandle, Vector3<f64>),
    /// Something without a name.
    Other,
}

/// A sensor of a [`Scene`](super::Scene).
#[derive(Debug)]
pub struct Sensor {
    /// Names and publishing rates.
    pub identity: Identity,
    /// Type, parent's name, pose in the parent's body frame, range.
    pub info: SensorInfo,
    /// Index of the parent body.
    pub parent: BodyId,
    /// Rays in the sensor frame; none for a contact sensor.
    pub rays: Vec<LocalRay>,
    /// What is seen, one entry a ray or a body in contact.
    readings: Vec<RayReading>,
    work: Work,
}

#[derive(Debug)]
enum Work {
    Rays { world: Vec<Ray>, hits: Vec<Option<RayHit>>, resistance: Option<Resistance> },
    Contacts { threshold: f64, details: bool, contacts: Vec<Contact>, reading: ContactReading },
}

/// What of a [`Sensor`] changes while the simulation runs.
#[derive(Debug, Clone)]
pub(super) struct SavedSensor {
    readings: Vec<RayReading>,
    rays: Vec<Ray>,
    hits: Vec<Option<RayHit>>,
    memory: Vec<Option<Stuck>>,
    touching: ContactReading,
}

/// Contact points, and bodies, that a contact sensor can report without allocating.
const CONTACTS: usize = 64;

/// A ray before the first update.
const NOWHERE: Ray = Ray { from: Vector3::new(0.0, 0.0, 0.0), to: Vector3::new(0.0, 0.0, 0.0) };

/// A reading with memory for [`CONTACTS`].
fn spacious() -> ContactReading {
    ContactReading { bodies: Vec::with_capacity(CONTACTS), points: Vec::with_capacity(CONTACTS) }
}

impl SceneObject for Sensor {
    type Id = SensorId;
    type Saved = SavedSensor;
    const TYPE: ObjectType = ObjectType::Sensor;
    const RANK: u8 = 6;
    const ACTS: bool = true;
    const RESETS_WITH_BODIES: bool = true;

    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn add_all(builder: &mut Builder<'_>, model: &adf::Model) {
        for sensor in &model.sensors {
            builder.with_plugins(Self::TYPE, &sensor.common, |builder| builder.add_sensor(sensor));
        }
    }

    fn kind(&self, id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::Sensor(id, Box::new(self.info.clone())))
    }

    fn stands_on(&self, _id: Self::Id) -> Option<BodyId> {
        Some(self.parent)
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.sensors.push(self.readings.clone());
        snapshot.contacts.push(self.contacts().cloned().unwrap_or_default());
    }

    fn read(&self, id: Self::Id, _scene: &Scene, snapshot: &mut Snapshot) {
        // Keeps the memory of what was there.
        let readings = &mut snapshot.sensors[id];
        readings.clear();
        readings.extend_from_slice(&self.readings);
        if let Some(contacts) = self.contacts() {
            snapshot.contacts[id].copy_from(contacts);
        }
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.bodies[self.parent].pose(&scene.world) * self.info.pose)
    }

    /// The measurement of each ray or contact.
    fn values(&self, _scene: &Scene, out: &mut Vec<f64>) {
        out.extend(self.readings.iter().map(|reading| reading.measurement));
    }

    fn update(scene: &mut Scene, id: Self::Id, sub_step: f64, interval: f64) {
        let Scene { sensors, world, bodies, touching, .. } = scene;
        sensors[id].sense(world, bodies, touching, sub_step, interval);
    }

    /// Seeing nothing, until the next update, and remembering nothing.
    fn reset(scene: &mut Scene, id: Self::Id) {
        let Self { readings, work, .. } = &mut scene.sensors[id];
        match work {
            Work::Rays { world, hits, resistance } => {
                readings.fill(RayReading::default());
                world.fill(NOWHERE);
                hits.fill(None);
                if let Some(resistance) = resistance {
                    resistance.memory.fill(None);
                }
            }
            Work::Contacts { reading, .. } => {
                readings.clear();
                reading.bodies.clear();
                reading.points.clear();
            }
        }
    }

    fn save(&self) -> SavedSensor {
        // All fields by name, so that no new one is forgotten.
        let Self { identity: _, info: _, parent: _, rays: _, readings, work } = self;
        let (rays, hits, memory, touching) = match work {
            Work::Rays { world, hits, resistance } => {
                let memory = resistance
                    .as_ref()
                    .map(|Resistance { parameters: _, profile: _, memory, pushes: _ }| memory.clone());
                (world.clone(), hits.clone(), memory.unwrap_or_default(), ContactReading::default())
            }
            // Contacts are asked for in each update.
            Work::Contacts { threshold: _, details: _, contacts: _, reading } => {
                (Vec::new(), Vec::new(), Vec::new(), reading.clone())
            }
        };
        SavedSensor { readings: readings.clone(), rays, hits, memory, touching }
    }

    fn restore(&mut self, saved: &SavedSensor) {
        self.readings.clone_from(&saved.readings);
        match &mut self.work {
            Work::Rays { world, hits, resistance } => {
                world.clone_from(&saved.rays);
                hits.clone_from(&saved.hits);
                if let Some(resistance) = resistance {
                    resistance.memory.clone_from(&saved.memory);
                }
            }
            Work::Contacts { reading, .. } => reading.copy_from(&saved.touching),
        }
    }
}

impl Sensor {
    pub(super) fn with_rays(
        identity: Identity,
        info: SensorInfo,
        parent: BodyId,
        rays: Vec<LocalRay>,
        resistance: Option<Resistance>,
    ) -> Self {
        let work = Work::Rays { world: vec![NOWHERE; rays.len()], hits: vec![None; rays.len()], resistance };
        Self { identity, info, parent, readings: vec![RayReading::default(); rays.len()], rays, work }
    }

    /// A contact sensor. With `details` it also reports each contact point.
    pub(super) fn with_contacts(identity: Identity, info: SensorInfo, parent: BodyId, details: bool) -> Self {
        let contacts = Vec::with_capacity(CONTACTS);
        let work = Work::Contacts { threshold: info.range, details, contacts, reading: spacious() };
        Self { identity, info, parent, rays: Vec::new(), readings: Vec::with_capacity(CONTACTS), work }
    }

    /// What is seen, one entry a ray; for a contact sensor one entry a body in contact.
    pub fn readings(&self) -> &[RayReading] {
        &self.readings
    }

    /// What touches the parent of a contact sensor; `None` for other sensors.
    pub fn contacts(&self) -> Option<&ContactReading> {
        match &self.work {
            Work::Contacts { reading, .. } => Some(reading),
            Work::Rays { .. } => None,
        }
    }

    /// What each ray that is triggered hits, in order of the rays. Nothing for contact sensors.
    pub fn sensed<'a>(&'a self, bodies: &'a Bodies) -> impl Iterator<Item = Sensed> + 'a {
        let hits: &[Option<RayHit>] = match &self.work {
            Work::Rays { hits, .. } => hits,
            Work::Contacts { .. } => &[],
        };
        hits.iter().flatten().map(|hit| match hit.target {
            RayTarget::Body(handle) => bodies.id_of(handle).map_or(Sensed::Other, Sensed::Body),
            RayTarget::SoftBody(handle) => Sensed::SoftBody(handle, hit.point),
            RayTarget::Other => Sensed::Other,
        })
    }

    /// The nearest rigid body that a ray hits among those that are accepted, with its distance from the start of the
    /// ray, m.
    pub(crate) fn nearest_body(&self, bodies: &Bodies, accept: impl Fn(BodyId) -> bool) -> Option<(BodyId, f64)> {
        let Work::Rays { world, hits, .. } = &self.work else { return None };
        let bodies_hit = world.iter().zip(hits).filter_map(|(ray, hit)| {
            let hit = hit.as_ref()?;
            let RayTarget::Body(handle) = hit.target else { return None };
            let body = bodies.id_of(handle).filter(|&body| accept(body))?;
            Some((body, hit.fraction * (ray.to - ray.from).norm()))
        });
        bodies_hit.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Looks, and pushes if it is a resistance sensor. The forces act in the next update, which is taken to be as long
    /// as the last one: `interval` s. `sub_step` in s. `touching` has the contacts of the parents of contact sensors.
    pub(crate) fn sense(
        &mut self,
        world: &mut World,
        bodies: &Bodies,
        touching: &ContactLists,
        sub_step: f64,
        interval: f64,
    ) {
        match &mut self.work {
            Work::Contacts { threshold, details, contacts, reading } => {
                contacts.clear();
                // What rests on a thin cushion of Bullet's margin touches too: it is carried.
                let touches = |contact: &Contact| contact.distance <= *threshold || contact.impulse > 0.0;
                let known = |contact: &Contact| bodies.id_of(contact.other).is_some();
                let all = touching.of(bodies[self.parent].handle);
                contacts.extend(all.filter(|contact| touches(contact) && known(contact)));
                // Of the bodies the one with the lower handle first: the order does not change from step to step.
                contacts.sort_unstable_by_key(|contact| contact.other);
                read_contacts(&mut self.readings, reading, contacts, bodies, sub_step, *details);
            }
            Work::Rays { world: rays, hits, resistance } => {
                let pose = bodies[self.parent].pose(world) * self.info.pose;
                for (ray, local) in rays.iter_mut().zip(&self.rays) {
                    let end = local.start + local.direction * self.info.range;
                    ray.from = (pose * Point3::from(local.start)).coords;
                    ray.to = (pose * Point3::from(end)).coords;
                }
                world.cast_rays(rays, hits);
                for (reading, hit) in self.readings.iter_mut().zip(hits.iter()) {
                    let sensed = hit.as_ref().and_then(|hit| match hit.target {
                        RayTarget::Body(handle) => bodies.id_of(handle),
                        RayTarget::SoftBody(_) | RayTarget::Other => None,
                    });
                    reading.triggered = hit.is_some();
                    reading.measurement = hit.as_ref().map_or(0.0, |hit| 1.0 - hit.fraction);
                    reading.sensed = sensed.map(|body| Arc::clone(&bodies[body].identity.name));
                    reading.body = sensed;
                }
                if let Some(resistance) = resistance {
                    resistance.push(world, bodies, self.parent, &self.info, (&self.rays, hits), interval);
                }
            }
        }
    }
}

/// From contacts, those of one body together: one reading a body, with the sum of the normal forces of its contacts,
/// and the same with the points if they are asked for.
fn read_contacts(
    readings: &mut Vec<RayReading>,
    reading: &mut ContactReading,
    contacts: &[Contact],
    bodies: &Bodies,
    sub_step: f64,
    details: bool,
) {
    readings.clear();
    reading.bodies.clear();
    reading.points.clear();
    for of_one in contacts.chunk_by(|a, b| a.other == b.other) {
        let Some(body) = bodies.id_of(of_one[0].other) else { continue };
        let identity = &bodies[body].identity;
        let force = of_one.iter().map(|contact| contact.impulse / sub_step).sum();
        let sensed = Some(Arc::clone(&identity.name));
        readings.push(RayReading { triggered: true, measurement: force, sensed, body: Some(body) });
        let points = if details { of_one } else { &[] };
        reading.bodies.push(TouchingBody { identifier: Arc::clone(&identity.qualified), points: points.len() });
        reading.points.extend(points.iter().map(|&Contact { distance, point, normal, .. }| ContactPoint {
            distance,
            point,
            normal,
        }));
    }
}

/// The contact law of a resistance sensor. With N the direction of the ray, d the depth fraction, a the body that
/// carries the sensor and b the one that is hit:
///
/// F = k·d·N + c·e + s·(e − e_before) + m·Δv, where e is the tangential part of the drift between the points of a and b
/// that met first, Δv the tangential velocity of a against b, and c = static friction, s = friction damping, m =
/// dynamic friction (each but s multiplied by |k·d·N| when the friction is variable). b gets F at the hit point, a gets
/// −F.
///
/// In profile `accurate` the law is linearly implicit over the update of h s: F = (F₀ + h·K·v)/(1 + Σ h·(h·K + C)·r),
/// with the derivatives K and C of F with respect to the relative position and velocity v of the points, their response
/// r to a force, 1/kg, and the sum over all rays of the sensor that hit the body. Springs of any stiffness then stay
/// below the stability limit of the step.
#[derive(Debug)]
pub(super) struct Resistance {
    parameters: ResistanceParameters,
    profile: Profile,
    memory: Vec<Option<Stuck>>,
    /// Forces of the present update.
    pushes: Vec<Push>,
}

/// Two points that met, and how far they have drifted apart.
#[derive(Debug, Clone, Copy)]
struct Stuck {
    body: BodyId,
    /// In the inertial frames of the two bodies, m.
    on_parent: Vector3<f64>,
    on_body: Vector3<f64>,
    depth: f64,
    /// Tangential drift one and two iterations ago, m.
    drift: [Vector3<f64>; 2],
}

/// Directions shorter than this are not normalised, as in the C++ program.
const SHORT: f64 = 1e-4;

impl Resistance {
    pub fn new(parameters: ResistanceParameters, rays: usize, profile: Profile) -> Self {
        Self { parameters, profile, memory: vec![None; rays], pushes: Vec::with_capacity(rays) }
    }

    fn push(
        &mut self,
        world: &mut World,
        bodies: &Bodies,
        parent: BodyId,
        info: &SensorInfo,
        (rays, hits): (&[LocalRay], &[Option<RayHit>]),
        interval: f64,
    ) {
        self.pushes.clear();
        for (ray, (hit, memory)) in rays.iter().zip(hits.iter().zip(&mut self.memory)) {
            let body = hit.as_ref().and_then(|hit| match hit.target {
                RayTarget::Body(handle) => bodies.id_of(handle),
                _ => None,
            });
            let (Some(hit), Some(body)) = (hit, body) else {
                *memory = None;
                continue;
            };
            let (a, b) = (bodies[parent].handle, bodies[body].handle);
            let (Some(pose_a), Some(pose_b)) = (world.pose(a), world.pose(b)) else { continue };
            // The C++ program takes the direction in the inertial frame of the parent and leaves the sensor's rotation
            // out.
            let normal = match self.profile {
                Profile::Legacy => pose_a.rotation * ray.direction,
                Profile::Accurate => {
                    let to_body = bodies[parent].inertial_offset_inverse.rotation;
                    (pose_a.rotation * to_body * (info.pose.rotation * ray.direction)).normalize()
                }
            };
            let depth = 1.0 - hit.fraction;
            let velocity = |handle, pose: &Isometry3<f64>| {
                let (linear, angular) = world.velocity(handle).unwrap_or_default();
                linear + angular.cross(&(hit.point - pose.translation.vector))
            };
            let approach = velocity(a, &pose_a) - velocity(b, &pose_b);
            let (force, kept) = force(
                &self.parameters,
                self.profile,
                &normal,
                depth,
                &(approach - hit.normal * hit.normal.dot(&approach)),
                memory.filter(|stuck| stuck.body == body).as_mut(),
                |stuck| (pose_a * Point3::from(stuck.on_parent)) - (pose_b * Point3::from(stuck.on_body)),
            );
            let gains = gains(&self.parameters, depth, kept.is_some(), info.range);
            *memory = kept.or_else(|| {
                let local = |pose: &Isometry3<f64>| pose.inverse_transform_point(&Point3::from(hit.point)).coords;
                let (on_parent, on_body) = (local(&pose_a), local(&pose_b));
                Some(Stuck { body, on_parent, on_body, depth, drift: [Vector3::zeros(); 2] })
            });
            let response =
                response(&bodies[parent], &pose_a, &hit.point) + response(&bodies[body], &pose_b, &hit.point);
            let ahead = approach_force(&gains, &normal, &approach) * interval;
            let share = gains.largest(interval) * interval * response;
            self.pushes.push(Push { body, point: hit.point, force, ahead, share });
        }
        let pose_a = world.pose(bodies[parent].handle);
        for push in &self.pushes {
            let (Some(pose_a), Some(pose_b)) = (pose_a, world.pose(bodies[push.body].handle)) else { continue };
            let force = match self.profile {
                Profile::Legacy => push.force,
                Profile::Accurate => {
                    // The rays that push at the same body are stiff together.
                    let stiff: f64 = self.pushes.iter().filter(|one| one.body == push.body).map(|one| one.share).sum();
                    (push.force + push.ahead) / (1.0 + stiff)
                }
            };
            let mut apply = |handle, pose: &Isometry3<f64>, force: Vector3<f64>| {
                let torque = (push.point - pose.translation.vector).cross(&force);
                world.apply_wrench(handle, &force, &torque);
            };
            apply(bodies[push.body].handle, &pose_b, force);
            apply(bodies[parent].handle, &pose_a, -force);
        }
    }
}

/// The force of one ray, before it acts.
#[derive(Debug, Clone, Copy)]
struct Push {
    body: BodyId,
    /// World axes, m.
    point: Vector3<f64>,
    /// At the present positions and velocities, N.
    force: Vector3<f64>,
    /// What the present velocities add to it until the end of the interval, N.
    ahead: Vector3<f64>,
    /// Velocity that the force would take away in the interval, as a share of the present one.
    share: f64,
}

/// Derivatives of a ray's force with respect to the relative motion of the two points: stiffness, N/m, along the ray
/// and across it, and damping, N·s/m, across it.
#[derive(Debug, Clone, Copy)]
struct Gains {
    along: f64,
    across: f64,
    damping: f64,
}

impl Gains {
    /// Largest change of the force by a relative velocity of 1 m/s over `h` s, N·s/m.
    fn largest(&self, h: f64) -> f64 {
        (self.along * h).max(self.across * h + self.damping)
    }
}

/// Change of the force with time, N/s, by the stiffness; damping already is in the force.
fn approach_force(gains: &Gains, normal: &Vector3<f64>, approach: &Vector3<f64>) -> Vector3<f64> {
    let along = normal * normal.dot(approach);
    along * gains.along + (approach - along) * gains.across
}

/// Largest velocity that a force of 1 N at a point gives to that point of a free body in 1 s, m/s: an upper bound of
/// 1/m plus the part of the rotation, whatever the direction.
fn response(body: &Body, pose: &Isometry3<f64>, point: &Vector3<f64>) -> f64 {
    if body.mass <= 0.0 {
        return 0.0;
    }
    let arm = (point - pose.translation.vector).norm_squared();
    let least = body.inertia.iter().copied().filter(|&moment| moment > 0.0).fold(f64::INFINITY, f64::min);
    1.0 / body.mass + arm / least
}

/// Derivatives of the force of a resistance sensor at a depth; `sticks`: the points that met are still held together;
/// range of the ray in m.
fn gains(parameters: &ResistanceParameters, depth: f64, sticks: bool, range: f64) -> Gains {
    let pressing = (parameters.contact_stiffness * depth).abs();
    let scale = if parameters.variable_friction { pressing } else { 1.0 };
    // What damps is proportional to differences between updates, like a stiffness that remembers.
    let across = if sticks { parameters.static_friction * scale + parameters.friction_damping } else { 0.0 };
    Gains {
        along: ((parameters.contact_stiffness + parameters.contact_damping) / range).abs(),
        across: across.abs(),
        damping: (parameters.dynamic_friction * scale).abs(),
    }
}

/// Force of a resistance sensor on the body that is hit, and what is remembered if the points still stick.
fn force(
    parameters: &ResistanceParameters,
    profile: Profile,
    normal: &Vector3<f64>,
    depth: f64,
    sliding: &Vector3<f64>,
    stuck: Option<&mut Stuck>,
    drift_of: impl Fn(&Stuck) -> Vector3<f64>,
) -> (Vector3<f64>, Option<Stuck>) {
    let mut pressing = normal * (parameters.contact_stiffness * depth);
    if let (Profile::Accurate, Some(stuck)) = (profile, &stuck) {
        // In the C++ program the depth before is the present one: no damping.
        pressing += normal * (parameters.contact_damping * (depth - stuck.depth));
    }
    let scale = if parameters.variable_friction { pressing.norm() } else { 1.0 };
    let mut force = pressing + sliding * (parameters.dynamic_friction * scale);
    let kept = stuck.and_then(|stuck| {
        let drift = tangential(&drift_of(stuck), normal);
        let distance = drift.norm();
        if distance == 0.0 || distance > parameters.contact_area {
            return None;
        }
        // The C++ program compares with the drift of two iterations ago.
        let before = match profile {
            Profile::Legacy => stuck.drift[1],
            Profile::Accurate => stuck.drift[0],
        };
        force += drift * (parameters.static_friction * scale) + (drift - before) * parameters.friction_damping;
        Some(Stuck { depth, drift: [drift, stuck.drift[0]], ..*stuck })
    });
    (force, kept)
}

/// The part of `drift` orthogonal to `normal`.
fn tangential(drift: &Vector3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
    let mut along = normal.cross(drift).cross(normal);
    let length = along.norm();
    if length > SHORT {
        along /= length;
    }
    along * along.dot(drift)
}

/// Number of rays that [`rays_of`] gives at most.
pub(super) fn ray_count(source: &RaySource, mesh: Option<&Mesh>) -> usize {
    match source {
        RaySource::Array(rays) => rays.len(),
        RaySource::Mesh { .. } => mesh.map_or(0, Mesh::triangle_count),
        RaySource::Parametric { resolution, .. } => (*resolution as usize).saturating_mul(*resolution as usize),
    }
}

/// The rays of a source in the sensor frame; `mesh` is that of a mesh source.
pub(super) fn rays_of(source: &RaySource, mesh: Option<&Mesh>) -> Vec<LocalRay> {
    match source {
        RaySource::Array(rays) => {
            rays.iter().map(|ray| LocalRay { start: ray.offset, direction: ray.direction }).collect()
        }
        RaySource::Mesh { .. } => mesh.map(rays_of_mesh).unwrap_or_default(),
        &RaySource::Parametric { resolution, horizontal_angle, vertical_angle, start_offset } => {
            let angle = |full: f64, i: u32| -full / 2.0 + f64::from(i) * full / f64::from(resolution - 1);
            let ray = |(i, j): (u32, u32)| {
                let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle(horizontal_angle, i))
                    * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle(vertical_angle, j));
                let direction = turn * Vector3::x();
                LocalRay { start: direction * start_offset, direction }
            };
            (0..resolution).flat_map(|i| (0..resolution).map(move |j| (i, j))).map(ray).collect()
        }
    }
}

/// One ray a triangle, from its centroid along its normal. Triangles without an area have none.
fn rays_of_mesh(mesh: &Mesh) -> Vec<LocalRay> {
    let ray = |[a, b, c]: [Vector3<f64>; 3]| {
        let direction = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        Some(LocalRay { start: (a + b + c) / 3.0, direction })
    };
    let corners = mesh.sub_meshes.iter().flat_map(|sub| {
        sub.triangles.iter().map(|triangle| triangle.map(|corner| Vector3::from(sub.vertices[corner as usize])))
    });
    corners.filter_map(ray).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters() -> ResistanceParameters {
        ResistanceParameters {
            static_friction: 3.0,
            friction_damping: 0.5,
            dynamic_friction: 2.0,
            variable_friction: true,
            contact_area: 0.1,
            contact_stiffness: 10.0,
            contact_damping: 4.0,
        }
    }

    fn stuck(drift: [Vector3<f64>; 2]) -> Stuck {
        Stuck { body: BodyId::new(0), on_parent: Vector3::zeros(), on_body: Vector3::zeros(), depth: 0.5, drift }
    }

    #[test]
    fn the_force_follows_the_formula() {
        let (normal, sliding) = (Vector3::x(), Vector3::new(0.0, 0.1, 0.0));
        let drift = Vector3::new(0.7, 0.02, 0.0);
        let before = [Vector3::new(0.0, 0.015, 0.0), Vector3::new(0.0, 0.01, 0.0)];
        let at = |profile| force(&parameters(), profile, &normal, 0.6, &sliding, Some(&mut stuck(before)), |_| drift);
        let (legacy, kept) = at(Profile::Legacy);
        // |F_n| = 6: F_y = 2·6·0.1 + 3·6·0.02 + 0.5·(0.02 − 0.01).
        assert!((legacy - Vector3::new(6.0, 1.2 + 0.36 + 0.005, 0.0)).norm() < 1e-12, "{legacy}");
        let kept = kept.unwrap();
        assert!((kept.drift[0].y - 0.02).abs() < 1e-15 && kept.drift[1] == before[0]);
        // |F_n| = 6 + 4·0.1 = 6.4, and the drift of one iteration ago.
        let (accurate, _) = at(Profile::Accurate);
        assert!((accurate - Vector3::new(6.4, 1.28 + 0.384 + 0.0025, 0.0)).norm() < 1e-12, "{accurate}");
    }

    #[test]
    fn points_that_drifted_too_far_or_not_at_all_are_forgotten() {
        for drift in [Vector3::new(0.0, 0.2, 0.0), Vector3::new(0.5, 0.0, 0.0)] {
            let (force, kept) = force(
                &parameters(),
                Profile::Legacy,
                &Vector3::x(),
                1.0,
                &Vector3::zeros(),
                Some(&mut stuck([Vector3::zeros(); 2])),
                |_| drift,
            );
            assert!(kept.is_none());
            assert_eq!(force, Vector3::new(10.0, 0.0, 0.0));
        }
    }

    #[test]
    fn a_fan_is_symmetric_and_starts_at_its_offset() {
        let source =
            RaySource::Parametric { resolution: 3, horizontal_angle: 1.0, vertical_angle: 0.4, start_offset: 0.1 };
        let rays = rays_of(&source, None);
        assert_eq!(rays.len(), 9);
        assert!((rays[4].direction - Vector3::x()).norm() < 1e-15 && (rays[4].start.x - 0.1).abs() < 1e-15);
        assert!((rays[0].direction.y + rays[6].direction.y).abs() < 1e-15);
        // Index 0 is h = −0.5, v = −0.2: Rz(h)·Ry(v)·x.
        let expected = Vector3::new(0.5f64.cos() * 0.2f64.cos(), -0.5f64.sin() * 0.2f64.cos(), 0.2f64.sin());
        assert!((rays[0].direction - expected).norm() < 1e-15, "{:?}", rays[0]);
    }
}

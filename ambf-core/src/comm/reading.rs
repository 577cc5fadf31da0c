//! What of objects changes while the simulation runs: the entries of a [`Snapshot`](super::Snapshot).

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use crate::ids::BodyId;

/// Force and torque.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wrench {
    /// N.
    pub force: Vector3<f64>,
    /// N·m.
    pub torque: Vector3<f64>,
}

/// Where simulated time and computing time went.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Timing {
    /// Simulated seconds that were never integrated because they could not be computed in time.
    pub lost_time: f64,
    /// Iterations in the last complete second, Hz; 0 in the first second.
    pub physics_frequency: f64,
    /// Cost of an iteration in the last complete second, s: 50th, 90th, 99th percentile and maximum.
    pub step_cost: [f64; 4],
    /// Sub-steps that may be due at present before time is lost.
    pub sub_step_cap: u32,
    /// Fixed steps: what an iteration may cost so that simulated time keeps up with the clock, s; 0 where intervals
    /// follow the clock.
    pub allowed_cost: f64,
}

impl Timing {
    /// Simulated time lags more and more behind the clock: with fixed steps, half of the iterations cost too much.
    pub fn is_slow(&self) -> bool {
        self.allowed_cost > 0.0 && self.step_cost[0] > self.allowed_cost
    }
}

/// What one ray of a sensor sees, or one contact of a contact sensor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RayReading {
    /// Something is hit.
    pub triggered: bool,
    /// Rays: 1 − distance / length, 0 when nothing is hit. Contacts: normal force, N.
    pub measurement: f64,
    /// Name of the rigid body that is hit, without namespace.
    pub sensed: Option<Arc<str>>,
    /// The rigid body that is hit.
    pub body: Option<BodyId>,
}

/// What touches the body of a contact sensor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ContactReading {
    /// One entry a rigid body that touches.
    pub bodies: Vec<TouchingBody>,
    /// Contact points, those of one body together and in the order of `bodies`; empty unless the sensor reports
    /// details.
    pub points: Vec<ContactPoint>,
}

impl ContactReading {
    /// Overwrites `self` with `other`, reusing the memory of `self`.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.bodies.clone_from(&other.bodies);
        self.points.clone_from(&other.points);
    }

    /// The bodies, each with its contact points.
    pub fn iter(&self) -> impl Iterator<Item = (&TouchingBody, &[ContactPoint])> {
        let mut rest = &self.points[..];
        self.bodies.iter().map(move |body| {
            let (own, others) = rest.split_at(body.points.min(rest.len()));
            rest = others;
            (body, own)
        })
    }
}

/// A rigid body that touches the body of a contact sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchingBody {
    /// Qualified identifier of the body.
    pub identifier: Arc<str>,
    /// How many of the contact points are its own.
    pub points: usize,
}

/// A point of contact.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ContactPoint {
    /// Distance of the surfaces, m; negative where they overlap.
    pub distance: f64,
    /// On the surface of the sensor's body, m, world axes.
    pub point: Vector3<f64>,
    /// Normal of unit length, world axes, from the other body to the sensor's.
    pub normal: Vector3<f64>,
}

/// Where a vehicle and its wheels are.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VehicleReading {
    /// Body frame of the chassis in the world.
    pub pose: Isometry3<f64>,
    /// (wheels x 1) pose of each wheel in the body frame of the chassis, steering and rotation included.
    pub wheels: Vec<Isometry3<f64>>,
}

/// Shape of a soft body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SoftBodyReading {
    /// Centre of mass in the world, m.
    pub center: Vector3<f64>,
    /// (nodes x 3) in the world, m.
    pub nodes: Vec<[f64; 3]>,
}

/// Where a ghost object is, and what is in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GhostReading {
    /// Pose in the world.
    pub pose: Isometry3<f64>,
    /// Qualified identifiers of the rigid bodies that penetrate it, each once.
    pub sensed: Vec<Arc<str>>,
}

/// What the picture of a camera depends on, beside its description.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraView {
    /// Pose of the camera in the world: it looks along −x, +y is right in the picture, +z up.
    pub pose: Isometry3<f64>,
    /// Pose of its parent's frame in the world.
    pub parent: Isometry3<f64>,
    /// Distance of the near clipping plane, m.
    pub near_plane: f64,
    /// Distance of the far clipping plane, m.
    pub far_plane: f64,
    /// Vertical field of view, rad.
    pub field_view_angle: f64,
    /// Width of the view, m, in orthographic projection; `None`: perspective.
    pub orthographic_view_width: Option<f64>,
    /// Distance of the eyes and focal length, m; `None`: one eye.
    pub stereo: Option<(f64, f64)>,
}

/// Where a spot light shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpotReading {
    /// Pose in the world: it shines along +x.
    pub pose: Isometry3<f64>,
    /// Half angle of its cone, rad.
    pub cutoff_angle: f64,
}

use std::ptr::NonNull;

use bullet_sys as sys;
use nalgebra::Vector3;
use slotmap::Key;

use super::{raw_pose, BodyHandle, SoftBody, SoftBodyError, SoftBodyHandle, World};

pub(super) struct OwnedSoftBody {
    raw: NonNull<sys::AmbSoft>,
    nodes: usize,
}

impl Drop for OwnedSoftBody {
    fn drop(&mut self) {
        // SAFETY: made in `make`, freed once, here, after `remove_soft_body` took it from the world if it was in there.
        unsafe { sys::amb_soft_free(self.raw.as_ptr()) }
    }
}

/// What of a soft body is near a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SoftFeatures {
    /// Nodes of the face whose centroid is nearest.
    pub face: Option<[usize; 3]>,
    /// The nearest node.
    pub node: Option<usize>,
}

impl World {
    /// Adds a soft body, built in the order of the C++ program, so that links are solved in the same order. Its shape at rest is that of
    /// the mesh.
    ///
    /// # Errors
    /// See [`SoftBodyError`]; nothing is added then.
    pub fn add_soft_body(&mut self, body: &SoftBody) -> Result<SoftBodyHandle, SoftBodyError> {
        if !self.has_soft_bodies {
            return Err(SoftBodyError::NoSoftWorld);
        }
        body.check()?;
        let owned = self.make_soft(body, &body.bending_links()?);
        // SAFETY: the soft body is alive.
        let volume = unsafe { sys::amb_soft_volume(owned.raw.as_ptr()) };
        if body.config.kPR != 0.0 && volume.abs() <= 1e-9 * body.size().powi(3) {
            return Err(SoftBodyError::NoVolume);
        }
        let raw = owned.raw.as_ptr();
        let handle = self.soft_bodies.insert(owned);
        // SAFETY: both are alive; the world removes the soft body before it frees it.
        unsafe { sys::amb_world_add_soft(self.raw.as_ptr(), raw, handle.data().as_ffi()) }
        Ok(handle)
    }

    fn make_soft(&self, body: &SoftBody, bending: &[[u32; 2]]) -> OwnedSoftBody {
        let links: Vec<_> = body.links.iter().copied().filter(|[a, b]| a != b).collect();
        let n = |length: usize| length as i32; // `check` has bounded all of them
                                               // SAFETY: the world was made for soft bodies and outlives this one; pointers and lengths come from slices, and `check` and
                                               // `bending_links` have seen that every index is that of a node.
        unsafe {
            let raw = sys::amb_soft_new(self.raw.as_ptr(), body.nodes.as_ptr().cast(), n(body.nodes.len()));
            let owned = OwnedSoftBody {
                raw: NonNull::new(raw).expect("operator new throws rather than return null"),
                nodes: body.nodes.len(),
            };
            sys::amb_soft_append_links(raw, links.as_ptr().cast(), n(links.len()), 0);
            sys::amb_soft_append_faces(raw, body.faces.as_ptr().cast(), n(body.faces.len()));
            sys::amb_soft_set_margin(raw, body.margin);
            sys::amb_soft_set_mass(raw, body.mass);
            sys::amb_soft_transform(raw, raw_pose(&body.pose).as_ptr());
            if let Some(material) = &body.material {
                sys::amb_soft_set_material(raw, material.as_ptr());
            }
            sys::amb_soft_set_config(raw, &body.config.raw());
            if body.pose_matching {
                sys::amb_soft_match_pose(raw);
            }
            sys::amb_soft_append_links(raw, bending.as_ptr().cast(), n(bending.len()), 1);
            for &node in &body.fixed_nodes {
                sys::amb_soft_fix_node(raw, node as i32);
            }
            if let Some(clusters) = body.clusters {
                sys::amb_soft_make_clusters(raw, clusters);
            }
            if body.randomize {
                sys::amb_soft_randomize(raw);
            }
            owned
        }
    }

    /// Removes a soft body with its anchors; false when it is not there.
    pub fn remove_soft_body(&mut self, handle: SoftBodyHandle) -> bool {
        let Some(body) = self.soft_bodies.remove(handle) else { return false };
        // SAFETY: the soft body is in this world; it is freed after this, and no pointer to it is left then.
        unsafe { sys::amb_world_remove_soft(self.raw.as_ptr(), body.raw.as_ptr()) }
        true
    }

    /// Number of nodes.
    pub fn soft_nodes(&self, handle: SoftBodyHandle) -> Option<usize> {
        Some(self.soft_bodies.get(handle)?.nodes)
    }

    /// Reads the positions of the nodes in the world, m, as many as `out` has place for. False when the soft body is not there.
    pub fn read_soft_nodes(&self, handle: SoftBodyHandle, out: &mut [[f64; 3]]) -> bool {
        self.read_soft(handle, out, sys::amb_soft_positions)
    }

    /// Reads the velocities of the nodes, m/s, world axes, as many as `out` has place for. False when the soft body is not there.
    pub fn read_soft_velocities(&self, handle: SoftBodyHandle, out: &mut [[f64; 3]]) -> bool {
        self.read_soft(handle, out, sys::amb_soft_velocities)
    }

    fn read_soft(
        &self,
        handle: SoftBodyHandle,
        out: &mut [[f64; 3]],
        read: unsafe extern "C" fn(*const sys::AmbSoft, *mut f64, i32),
    ) -> bool {
        let Some(body) = self.soft_bodies.get(handle) else { return false };
        let n = out.len().min(body.nodes);
        // SAFETY: the soft body is alive and has at least n nodes; `out` has place for n.
        unsafe { read(body.raw.as_ptr(), out.as_mut_ptr().cast(), n as i32) }
        true
    }

    /// Centre of mass, m, world axes; of nodes that are all fixed, their mean. A fixed node has no mass.
    pub fn soft_center(&self, handle: SoftBodyHandle) -> Option<Vector3<f64>> {
        let mut center = Vector3::zeros();
        // SAFETY: the soft body is alive; three doubles are written.
        unsafe { sys::amb_soft_center(self.raw_soft(handle)?, center.as_mut_ptr()) }
        Some(center)
    }

    /// The node that is nearest to a point (m, world axes), at most `radius` m away.
    pub fn nearest_node(&self, handle: SoftBodyHandle, point: &Vector3<f64>, radius: f64) -> Option<usize> {
        // SAFETY: the soft body is alive; three doubles are read.
        let node = unsafe { sys::amb_soft_nearest_node(self.raw_soft(handle)?, point.as_ptr(), radius) };
        usize::try_from(node).ok()
    }

    /// The face whose centroid, and the node that is nearest to a point (m, world axes), each at most `radius` m away.
    pub fn soft_features(&self, handle: SoftBodyHandle, point: &Vector3<f64>, radius: f64) -> SoftFeatures {
        let Some(raw) = self.raw_soft(handle) else { return SoftFeatures::default() };
        let mut face = [0; 3];
        // SAFETY: the soft body is alive; three doubles are read, three numbers written.
        let found = unsafe { sys::amb_soft_nearest_face(raw, point.as_ptr(), radius, face.as_mut_ptr()) } != 0;
        SoftFeatures {
            face: found.then(|| face.map(|node| node as usize)),
            node: self.nearest_node(handle, point, radius),
        }
    }

    /// The first node of a soft body whose position or velocity is not finite.
    pub fn soft_first_non_finite(&self) -> Option<(SoftBodyHandle, usize)> {
        self.soft_bodies.iter().find_map(|(handle, body)| {
            // SAFETY: the soft body is alive.
            let node = unsafe { sys::amb_soft_first_non_finite(body.raw.as_ptr()) };
            Some((handle, usize::try_from(node).ok()?))
        })
    }

    /// Brings all nodes back to where they were when the body was added, at rest. Fixed nodes stay fixed; anchors and pulls stay.
    pub fn restore_soft_body(&mut self, handle: SoftBodyHandle) {
        if let Some(raw) = self.raw_soft(handle) {
            // SAFETY: the soft body is alive and in this world.
            unsafe { sys::amb_soft_restore(raw) }
        }
    }

    /// Adds a force (N, world axes) for the next step, spread over the nodes by mass. A force that is not finite has no effect.
    pub fn apply_soft_force(&mut self, handle: SoftBodyHandle, force: &Vector3<f64>) {
        if let Some(raw) = self.raw_soft(handle).filter(|_| is_finite(force)) {
            // SAFETY: the soft body is alive; three doubles are read.
            unsafe { sys::amb_soft_apply_force(raw, force.as_ptr()) }
        }
    }

    /// Ties a node to the point `pivot` (m) of a body, in its inertial frame, as strongly as `influence` (0 to 1) says. The node no longer
    /// touches bodies; with `disable_collision` no node of the soft body touches this one. False, and no effect, when soft body, node or
    /// body is not there, when neither node nor body can move, or a number is not finite.
    pub fn add_anchor(
        &mut self,
        soft: SoftBodyHandle,
        node: usize,
        body: BodyHandle,
        pivot: &Vector3<f64>,
        influence: f64,
        disable_collision: bool,
    ) -> bool {
        let (Some(owned), Some(raw_body)) = (self.soft_bodies.get(soft), self.raw_body(body)) else { return false };
        if node >= owned.nodes || !is_finite(pivot) || !influence.is_finite() {
            return false;
        }
        let (raw, node) = (owned.raw.as_ptr(), node as i32);
        // SAFETY: the soft body is alive and has this node; the body is alive, and removing it drops its anchors; three doubles are read.
        unsafe {
            if sys::amb_soft_is_fixed(raw, node) != 0 && !self.bodies[body].dynamic {
                return false;
            }
            sys::amb_soft_add_anchor(raw, node, raw_body, pivot.as_ptr(), influence, disable_collision.into());
        }
        true
    }

    /// Position of a node in the world, m.
    pub fn soft_node(&self, handle: SoftBodyHandle, node: usize) -> Option<Vector3<f64>> {
        let body = self.soft_bodies.get(handle).filter(|body| node < body.nodes)?;
        let mut out = Vector3::zeros();
        // SAFETY: the soft body is alive and has this node; three doubles are written.
        unsafe { sys::amb_soft_position(body.raw.as_ptr(), node as i32, out.as_mut_ptr()) }
        Some(out)
    }

    /// Unties a soft body from a body. Returns how many nodes were tied.
    pub fn remove_anchors(&mut self, soft: SoftBodyHandle, body: BodyHandle) -> usize {
        let (Some(soft), Some(body)) = (self.raw_soft(soft), self.raw_body(body)) else { return 0 };
        // SAFETY: both are alive.
        unsafe { sys::amb_soft_remove_anchors(soft, body) }.max(0) as usize
    }

    /// Draws a node towards `goal` (m, world axes) before each sub-step from now on: its velocity grows by what brings it there in one
    /// sub-step, or by what brings it 10 m nearer if the way is longer than 100 m; a fixed node is put there. `None` lets go of it. False,
    /// and no effect, when soft body or node is not there or the goal is not finite.
    pub fn pull_node(&mut self, soft: SoftBodyHandle, node: usize, goal: Option<Vector3<f64>>) -> bool {
        let Some(owned) = self.soft_bodies.get(soft).filter(|soft| node < soft.nodes) else { return false };
        if goal.is_some_and(|goal| !is_finite(&goal)) {
            return false;
        }
        let goal = goal.as_ref().map_or(std::ptr::null(), |goal| goal.as_ptr());
        // SAFETY: the soft body is alive and has this node; three doubles are read or the pointer is null.
        unsafe { sys::amb_soft_pull(owned.raw.as_ptr(), node as i32, goal) }
        true
    }

    fn raw_soft(&self, handle: SoftBodyHandle) -> Option<*mut sys::AmbSoft> {
        Some(self.soft_bodies.get(handle)?.raw.as_ptr())
    }
}

fn is_finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}

use std::ptr::NonNull;

use bullet_sys as sys;
use nalgebra::Vector3;
use slotmap::Key;

use super::{raw_pose, BodyHandle, SoftBody, SoftBodyError, SoftBodyHandle, World};

pub(super) struct OwnedSoftBody {
    pub(super) raw: NonNull<sys::AmbSoft>,
    nodes: usize,
}

impl Drop for OwnedSoftBody {
    fn drop(&mut self) {
        // SAFETY: made in `make`, freed once, here, after `remove_soft_body` took it from the world if it was in there.
        unsafe { sys::amb_soft_free(self.raw.as_ptr()) }
    }
}

/// Nodes of a soft body near a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SoftFeatures {
    /// Nodes of the face whose centroid is nearest.
    pub face: Option<[usize; 3]>,
    /// The nearest node.
    pub node: Option<usize>,
}

impl World {
    /// Adds a soft body, built in the order of the C++ program, so that links are solved in the same order. Its shape
    /// at rest is that of the mesh.
    ///
    /// # Errors
    /// See [`SoftBodyError`]; nothing is added then.
    pub fn add_soft_body(&mut self, body: &SoftBody) -> Result<SoftBodyHandle, SoftBodyError> {
        let _arena = self.enter();
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
        self.structure += 1;
        // SAFETY: both are alive; the world removes the soft body before it frees it.
        unsafe { sys::amb_world_add_soft(self.raw.as_ptr(), raw, handle.data().as_ffi()) }
        Ok(handle)
    }

    fn make_soft(&self, body: &SoftBody, bending: &[[u32; 2]]) -> OwnedSoftBody {
        let links: Vec<_> = body.links.iter().copied().filter(|[a, b]| a != b).collect();
        // `check` has bounded all of them.
        let n = |length: usize| length as i32;
        // SAFETY: the world was made for soft bodies and outlives this one; pointers and lengths come from slices, and
        // `check` and `bending_links` have seen that every index is that of a node.
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
            sys::amb_soft_set_config(raw, &super::soft_body::raw(&body.config));
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
        let _arena = self.enter();
        let Some(body) = self.soft_bodies.remove(handle) else { return false };
        self.structure += 1;
        // SAFETY: the soft body is in this world; it is freed after this, and no pointer to it is left then.
        unsafe { sys::amb_world_remove_soft(self.raw.as_ptr(), body.raw.as_ptr()) }
        true
    }

    /// Number of nodes.
    pub fn soft_nodes(&self, handle: SoftBodyHandle) -> Option<usize> {
        Some(self.soft_bodies.get(handle)?.nodes)
    }

    /// Reads the positions of the nodes in the world, m, as many as `out` has place for. False when the soft body is
    /// not there.
    pub fn read_soft_nodes(&self, handle: SoftBodyHandle, out: &mut [[f64; 3]]) -> bool {
        self.read_soft(handle, out, sys::amb_soft_positions)
    }

    /// Reads the velocities of the nodes, m/s, world axes, as many as `out` has place for. False when the soft body is
    /// not there.
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

    /// The first node of a soft body whose position or velocity is not finite; the farthest node of one that has become
    /// larger than 10⁶ m: Bullet no longer moves it then. [`restore_soft_body`](Self::restore_soft_body) brings both
    /// back.
    pub fn soft_first_non_finite(&self) -> Option<(SoftBodyHandle, usize)> {
        self.soft_bodies.iter().find_map(|(handle, body)| {
            // SAFETY: the soft body is alive.
            let node = unsafe { sys::amb_soft_first_lost(body.raw.as_ptr()) };
            Some((handle, usize::try_from(node).ok()?))
        })
    }

    /// Brings a soft body back to the state in which it was added, at rest, without pulls and forces. Anchors are kept. To be
    /// followed by [`recover`](Self::recover).
    pub fn restore_soft_body(&mut self, handle: SoftBodyHandle) {
        let _arena = self.enter();
        if let Some(raw) = self.raw_soft(handle) {
            // SAFETY: the soft body is alive and in this world.
            unsafe { sys::amb_soft_restore(raw) }
        }
    }

    /// Adds a force (N, world axes) for the next step, spread over the nodes by mass. A force that is not finite has no
    /// effect.
    pub fn apply_soft_force(&mut self, handle: SoftBodyHandle, force: &Vector3<f64>) {
        if let Some(raw) = self.raw_soft(handle).filter(|_| is_finite(force)) {
            // SAFETY: the soft body is alive; three doubles are read.
            unsafe { sys::amb_soft_apply_force(raw, force.as_ptr()) }
        }
    }

    /// Anchors a node to the point `pivot` (m) of a body, in its inertial frame, with the stiffness `influence` (0 to
    /// 1). The node no longer collides with bodies; with `disable_collision` no node of the soft body collides with
    /// this one. False, and no effect, when soft body, node or body does not exist, when neither node nor body can
    /// move, or a number is not finite.
    pub fn add_anchor(
        &mut self,
        soft: SoftBodyHandle,
        node: usize,
        body: BodyHandle,
        pivot: &Vector3<f64>,
        influence: f64,
        disable_collision: bool,
    ) -> bool {
        let _arena = self.enter();
        let (Some(owned), Some(raw_body)) = (self.soft_bodies.get(soft), self.raw_body(body)) else { return false };
        if node >= owned.nodes || !is_finite(pivot) || !influence.is_finite() {
            return false;
        }
        let (raw, node) = (owned.raw.as_ptr(), node as i32);
        // SAFETY: the soft body is alive and has this node; the body is alive, and removing it drops its anchors; three
        // doubles are read.
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

    /// Removes the anchors of a soft body on a body. Returns their number.
    pub fn remove_anchors(&mut self, soft: SoftBodyHandle, body: BodyHandle) -> usize {
        let _arena = self.enter();
        let (Some(soft), Some(body)) = (self.raw_soft(soft), self.raw_body(body)) else { return 0 };
        // SAFETY: both are alive.
        unsafe { sys::amb_soft_remove_anchors(soft, body) }.max(0) as usize
    }

    /// Pulls a node towards `goal` (m, world axes) before each sub-step from now on: the distance d to the goal over
    /// the sub-step h is added to its velocity, with d = 10 m if it is longer than 100 m; a fixed node is moved to the
    /// goal. `None` ends it. False, and no effect, when soft body or node does not exist or the goal is not finite.
    pub fn pull_node(&mut self, soft: SoftBodyHandle, node: usize, goal: Option<Vector3<f64>>) -> bool {
        let _arena = self.enter();
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

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::super::tests::ball;
    use super::super::{RigidBody, Shape, SoftConfig, Solver};
    use super::*;

    /// A square cloth of n × n nodes, 0.1 m apart, from the origin along x and y, of 1 kg.
    fn cloth(n: u32) -> SoftBody {
        let node = |x: u32, y: u32| x + n * y;
        let faces: Vec<_> = (0..n - 1)
            .flat_map(|y| (0..n - 1).map(move |x| (x, y)))
            .flat_map(|(x, y)| {
                let [a, b, c, d] = [node(x, y), node(x + 1, y), node(x, y + 1), node(x + 1, y + 1)];
                [[a, b, c], [b, d, c]]
            })
            .collect();
        SoftBody {
            nodes: (0..n * n).map(|i| [0.1 * f64::from(i % n), 0.1 * f64::from(i / n), 0.0]).collect(),
            links: SoftBody::triangle_links(&faces),
            faces,
            mass: 1.0,
            margin: 0.02,
            pose: Isometry3::identity(),
            config: SoftConfig { piterations: 5, ..SoftConfig::default() },
            material: None,
            pose_matching: false,
            bending_distance: None,
            clusters: None,
            fixed_nodes: vec![],
            randomize: false,
        }
    }

    fn world() -> World {
        let mut world = World::with_soft_bodies(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world
    }

    fn run(world: &mut World, steps: u32) {
        for _ in 0..steps {
            world.step(0.001, 1, 0.001);
        }
        assert_eq!(world.soft_first_non_finite(), None);
    }

    fn nodes(world: &World, body: SoftBodyHandle) -> Vec<[f64; 3]> {
        let mut nodes = vec![[0.0; 3]; world.soft_nodes(body).unwrap()];
        assert!(world.read_soft_nodes(body, &mut nodes));
        nodes
    }

    fn velocities(world: &World, body: SoftBodyHandle) -> Vec<[f64; 3]> {
        let mut velocities = vec![[0.0; 3]; world.soft_nodes(body).unwrap()];
        assert!(world.read_soft_velocities(body, &mut velocities));
        velocities
    }

    fn node(world: &World, body: SoftBodyHandle, index: usize) -> Vector3<f64> {
        nodes(world, body)[index].into()
    }

    #[test]
    fn a_free_cloth_falls_as_a_body() {
        let mut world = world();
        let pose = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::x());
        let cloth = world.add_soft_body(&SoftBody { pose, ..cloth(5) }).unwrap();
        let start = nodes(&world, cloth);
        assert!((node(&world, cloth, 24) - (pose * nalgebra::Point3::new(0.4, 0.4, 0.0)).coords).norm() < 1e-12);
        run(&mut world, 500);
        // Semi-implicit Euler with the sub-step that Bullet rounds to single precision for soft bodies.
        let fall = Vector3::new(0.0, 0.0, -10.0 * 1e-6 * 500.0 * 501.0 / 2.0);
        for (now, start) in nodes(&world, cloth).into_iter().zip(start) {
            assert!((Vector3::from(now) - Vector3::from(start) - fall).norm() < 1e-6, "{now:?}");
        }
        let v = Vector3::from(velocities(&world, cloth)[7]);
        assert!((v - Vector3::new(0.0, 0.0, -5.0)).norm() < 1e-5, "{v}");
        let middle = (pose * nalgebra::Point3::new(0.2, 0.2, 0.0)).coords + fall;
        assert!((world.soft_center(cloth).unwrap() - middle).norm() < 1e-6);
    }

    #[test]
    fn a_restored_cloth_is_where_it_was_bit_for_bit_and_moves_as_before() {
        let mut world = world();
        let cloth = world
            .add_soft_body(&SoftBody {
                fixed_nodes: vec![0, 4],
                bending_distance: Some(2),
                randomize: true,
                ..cloth(5)
            })
            .unwrap();
        let start = nodes(&world, cloth);
        run(&mut world, 300);
        let moved = nodes(&world, cloth);
        assert_ne!(moved, start);
        world.restore_soft_body(cloth);
        assert_eq!(nodes(&world, cloth), start);
        assert_eq!(velocities(&world, cloth), vec![[0.0; 3]; 25]);
        run(&mut world, 300);
        assert_eq!(nodes(&world, cloth), moved);
    }

    #[test]
    fn a_lost_cloth_can_be_restored() {
        for far_away in [false, true] {
            let mut world = world();
            world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.3, 0.0), ..ball(0.0, 0.0) });
            let config = SoftConfig { flags: 17, ..cloth(5).config };
            let lost = world.add_soft_body(&SoftBody { config, fixed_nodes: vec![0], ..cloth(5) }).unwrap();
            let above = Isometry3::translation(0.0, 0.0, 0.1);
            let other = world.add_soft_body(&SoftBody { config, pose: above, ..cloth(5) }).unwrap();
            let falling = world.add_body(ball(1.0, 5.0));
            let culprit = world.add_body(ball(1.0, 9.0));
            let start = nodes(&world, lost);
            run(&mut world, 10);
            if far_away {
                assert!(world.pull_node(lost, 0, Some(Vector3::repeat(1e200))));
            } else {
                assert!(world.add_anchor(lost, 24, culprit, &Vector3::zeros(), 1.0, true));
                world.set_velocity(culprit, &Vector3::repeat(f64::NAN), &Vector3::zeros());
            }
            world.step(0.010, 10, 0.001);
            assert_eq!(world.soft_first_non_finite().map(|(body, _)| body), Some(lost));
            assert!(world.pull_node(lost, 0, None));
            assert!(world.remove_body(culprit));
            world.restore_soft_body(lost);
            world.restore_soft_body(other);
            world.recover();
            assert_eq!(nodes(&world, lost), start);
            run(&mut world, 2000);
            assert_eq!(node(&world, lost, 0), Vector3::zeros(), "it is still fixed");
            let [hangs, lies] = [lost, other].map(|body| world.soft_center(body).unwrap().z);
            assert!((-0.3..-0.1).contains(&hangs) && (-0.3..0.0).contains(&lies), "{hangs} {lies}");
            assert!((world.pose(falling).unwrap().translation.z + 0.2).abs() < 0.01, "the ball lies on the plane");
        }
    }

    #[test]
    fn what_cannot_be_anchored_is_refused() {
        let mut world = world();
        let cloth = world.add_soft_body(&SoftBody { fixed_nodes: vec![0], ..cloth(3) }).unwrap();
        let (wall, moving) = (world.add_body(ball(0.0, 5.0)), world.add_body(ball(1.0, 6.0)));
        let zero = Vector3::zeros();
        assert!(!world.add_anchor(cloth, 0, wall, &zero, 1.0, false), "neither can move");
        assert!(!world.add_anchor(cloth, 9, moving, &zero, 1.0, false), "there are nine nodes");
        assert!(!world.add_anchor(cloth, 1, moving, &Vector3::repeat(f64::NAN), 1.0, false));
        assert!(!world.add_anchor(cloth, 1, moving, &zero, f64::NAN, false));
        assert!(world.add_anchor(cloth, 0, moving, &(zero - Vector3::x()), 1.0, false));
        assert!(world.make_visual_only(moving), "its anchor is dropped");
        assert!(!world.add_anchor(cloth, 0, moving, &zero, 1.0, false), "it cannot move any more");
        run(&mut world, 100);
    }

    #[test]
    fn a_pulled_node_goes_to_its_goal() {
        let mut world = world();
        let cloth = world.add_soft_body(&SoftBody { fixed_nodes: vec![0], ..cloth(5) }).unwrap();
        let goal = Vector3::new(0.3, 0.3, 0.2);
        assert!(world.pull_node(cloth, 24, Some(goal)));
        run(&mut world, 500);
        let end = node(&world, cloth, 24);
        assert!((end - goal).norm() < 0.05, "{end}");
        assert!(world.pull_node(cloth, 24, None));
        run(&mut world, 500);
        let end = node(&world, cloth, 24);
        assert!((end - goal).norm() > 0.2, "let go of, but at {end}");
        assert!(world.pull_node(cloth, 0, Some(Vector3::new(0.0, 0.0, 1.0))));
        run(&mut world, 1);
        assert_eq!(node(&world, cloth, 0), Vector3::new(0.0, 0.0, 1.0), "a fixed node is put there");
        assert!(!world.pull_node(cloth, 25, Some(goal)));
        assert!(!world.pull_node(cloth, 1, Some(Vector3::repeat(f64::NAN))));
    }

    #[test]
    fn a_force_acts_in_every_sub_step_of_one_step() {
        let mut world = World::with_soft_bodies(Solver::default());
        let cloth = world.add_soft_body(&cloth(3)).unwrap();
        world.apply_soft_force(cloth, &Vector3::new(2.0, 0.0, 0.0));
        world.apply_soft_force(cloth, &Vector3::repeat(f64::NAN));
        world.step(0.010, 10, 0.001);
        world.step(0.010, 10, 0.001);
        // 2 N on 1 kg for 10 ms.
        for v in velocities(&world, cloth) {
            assert!((Vector3::from(v) - Vector3::new(0.02, 0.0, 0.0)).norm() < 1e-6, "{v:?}");
        }
    }

    #[test]
    fn rays_and_points_find_faces_and_nodes() {
        use super::super::{Ray, RayTarget};
        let mut world = World::with_soft_bodies(Solver::default());
        // Two pieces that share nothing.
        let one = cloth(3);
        let mut two = one.clone();
        two.nodes.extend(one.nodes.iter().map(|[x, y, z]| [x + 1.0, *y, *z]));
        two.faces.extend(one.faces.iter().map(|face| face.map(|node| node + 9)));
        two.links = SoftBody::triangle_links(&two.faces);
        two.config.flags = 17;
        let cloth = world.add_soft_body(&two).unwrap();
        run(&mut world, 2);
        let down = |x: f64, y: f64| Ray { from: Vector3::new(x, y, 1.0), to: Vector3::new(x, y, -1.0) };
        let mut hits = [None; 3];
        world.cast_rays(&[down(0.03, 0.03), down(1.17, 0.17), down(0.5, 0.1)], &mut hits);
        let hit = hits[0].unwrap();
        assert_eq!(hit.target, RayTarget::SoftBody(cloth));
        assert!((hit.fraction - 0.5).abs() < 1e-9 && (hit.normal - Vector3::z()).norm() < 1e-9, "{hit:?}");
        assert!((hit.point - Vector3::new(0.03, 0.03, 0.0)).norm() < 1e-9, "{hit:?}");
        assert_eq!(hits[1].map(|hit| hit.target), Some(RayTarget::SoftBody(cloth)), "the other piece");
        assert_eq!(hits[2], None, "between them");

        let features = world.soft_features(cloth, &hit.point, 0.1);
        assert_eq!(features, SoftFeatures { face: Some([0, 1, 3]), node: Some(0) });
        let features = world.soft_features(cloth, &hits[1].unwrap().point, 0.1);
        assert_eq!(features, SoftFeatures { face: Some([14, 17, 16]), node: Some(17) });
        assert_eq!(world.soft_features(cloth, &Vector3::new(0.5, 0.1, 0.0), 0.1), SoftFeatures::default());
        assert_eq!(world.soft_features(cloth, &Vector3::repeat(f64::NAN), 0.1), SoftFeatures::default());
    }

    #[test]
    fn clusters_that_have_no_inertia_do_no_harm() {
        let mut world = world();
        world.add_body(RigidBody { shape: Shape::cuboid(Vector3::new(2.0, 2.0, 0.5), 0.01), ..ball(0.0, 0.0) });
        // A chain on a line in as many clusters as nodes, without faces.
        let chain = SoftBody {
            nodes: (0..10).map(|i| [0.1 * f64::from(i), 0.0, 0.0]).collect(),
            links: (0..9).map(|i| [i, i + 1]).collect(),
            faces: vec![],
            clusters: Some(10),
            config: SoftConfig { flags: 2, ..SoftConfig::default() },
            pose: Isometry3::translation(0.0, 0.0, 0.55),
            ..cloth(2)
        };
        world.add_soft_body(&chain).unwrap();
        let triangles = SoftBody {
            clusters: Some(0),
            config: SoftConfig { flags: 0x7f, ..SoftConfig::default() },
            pose: Isometry3::translation(0.0, 0.5, 0.55),
            ..cloth(4)
        };
        world.add_soft_body(&triangles).unwrap();
        run(&mut world, 300);
    }

    #[test]
    fn pressure_needs_a_volume() {
        let mut world = world();
        let config = SoftConfig { kPR: 1.0, ..cloth(3).config };
        let pose = Isometry3::rotation(Vector3::new(1.0, 0.3, 0.2));
        let flat = SoftBody { config, pose, ..cloth(3) };
        assert_eq!(world.add_soft_body(&flat), Err(SoftBodyError::NoVolume));
        let tetrahedron = SoftBody {
            nodes: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            links: vec![[0, 1], [0, 2], [0, 3], [1, 2], [2, 3], [3, 1]],
            ..flat
        };
        assert!(world.add_soft_body(&tetrahedron).is_ok());
        run(&mut world, 100);
    }

    #[test]
    fn stale_handles_do_nothing() {
        let mut world = world();
        assert_eq!(World::new(Solver::default()).add_soft_body(&cloth(2)), Err(SoftBodyError::NoSoftWorld));
        let body = world.add_body(ball(1.0, 3.0));
        let gone = world.add_soft_body(&cloth(3)).unwrap();
        assert!(world.add_anchor(gone, 0, body, &Vector3::zeros(), 1.0, true));
        assert!(world.remove_soft_body(gone) && !world.remove_soft_body(gone));
        assert_eq!(world.soft_nodes(gone), None);
        assert!(!world.read_soft_nodes(gone, &mut [[0.0; 3]]) && !world.read_soft_velocities(gone, &mut [[0.0; 3]]));
        assert_eq!(world.soft_center(gone), None);
        assert_eq!(world.nearest_node(gone, &Vector3::zeros(), 1.0), None);
        assert_eq!(world.soft_features(gone, &Vector3::zeros(), 1.0), SoftFeatures::default());
        assert!(!world.add_anchor(gone, 0, body, &Vector3::zeros(), 1.0, false));
        assert_eq!(world.remove_anchors(gone, body), 0);
        assert!(!world.pull_node(gone, 0, None));
        world.restore_soft_body(gone);
        world.apply_soft_force(gone, &Vector3::x());
        run(&mut world, 10);
        let there = world.add_soft_body(&cloth(3)).unwrap();
        assert!(world.remove_body(body));
        assert!(!world.add_anchor(there, 0, body, &Vector3::zeros(), 1.0, false));
        let mut few = [[9.0; 3]; 2];
        assert!(world.read_soft_nodes(there, &mut few));
        assert_eq!(few[0], [0.0; 3]);
    }
}

use std::ptr::NonNull;
use std::sync::Arc;

use bullet_sys as sys;
use nalgebra::{Isometry3, Vector3};

use super::raw_pose;

/// Axis of symmetry of a cylinder, capsule or cone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// First axis.
    X,
    /// Second axis.
    Y,
    /// Third axis.
    Z,
}

/// A collision shape, lengths in m. Margins are collision margins, m.
#[derive(Debug)]
pub struct Shape {
    raw: NonNull<sys::AmbShape>,
    /// What it is a twin of.
    pattern: Option<Arc<ShapePattern>>,
}

// SAFETY: a shape is plain memory without thread affinity; it is only touched through `&Shape`, `&mut Shape` or the
// world that owns it, and `Shape` is not `Sync`, so never by two threads at once. What twins share is never written to
// (`amb_shape_twin` in shape.cpp says why), and counted by atomics.
unsafe impl Send for Shape {}

/// A collision shape that is in no world, as a pattern for those of many worlds: points, triangles and their tree are in
/// memory once.
#[derive(Debug)]
pub struct ShapePattern(Shape);

// SAFETY: through a reference nothing but `twin` is done, which reads the shape, and counts by atomics.
unsafe impl Sync for ShapePattern {}

impl From<Shape> for ShapePattern {
    fn from(shape: Shape) -> Self {
        Self(shape)
    }
}

impl ShapePattern {
    /// A shape that collides as the pattern does, to the last bit. It keeps the pattern.
    pub fn twin(self: &Arc<Self>) -> Shape {
        // SAFETY: the shape is alive and in no world: it is owned here.
        let mut twin = Shape::own(unsafe { sys::amb_shape_twin(self.0.raw()) });
        twin.pattern = Some(Arc::clone(self));
        twin
    }
}

impl Drop for Shape {
    fn drop(&mut self) {
        // SAFETY: the pointer came from a constructor of the shim and is freed once, here; a body that uses the shape
        // owns it and is freed before.
        unsafe { sys::amb_shape_free(self.raw.as_ptr()) }
    }
}

impl Shape {
    fn own(raw: *mut sys::AmbShape) -> Self {
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        Self { raw, pattern: None }
    }

    pub(super) fn raw(&self) -> *mut sys::AmbShape {
        self.raw.as_ptr()
    }

    /// Gives the shape to the shim, which frees it.
    fn into_raw(mut self) -> *mut sys::AmbShape {
        self.pattern = None;
        let raw = self.raw();
        std::mem::forget(self);
        raw
    }

    /// Touches nothing.
    pub fn empty() -> Self {
        // SAFETY: no argument to go wrong.
        Self::own(unsafe { sys::amb_shape_empty() })
    }

    /// Box with the given half extents.
    pub fn cuboid(half_extents: Vector3<f64>, margin: f64) -> Self {
        // SAFETY: the pointer gives three doubles, read before the call returns.
        Self::own(unsafe { sys::amb_shape_box(half_extents.as_ptr(), margin) })
    }

    /// Sphere. Its margin is its radius.
    pub fn sphere(radius: f64, margin: f64) -> Self {
        // SAFETY: plain numbers.
        Self::own(unsafe { sys::amb_shape_sphere(radius, margin) })
    }

    /// Cylinder of full height `height` about its centre.
    pub fn cylinder(axis: Axis, radius: f64, height: f64, margin: f64) -> Self {
        // SAFETY: plain numbers.
        Self::own(unsafe { sys::amb_shape_cylinder(axis as i32, radius, height / 2.0, margin) })
    }

    /// Capsule; `height` is the distance between the centres of its caps.
    pub fn capsule(axis: Axis, radius: f64, height: f64, margin: f64) -> Self {
        // SAFETY: plain numbers.
        Self::own(unsafe { sys::amb_shape_capsule(axis as i32, radius, height, margin) })
    }

    /// Cone of full height `height` about the middle of its height.
    pub fn cone(axis: Axis, radius: f64, height: f64, margin: f64) -> Self {
        // SAFETY: plain numbers.
        Self::own(unsafe { sys::amb_shape_cone(axis as i32, radius, height, margin) })
    }

    /// Half space below a plane at `offset` along `normal`, which need not be normalised.
    pub fn plane(normal: Vector3<f64>, offset: f64, margin: f64) -> Self {
        // SAFETY: the pointer gives three doubles, read before the call returns.
        Self::own(unsafe { sys::amb_shape_plane(normal.as_ptr(), offset, margin) })
    }

    /// Convex hull of points.
    pub fn convex_hull(vertices: &[[f64; 3]], margin: f64) -> Self {
        // SAFETY: pointer and length come from one slice and are read before the call returns.
        Self::own(unsafe { sys::amb_shape_convex_hull(vertices.as_ptr().cast(), length(vertices), margin) })
    }

    /// Convex hull of points as one of several parts of a body. Many parts of one body near many of another are less work
    /// than as hulls: parts that are too far apart to touch are found by a separating plane, before Bullet looks at them.
    /// The contacts are the same.
    pub fn convex_part(vertices: &[[f64; 3]], margin: f64) -> Self {
        // SAFETY: pointer and length come from one slice and are read before the call returns.
        Self::own(unsafe { sys::amb_shape_convex_part(vertices.as_ptr().cast(), length(vertices), margin) })
    }

    /// Triangle mesh treated as convex; `None` when a triangle refers to a vertex that does not exist, or there is
    /// none.
    pub fn convex_triangle_mesh(vertices: &[[f64; 3]], triangles: &[[u32; 3]], margin: f64) -> Option<Self> {
        Self::mesh(vertices, triangles, margin, sys::amb_shape_convex_triangle_mesh)
    }

    /// Triangle mesh as it is; `None` when a triangle refers to a vertex that does not exist, or there is none.
    pub fn concave_mesh(vertices: &[[f64; 3]], triangles: &[[u32; 3]], margin: f64) -> Option<Self> {
        Self::mesh(vertices, triangles, margin, sys::amb_shape_gimpact)
    }

    fn mesh(
        vertices: &[[f64; 3]],
        triangles: &[[u32; 3]],
        margin: f64,
        make: unsafe extern "C" fn(*const f64, i32, *const u32, i32, f64) -> *mut sys::AmbShape,
    ) -> Option<Self> {
        let in_range = triangles.iter().flatten().all(|&index| (index as usize) < vertices.len());
        if triangles.is_empty() || !in_range {
            return None;
        }
        // SAFETY: pointers and lengths come from slices, every index was just checked, and all is copied before the
        // call returns.
        Some(Self::own(unsafe {
            make(vertices.as_ptr().cast(), length(vertices), triangles.as_ptr().cast(), length(triangles), margin)
        }))
    }

    /// Several shapes, each at a pose.
    pub fn compound(children: impl IntoIterator<Item = (Shape, Isometry3<f64>)>) -> Self {
        // SAFETY: no argument to go wrong.
        let compound = Self::own(unsafe { sys::amb_shape_compound() });
        for (child, pose) in children {
            // SAFETY: both shapes are alive and different; ownership of the child passes to the compound.
            unsafe { sys::amb_shape_compound_add(compound.raw(), child.into_raw(), raw_pose(&pose).as_ptr()) }
        }
        compound
    }

    /// The only child of a compound if it is where the compound is, else the shape as it is. It collides alike, with
    /// less work, but its estimate of inertia is its own, not that of a bounding box. The bounding box of a hull, which
    /// is made for Bullet's default margin of 0.04 m, becomes that for its own margin.
    pub fn simplified(self) -> Self {
        // SAFETY: the shape is alive; ownership passes to the shim, which returns the shape that is left.
        Self::own(unsafe { sys::amb_shape_simplify(self.into_raw()) })
    }

    /// Bullet's estimate of the principal moments of inertia for `mass` kg, kg·m²; for a compound that of its bounding
    /// box. Zero for an empty shape or a plane.
    pub fn inertia(&self, mass: f64) -> Vector3<f64> {
        let mut inertia = Vector3::zeros();
        // SAFETY: the shape is alive; three doubles are written.
        unsafe { sys::amb_shape_inertia(self.raw(), mass, inertia.as_mut_ptr()) }
        inertia
    }

    /// Axis-aligned bounding box in the shape's frame: minimum and maximum.
    pub fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let mut bounds = [0.0; 6];
        // SAFETY: the shape is alive; six doubles are written.
        unsafe { sys::amb_shape_aabb(self.raw(), bounds.as_mut_ptr()) }
        (Vector3::from_column_slice(&bounds[..3]), Vector3::from_column_slice(&bounds[3..]))
    }
}

fn length<T>(slice: &[T]) -> i32 {
    i32::try_from(slice.len()).expect("a mesh has fewer than 2^31 elements: readers bound it")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bullet::tests::ball;
    use crate::bullet::{RigidBody, Solver, World};

    const TETRAHEDRON: [[f64; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

    #[test]
    fn bounds_follow_the_axis() {
        for (axis, long) in [(Axis::X, 0), (Axis::Y, 1), (Axis::Z, 2)] {
            for shape in [
                Shape::cylinder(axis, 0.1, 2.0, 0.001),
                Shape::capsule(axis, 0.1, 1.8, 0.001),
                Shape::cone(axis, 0.1, 2.0, 0.001),
            ] {
                let (low, high) = shape.bounds();
                let size = high - low;
                assert!((size[long] - 2.0).abs() < 0.01, "{size}");
                assert!(size[(long + 1) % 3] < 0.3, "{size}");
            }
        }
    }

    #[test]
    fn only_a_single_child_in_place_takes_the_place_of_a_compound() {
        let ball = || Shape::sphere(0.1, 0.0);
        let inertia = |shape: Shape| shape.simplified().inertia(1.0).x;
        let (of_ball, of_box) = (ball().inertia(1.0).x, 0.04 / 6.0);
        assert_eq!(inertia(Shape::compound([(ball(), Isometry3::identity())])), of_ball);
        assert_eq!(inertia(ball()), of_ball);
        let twice = Shape::compound([(ball(), Isometry3::identity()), (ball(), Isometry3::identity())]);
        let moved = Shape::compound([(ball(), Isometry3::translation(0.1, 0.0, 0.0))]);
        for shape in [twice, moved] {
            assert!((inertia(shape) - of_box).abs() < 1e-6);
        }
    }

    #[test]
    fn a_box_has_the_inertia_of_a_solid_box() {
        let inertia = Shape::cuboid(Vector3::new(0.25, 0.025, 0.025), 0.001).inertia(1.0);
        let expected = Vector3::new(0.005, 0.2525, 0.2525) / 12.0;
        assert!((inertia - expected).norm() < 1e-15, "{inertia}");
        assert_eq!(Shape::empty().inertia(1.0), Vector3::zeros());
    }

    #[test]
    fn meshes_with_wild_indices_are_refused() {
        assert!(Shape::concave_mesh(&TETRAHEDRON, &FACES, 0.001).is_some());
        assert!(Shape::convex_triangle_mesh(&TETRAHEDRON, &FACES, 0.001).is_some());
        assert!(Shape::concave_mesh(&TETRAHEDRON, &[[0, 1, 4]], 0.001).is_none());
        assert!(Shape::concave_mesh(&TETRAHEDRON, &[], 0.001).is_none());
    }

    #[test]
    fn a_compound_owns_its_children() {
        let mesh = Shape::concave_mesh(&TETRAHEDRON, &FACES, 0.0).unwrap();
        let compound = Shape::compound([(mesh, Isometry3::translation(1.0, 0.0, 0.0))]);
        let (low, high) = compound.bounds();
        assert!((low.x - 1.0).abs() < 1e-9 && (high.x - 2.0).abs() < 1e-9, "{low} {high}");
    }

    /// A bowl of triangles.
    fn bowl() -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        const N: u32 = 12;
        let at = |i: u32| f64::from(i) / f64::from(N) - 0.5;
        let corners = (0..=N).flat_map(|i| (0..=N).map(move |j| (at(i), at(j))));
        let vertices = corners.map(|(x, y)| [x, y, 0.8 * (x * x + y * y)]).collect();
        let cells = (0..N).flat_map(|i| (0..N).map(move |j| (N + 1) * i + j));
        let triangles = cells.flat_map(|a| [[a, a + N + 1, a + N + 2], [a, a + N + 2, a + 1]]).collect();
        (vertices, triangles)
    }

    /// What falls into the bowl, and where it is after some steps, to the last bit.
    fn fallen(bowl: Shape, stone: Shape) -> Vec<u64> {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let turned = Isometry3::new(Vector3::new(0.2, 0.05, 0.5), Vector3::new(0.3, 0.2, 0.1));
        world.add_body(RigidBody { shape: bowl, ..ball(0.0, 0.0) });
        let stone = world.add_body(RigidBody { shape: stone, pose: turned, ..ball(0.5, 0.4) });
        for _ in 0..700 {
            world.step(0.001, 1, 0.001);
        }
        let pose = world.pose(stone).expect("it is there");
        assert!((0.0..0.3).contains(&pose.translation.z), "it lies in the bowl: {pose}");
        pose.translation.vector.iter().chain(pose.rotation.coords.iter()).map(|x| x.to_bits()).collect()
    }

    /// Contact points after the first step of two rings of oblique staves, the second one at a pose.
    fn ring_contacts(stave: fn(&[[f64; 3]], f64) -> Shape, pose: Isometry3<f64>) -> usize {
        let ring = || {
            let staves = (0..12).map(|i| {
                let turn = Isometry3::rotation(Vector3::z() * (std::f64::consts::TAU * f64::from(i) / 12.0));
                let corners = [-1.0, 1.0].map(|x| [-1.0, 1.0].map(|y| [-1.0, 1.0].map(|z| [x, y, z])));
                let corners = corners.as_flattened().as_flattened().iter().map(|&[x, y, z]| {
                    let corner = nalgebra::Point3::new(0.1 + 0.01 * x, 0.03 * y, 0.02 * z);
                    (turn * corner).coords.into()
                });
                (stave(&corners.collect::<Vec<[f64; 3]>>(), 0.001), Isometry3::identity())
            });
            Shape::compound(staves)
        };
        let mut world = World::new(Solver::default());
        world.add_body(RigidBody { shape: ring(), ..ball(0.0, 0.0) });
        world.add_body(RigidBody { shape: ring(), pose, ..ball(0.5, 0.4) });
        world.step(0.001, 1, 0.001);
        world.contact_count()
    }

    #[test]
    fn parts_have_the_contacts_of_hulls() {
        let mut touching = 0;
        for i in 0..300 {
            let part = |k: f64| (f64::from(i) * k).sin();
            let place = Vector3::new(part(0.71), part(1.37), part(2.03)) * 0.15;
            let pose = Isometry3::new(place, Vector3::new(part(0.33), part(0.91), part(1.77)) * 2.0);
            let expected = ring_contacts(Shape::convex_hull, pose);
            assert_eq!(ring_contacts(Shape::convex_part, pose), expected, "{pose}");
            touching += usize::from(expected > 0);
        }
        assert!((50..250).contains(&touching), "{touching} of 300 poses touch");
    }

    #[test]
    fn twins_collide_as_their_pattern_in_any_thread() {
        let (vertices, triangles) = bowl();
        let concave = || Shape::concave_mesh(&vertices, &triangles, 0.001).expect("a mesh");
        let tetrahedron: Vec<_> = TETRAHEDRON.iter().map(|vertex| vertex.map(|x| 0.1 * x)).collect();
        type Make = fn(&[[f64; 3]]) -> Shape;
        let stones: [Make; 4] = [
            |points| Shape::convex_hull(points, 0.001),
            |points| Shape::convex_triangle_mesh(points, &FACES, 0.001).expect("a mesh"),
            |points| Shape::compound([(Shape::convex_hull(points, 0.001), Isometry3::identity())]),
            |points| {
                let hull = || Shape::convex_hull(points, 0.001);
                let both = [(hull(), Isometry3::translation(0.0, 0.1, 0.0)), (hull(), Isometry3::identity())];
                Shape::compound(both).simplified()
            },
        ];
        for stone in stones {
            let expected = fallen(concave(), stone(&tetrahedron));
            let patterns = [concave(), stone(&tetrahedron)].map(|shape| Arc::new(ShapePattern::from(shape)));
            let of_twins = || fallen(patterns[0].twin(), patterns[1].twin());
            std::thread::scope(|scope| {
                let threads: Vec<_> = (0..4).map(|_| scope.spawn(of_twins)).collect();
                threads.into_iter().for_each(|thread| assert_eq!(thread.join().unwrap(), expected));
            });
        }
    }

    #[test]
    fn twins_outlive_their_pattern_and_are_what_it_is() {
        let (vertices, triangles) = bowl();
        let shape = Shape::concave_mesh(&vertices, &triangles, 0.001).expect("a mesh");
        let (bounds, inertia) = (shape.bounds(), shape.inertia(2.0));
        let pattern = Arc::new(ShapePattern::from(shape));
        let kept = Arc::downgrade(&pattern);
        let twin = pattern.twin();
        drop(pattern);
        assert_eq!((twin.bounds(), twin.inertia(2.0)), (bounds, inertia));
        assert!(kept.upgrade().is_some());
        drop(twin);
        assert!(kept.upgrade().is_none());
    }

    #[test]
    fn a_twin_that_is_simplified_changes_no_other() {
        let hull = Shape::convex_hull(&TETRAHEDRON, 0.2);
        let bounds = hull.bounds();
        let pattern = Arc::new(ShapePattern::from(Shape::compound([(hull, Isometry3::identity())])));
        let other = pattern.twin();
        let simple = pattern.twin().simplified();
        assert_eq!(other.bounds(), pattern.twin().bounds());
        assert_eq!(simple.bounds(), bounds);
    }
}

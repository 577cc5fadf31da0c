//! Rigid bodies.

use nalgebra::{Isometry3, Vector3};

use super::common::Common;
use super::controller::CartesianController;
use super::geometry::{CollisionGeometry, Visual, VisualGeometry};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::Base;

/// A rigid body as written.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidBody {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Initial pose of the body (mesh) frame in the world. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale of meshes and joint pivots, not of primitives, offsets and inertia; positive. Default: 1.
    pub scale: f64,
    /// Mass, kg, not negative; 0: static. Default: 1, then `inertia`, `inertial_offset`, `gravity` are `None`.
    pub mass: f64,
    /// Principal moments about the axes of the inertial frame, kg·m², not negative; `None`: to be estimated.
    pub inertia: Option<Vector3<f64>>,
    /// Pose of the inertial frame in the body frame; `None`: to be estimated.
    pub inertial_offset: Option<Isometry3<f64>>,
    /// Acceleration instead of the model's or the world's gravity, m/s².
    pub gravity: Option<Vector3<f64>>,
    /// Appearance.
    pub visual: Visual,
    /// What collides.
    pub collision: CollisionGeometry,
    /// Collision margin of each child shape, m, not negative. Default: 0.001.
    pub collision_margin: f64,
    /// Whether the body stops at what it hits within a sub-step instead of passing through what is thinner than its
    /// way; `None`: the profile decides.
    pub continuous_collision: Option<bool>,
    /// Collision groups, each 0 to 999, in file order.
    pub collision_groups: Vec<u32>,
    /// Which bodies of its model it collides with, for descriptions that are not ADF; `None`: with all.
    pub collision_filter: Option<CollisionFilter>,
    /// Collides with the other bodies of its model although the model says that they don't collide with each other.
    /// Default: `false`, as in every ADF file.
    pub self_collision: bool,
    /// Contact and damping properties.
    pub surface: Surface,
    /// Cartesian controller; `None`: the key is absent.
    pub controller: Option<CartesianController>,
    /// Names of active children in the state message. Default: `false`.
    pub publish_children_names: bool,
    /// Names of active joints in the state message. Default: `true`.
    pub publish_joint_names: bool,
    /// Positions, velocities and efforts of active joints in the state message. Default: `true`.
    pub publish_joint_positions: bool,
}

/// Which bodies of a model a body collides with: those of other clusters than its own and the one that carries it, if the kind of
/// one has a bit in common with the affinity of the other; none of `excluded`, and all of `included`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CollisionFilter {
    /// Bits.
    pub kind: u32,
    /// Bits.
    pub affinity: u32,
    /// Number of the body, for `excluded`.
    pub member: u32,
    /// Number of the bodies that are fixed to each other, of which it is one.
    pub cluster: u32,
    /// Cluster that carries its own; `None`: none, or it collides with it.
    pub outer: Option<u32>,
    /// Members of the model that it never collides with; they list it, too.
    pub excluded: Vec<u32>,
    /// Members of the model that it collides with whatever else is said, if they list it, too.
    pub included: Vec<u32>,
}

/// Contact and damping properties of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Coefficient of sliding friction. Default: 0.5.
    pub static_friction: f64,
    /// Coefficient of rolling friction: a lever, m, at which a ball of any size resists to roll. `None`, not given: 0.01 in
    /// the legacy profile, as in the C++ program, 0 in the accurate one.
    pub rolling_friction: Option<f64>,
    /// Bullet's linear damping of the body: share of velocity lost in 1 s. Default: 0.04.
    pub linear_damping: f64,
    /// Bullet's angular damping of the body: share of angular velocity lost in 1 s. Default: 0.1.
    pub angular_damping: f64,
    /// Coefficient of restitution. Default: 0.1.
    pub restitution: f64,
}

impl Default for Surface {
    fn default() -> Self {
        Self {
            static_friction: 0.5,
            rolling_friction: None,
            linear_damping: 0.04,
            angular_damping: 0.1,
            restitution: 0.1,
        }
    }
}

impl RigidBody {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let mut body = Self {
            common: map.common(base),
            location: map.pose("location").unwrap_or_default(),
            scale: map.scale(),
            mass: 1.0,
            inertia: None,
            inertial_offset: None,
            gravity: None,
            visual: Visual::read(map, base),
            collision: CollisionGeometry::read(map, base),
            collision_margin: map.real_in("collision margin", Range::NotNegative).unwrap_or(0.001),
            continuous_collision: map.boolean("continuous collision"),
            collision_groups: map.collision_groups(),
            collision_filter: None,
            self_collision: false,
            surface: Surface::read(map),
            controller: map.cartesian_controller("controller"),
            publish_children_names: map.boolean("publish children names").unwrap_or(false),
            publish_joint_names: map.boolean("publish joint names").unwrap_or(true),
            publish_joint_positions: map.boolean("publish joint positions").unwrap_or(true),
        };
        if map.has("mass") {
            body.mass = map.real_in("mass", Range::NotNegative).unwrap_or(body.mass);
            body.inertia = map.vector_named("inertia", ["ix", "iy", "iz"]);
            body.inertial_offset = map.pose("inertial offset");
            body.gravity = map.vector("gravity");
        } else {
            map.warn(ProblemKind::Absent, "mass", "a mass in kg", "1 kg and an estimated inertia are used");
            let why = "the body has no `mass`";
            map.ignore(&["inertia", "inertial offset", "gravity"], why);
        }
        // What is too small to divide by would be infinite in the first step.
        let is_usable = |x: f64| x == 0.0 || x > 0.0 && x.recip().is_finite();
        if !is_usable(body.mass) {
            map.reject_numbers("mass", &[body.mass], "0 kg (static) or at least 1e-300 kg");
        }
        if let Some(inertia) = body.inertia.filter(|inertia| !inertia.iter().copied().all(is_usable)) {
            map.reject_numbers("inertia", inertia.as_slice(), "moments of 0 (no rotation) or at least 1e-300 kg·m²");
        }
        // A body of which nothing is drawn either is a frame, as the Blender add-on writes an empty.
        let keys = ["collision shape", "compound collision shape", "collision mesh"];
        let is_empty = body.visual.geometry == VisualGeometry::None && !keys.into_iter().any(|key| map.is_filled(key));
        if body.collision == CollisionGeometry::None && !is_empty {
            let expected = "a collision shape or mesh";
            let action = "the body collides with nothing";
            map.warn(ProblemKind::Absent, "collision geometry", expected, action);
        }
        let old = "the original does not read it any more";
        map.ignore(&["linear gain", "angular gain", "origin", "axis"], old);
        map.ignore(&["resistive surface", "resistive surface1"], old);
        map.finish();
        Some(body)
    }
}

impl RigidBody {
    /// A body without mass and shape, at which something else collides.
    pub(super) fn fixed(
        common: Common,
        location: Isometry3<f64>,
        surface: Surface,
        collision_groups: Vec<u32>,
    ) -> Self {
        Self {
            common,
            location,
            scale: 1.0,
            mass: 0.0,
            inertia: None,
            inertial_offset: None,
            gravity: None,
            visual: Visual::default(),
            collision: CollisionGeometry::None,
            collision_margin: 0.001,
            continuous_collision: None,
            collision_groups,
            collision_filter: None,
            self_collision: false,
            surface,
            controller: None,
            publish_children_names: false,
            publish_joint_names: true,
            publish_joint_positions: true,
        }
    }
}

impl Surface {
    pub(super) fn read(map: &Map<'_>) -> Self {
        let default = Self::default();
        let (friction, damping) = (map.map("friction"), map.map("damping"));
        let written = |map: &Map<'_>, key| {
            let value = map.real(key);
            if value.is_some_and(|value| value < 0.0) {
                let action = "it is used as it is";
                map.warn(ProblemKind::OutOfRange, key, "at least 0", action);
            }
            value
        };
        let coefficient = |map: &Map<'_>, key, default| written(map, key).unwrap_or(default);
        let surface = Self {
            static_friction: coefficient(&friction, "static", default.static_friction),
            rolling_friction: written(&friction, "rolling"),
            linear_damping: coefficient(&damping, "linear", default.linear_damping),
            angular_damping: coefficient(&damping, "angular", default.angular_damping),
            restitution: coefficient(map, "restitution", default.restitution),
        };
        friction.finish();
        damping.finish();
        surface
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::tests::{clean, read, refused};
    use super::super::{CollisionMeshKind, ControllerOutput, Model, Primitive};
    use super::*;

    fn body(keys: &str) -> RigidBody {
        let text = format!("namespace: /n/\nbodies: [BODY a b]\nBODY a b:\n  {keys}\n");
        clean::<Model>(&text).bodies.remove(0)
    }

    #[test]
    fn defaults() {
        let body = body("{mass: 2, mesh: m.stl}");
        assert_eq!(body.common.identifier, "BODY a b");
        assert_eq!((body.common.name.as_str(), body.common.namespace.as_str()), ("", "/n/"));
        assert_eq!((body.mass, body.scale, body.collision_margin), (2.0, 1.0, 0.001));
        assert_eq!((body.inertia, body.inertial_offset), (None, None));
        assert_eq!(body.continuous_collision, None);
        assert_eq!(body.surface, Surface::default());
        assert_eq!(body.controller, None);
        assert!(!body.publish_children_names && body.publish_joint_names);
        assert!(body.publish_joint_positions && !body.common.passive);
        let path = Path::new("dir/m.stl").to_path_buf();
        assert_eq!(body.visual.geometry, VisualGeometry::Mesh { path: path.clone() });
        let kind = CollisionMeshKind::ConcaveMesh;
        assert_eq!(body.collision, CollisionGeometry::Mesh { path, kind });
        assert_eq!((body.common.source.line, body.common.source.column), (3, 1));
    }

    #[test]
    fn everything_given() {
        let body = body(
            "{name: a b, mass: 1, passive: yes, publish frequency: {low: 60, high: 2000}, scale: 2,
   inertia: {ix: 1, iy: 2, iz: 3}, gravity: {x: 0, y: 0, z: 1}, namespace: sub/,
   inertial offset: {position: {x: 0, y: 0, z: 1}}, friction: {static: 1, rolling: 2},
   damping: {linear: 0.3, angular: 0.4}, restitution: 0.5, collision groups: [0, 999],
   collision margin: 0, continuous collision: yes, controller: {linear: {P: 1, D: 2}}, controller output type: velocity,
   collision shape: BOX, collision geometry: {x: 1, y: 2, z: 3},
   collision offset: {orientation: {r: 0, p: 0, y: 1}}, shape: sphere, geometry: {radius: 1}}",
        );
        assert_eq!(body.common.name, "ab");
        assert_eq!(body.common.namespace, "/n/sub/");
        assert_eq!(body.common.publish_frequency, Some((60, 2000)));
        assert_eq!(body.inertia, Some(Vector3::new(1.0, 2.0, 3.0)));
        assert_eq!(body.inertial_offset, Some(Isometry3::translation(0.0, 0.0, 1.0)));
        assert_eq!((body.collision_groups.as_slice(), body.continuous_collision), (&[0, 999][..], Some(true)));
        let controller = body.controller.expect("a controller");
        assert_eq!(controller.linear.gains.i, 0.0);
        assert_eq!(controller.linear.output, ControllerOutput::Velocity);
        assert_eq!(controller.angular.gains.p, 10.0);
        let CollisionGeometry::Primitive { primitive, offset } = body.collision else { panic!() };
        assert_eq!(primitive, Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) });
        assert_eq!(offset, Some(Isometry3::rotation(Vector3::z())));
        let sphere = VisualGeometry::Primitive(Primitive::Sphere { radius: 1.0 });
        assert_eq!(body.visual.geometry, sphere);
    }

    #[test]
    fn controller_outputs() {
        let output = |keys: &str| {
            let controller = body(&format!("{{mass: 0, mesh: a, {keys}}}")).controller;
            controller.map(|c| (c.linear.output, c.angular.output))
        };
        use ControllerOutput::{Force, Velocity};
        let block = "controller: {angular: {P: 1, D: 1}}";
        assert_eq!(output(block), Some((Velocity, Force)));
        let both = format!("{block}, controller output type: EFFORT");
        assert_eq!(output(&both), Some((Force, Force)));
        let text = "bodies: [A]\nA: {mass: 1, mesh: m, controller: {linear: {P: 1}}}\n";
        assert!(refused::<Model>(text)[0].contains("`A / controller / linear / D` is missing"));
    }

    #[test]
    fn an_empty_body_needs_no_collision_geometry() {
        for (keys, expected) in [
            ("mesh: '', collision mesh type: ''", 0),
            ("", 0),
            ("mesh: '', collision mesh: ''", 0),
            ("shape: Sphere, geometry: {radius: 1}", 1),
            ("mesh: a.stl, collision mesh: ''", 1),
            ("compound collision shape: []", 1),
        ] {
            let (model, problems) = read::<Model>(&format!("bodies: [A]\nA: {{mass: 1, {keys}}}\n"));
            assert_eq!(model.bodies[0].collision, CollisionGeometry::None, "{keys}");
            assert_eq!(problems.len(), expected, "{keys}: {problems:?}");
            assert!(problems.iter().all(|line| line.contains("`A / collision geometry` is missing")), "{problems:?}");
        }
    }

    #[test]
    fn without_mass_the_inertia_is_not_read() {
        let text = "bodies: [A]\nA: {mesh: m, inertia: {ix: 1, iy: 1, iz: 1}, gravity: 3}\n";
        let (model, problems) = read::<Model>(text);
        assert_eq!((model.bodies[0].mass, model.bodies[0].inertia), (1.0, None));
        assert_eq!(problems.len(), 3, "{problems:#?}");
    }

    #[test]
    fn what_would_break_the_physics_drops_the_body() {
        for (keys, message) in [
            ("mass: -1", "`A / mass` is `-1`, expected a finite number, at least 0; the body is dropped"),
            ("mass: .nan", "`A / mass` is `.nan`"),
            ("mass: 1, inertia: {ix: 1, iy: -1, iz: 1}", "`A / inertia` is (1, -1, 1), expected moments"),
            ("mass: 1e-310", "`A / mass` is"),
            ("mass: 1, inertia: {ix: 1, iy: 1e-310, iz: 1}", "expected moments"),
            ("mass: 1, scale: 0", "`A / scale` is `0`, expected a finite number above 0"),
            ("mass: 1, location: {position: {x: .inf, y: 0, z: 0}}", "`A / location / position / x` is `.inf`"),
            ("mass: 1, collision shape: Sphere, collision geometry: {radius: -0.0}", "collision geometry / radius"),
            ("mass: 1, collision shape: Plane, collision geometry: {normal: {x: 0, y: 0, z: 0}, offset: 1}", "normal"),
        ] {
            let text = format!("bodies: [A, B]\nA: {{mesh: m, {keys}}}\nB: {{mass: 1, mesh: m}}\n");
            let (model, problems) = read::<Model>(&text);
            assert_eq!(model.bodies.len(), 1, "{keys}");
            assert_eq!(problems.len(), 1, "{problems:#?}");
            assert!(problems[0].contains(message), "{}", problems[0]);
        }
    }
}

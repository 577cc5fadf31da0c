//! The tree of bodies → the description that ADF files have.

use std::collections::HashSet;

use nalgebra::{Isometry3, Vector3};

use super::inertia::Inertial;
use super::joint::Joint;
use super::link::Link;
use super::tree::Place;
use crate::adf::{
    CollisionGeometry, CollisionMeshKind, Common, Controller, ConvexDecomposition, Joint as AdfJoint, Part,
    ProblemKind, RigidBody, Severity, SourcePos, Surface, Visual, VisualGeometry, VisualPart,
};

/// Mass of a link that moves, kg, where neither what it carries nor what it hangs on has one, and of a body without, in ADF.
const MASS: f64 = 1.0;

/// Mass and moments of inertia of a link without a mass as a share of what it carries: too little to count, and enough to divide
/// by.
const MASSLESS: f64 = 1e-4;

/// Radius of the solid sphere whose inertia a link gets that has neither a usable one nor a collision shape, m.
const RADIUS: f64 = 0.1;

/// The bodies of a robot, in the order of their links. `self_collision`: names of the links that collide with others of
/// the robot.
pub(super) fn bodies(
    mut links: Vec<Link<'_>>,
    places: &[Place],
    namespace: &str,
    self_collision: &HashSet<&str>,
) -> Vec<RigidBody> {
    let mut shapes: Vec<Shapes> = links.iter().map(|_| Shapes::default()).collect();
    for (link, place) in links.iter_mut().zip(places) {
        let into_host = |part: Part| Part { offset: place.in_host * part.offset, ..part };
        let shapes = &mut shapes[place.host];
        shapes.collisions.extend(link.collisions.drain(..).map(into_host));
        shapes.visuals.extend(link.visuals.drain(..).map(|v| VisualPart { part: into_host(v.part), ..v }));
        shapes.self_collision |= self_collision.contains(link.name);
    }
    let mut bodies = Vec::new();
    for (index, (link, shapes)) in links.iter().zip(shapes).enumerate() {
        if places[index].host == index {
            bodies.push(body(link, &places[index], shapes, namespace));
        } else {
            let action = "the link is part of the body it is fixed to";
            link.element.warn(ProblemKind::Absent, "inertial", "", "a mass above 0", action);
        }
    }
    bodies
}

/// What a body is made of.
#[derive(Default)]
struct Shapes {
    collisions: Vec<Part>,
    visuals: Vec<VisualPart>,
    self_collision: bool,
}

fn body(link: &Link<'_>, place: &Place, shapes: Shapes, namespace: &str) -> RigidBody {
    let Shapes { collisions: parts, visuals, self_collision } = shapes;
    let inertial = link.inertial.as_ref();
    let (mass, moments) = match inertial {
        _ if place.is_static => (0.0, None),
        Some(Inertial { mass, moments, .. }) => (*mass, *moments),
        None => massless(link, place),
    };
    let sphere = parts.is_empty().then(|| solid_sphere(mass));
    // Bullet's joints would give way to the inertia of what has no mass.
    let moments = moments.or(sphere).filter(|_| !place.is_static);
    // Hulls are quick and robust where things move; what stands still may well be a room or a table.
    let kind = match place.is_static {
        true => CollisionMeshKind::ConcaveMesh,
        false => CollisionMeshKind::ConvexParts(ConvexDecomposition::default()),
    };
    let collision = if parts.is_empty() { CollisionGeometry::None } else { CollisionGeometry::Parts { parts, kind } };
    RigidBody {
        common: common("BODY", link.name, namespace, link.element.source()),
        location: place.in_world,
        scale: 1.0,
        mass,
        inertia: moments,
        inertial_offset: Some(inertial.map_or_else(Isometry3::identity, |inertial| inertial.offset)),
        gravity: None,
        visual: Visual {
            geometry: match visuals.is_empty() {
                true => VisualGeometry::None,
                false => VisualGeometry::Parts(visuals),
            },
            ..Visual::default()
        },
        collision,
        collision_margin: 0.001,
        collision_groups: vec![],
        collision_filter: None,
        self_collision,
        continuous_collision: None,
        // The format has no rolling friction.
        surface: Surface { rolling_friction: Some(0.0), ..Surface::default() },
        controller: None,
        publish_children_names: false,
        publish_joint_names: true,
        publish_joint_positions: true,
    }
}

/// Moments of the solid sphere of the radius [`RADIUS`] that stands for a body without a shape, kg·m².
fn solid_sphere(mass: f64) -> Vector3<f64> {
    Vector3::repeat(0.4 * mass * RADIUS * RADIUS)
}

/// Mass, kg, and principal moments, kg·m², of a link without a mass that moves.
fn massless(link: &Link<'_>, place: &Place) -> (f64, Option<Vector3<f64>>) {
    let Some(load) = place.load else {
        let action = format!("it has {MASS} kg, since it can move, and what it carries and hangs on has no mass");
        link.element.warn(ProblemKind::Absent, "inertial", "", "a mass above 0", &action);
        return (MASS, None);
    };
    let mass = MASSLESS * load.mass;
    let action = format!("it moves without: {mass:.1e} kg stand for nothing");
    link.element.problem(Severity::Info, ProblemKind::Absent, "inertial", "", "a mass above 0", &action);
    // Without moments of what it carries they are estimated, as those are.
    (mass, (load.moment > 0.0).then(|| Vector3::repeat(MASSLESS * load.moment)))
}

/// The joints between different bodies, in file order.
pub(super) fn joints(links: &[String], places: &[Place], joints: &[Joint<'_>], namespace: &str) -> Vec<AdfJoint> {
    let between = joints.iter().filter(|joint| places[joint.parent].host != places[joint.child].host);
    between
        .map(|joint| {
            let (parent, child) = (&places[joint.parent], &places[joint.child]);
            let in_parent = parent.in_host * joint.origin;
            let in_child = child.in_host;
            AdfJoint {
                common: Common {
                    // Joint states and commands of ROS are about the joints with a coordinate.
                    passive: !joint.kind.is_one_dof(),
                    ..common("JOINT", joint.name, namespace, joint.element.source())
                },
                kind: joint.adf_kind(),
                parent: format!("BODY {}", links[parent.host]),
                child: format!("BODY {}", links[child.host]),
                parent_pivot: in_parent.translation.vector,
                child_pivot: in_child.translation.vector,
                parent_axis: in_parent * joint.axis,
                child_axis: in_child * joint.axis,
                child_offset: 0.0,
                child_rotation: Some(in_parent.rotation * in_child.rotation.inverse()),
                joint_offset: 0.0,
                limits: joint.limits,
                enable_motor: true,
                enable_feedback: false,
                max_motor_impulse: joint.motor_impulse(),
                drive_train: joint.drive_train,
                coupling: joint.coupling(),
                damping: 0.0,
                stiffness: 0.0,
                equilibrium_point: None,
                erp: 0.1,
                cfm: 0.1,
                ignore_inter_collision: true,
                assemble: true,
                controller: Controller::default(),
            }
        })
        .collect()
}

fn common(kind: &str, name: &str, namespace: &str, source: SourcePos) -> Common {
    Common {
        identifier: format!("{kind} {name}"),
        name: name.split_whitespace().collect(),
        namespace: namespace.to_owned(),
        passive: false,
        publish_frequency: None,
        plugins: vec![],
        source,
    }
}

//! The tree of bodies → the description that ADF files have.

use std::collections::{HashMap, HashSet};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::actuator::{motor_impulse, Drives};
use super::body::{free, Bodies, Body};
use super::contact::Exceptions;
use super::geom::Geom;
use super::joint::{Joint, Kind};
use super::relation::Couplings;
use super::settings::Options;
use crate::adf::{
    CollisionFilter, CollisionGeometry, CollisionMeshKind, Common, Controller, Coupling, DriveTrain, Joint as AdfJoint,
    JointKind, Leader, Limits, Part, Primitive, ProblemKind, RigidBody, SourcePos, Surface, Visual, VisualGeometry,
    VisualPart,
};

/// Mass of a body that moves and has none, as a share of what moves with it: too little to be felt. In joints that are
/// constraints between bodies such masses would give way: more there.
const MASSLESS: f64 = 1e-8;
const MASSLESS_IN_LOOPS: f64 = 1e-4;

/// Least mass, kg, and moment, kg·m²: what can be divided by.
const LEAST: f64 = 1e-200;

/// Mass, kg, where nothing has one.
const MASS: f64 = 1.0;

/// Largest rate at which damping makes a body slower, 1/s: shares of a velocity that are lost in 1 s hardly come closer to 1.
const FASTEST_LOSS: f64 = 30.0;

/// Radius of the solid sphere whose inertia a body gets that has none and no shape either, m.
const RADIUS: f64 = 0.1;

/// What else than bodies says what becomes of them.
pub(super) struct Context<'c> {
    pub namespace: &'c str,
    pub options: &'c Options,
    /// Joints beyond those of the tree are there.
    pub has_loops: bool,
    pub exceptions: &'c Exceptions,
}

impl Context<'_> {
    /// What bodies get that have no mass or moments, as a share of those that others have.
    fn massless_share(&self) -> f64 {
        if self.has_loops {
            MASSLESS_IN_LOOPS
        } else {
            MASSLESS
        }
    }
}

/// Identifiers of a body and a joint of a name.
pub(super) fn body_identifier(name: &str) -> String {
    format!("BODY {name}")
}

pub(super) fn joint_identifier(name: &str) -> String {
    format!("JOINT {name}")
}

/// Names of bodies, or of joints, each once.
#[derive(Default)]
pub(super) struct Names(HashSet<String>);

impl Names {
    /// The wanted name, made longer until nothing has it.
    pub fn give(&mut self, wanted: String) -> String {
        let name = free(wanted, |name| self.0.contains(name));
        self.0.insert(name.clone());
        name
    }
}

/// Bodies and joints of a tree.
#[derive(Default)]
pub(super) struct Converted {
    pub body_names: Names,
    pub joint_names: Names,
    pub bodies: Vec<RigidBody>,
    /// The world is one of them.
    pub has_world: bool,
    pub joints: Vec<AdfJoint>,
    /// Bodies without a mass carry others.
    pub has_massless: bool,
}

/// What moves with a body without a mass: kg, and the sum of the least moments, kg·m².
#[derive(Clone, Copy, Default)]
struct Load {
    mass: f64,
    moment: f64,
}

pub(super) fn convert(bodies: &Bodies<'_>, context: &Context<'_>, drives: &Drives, couplings: &Couplings) -> Converted {
    let all = &bodies.all;
    // What is made below is named after what the file has.
    let mut converted = Converted {
        body_names: Names(bodies.by_name.keys().cloned().collect()),
        joint_names: Names(bodies.joints.keys().cloned().collect()),
        ..Converted::default()
    };
    let share = context.massless_share();
    let loads = loads(all, share);
    let clusters = clusters(all);
    let mut excluded: HashMap<usize, Vec<u32>> = HashMap::new();
    for &(a, b) in &context.exceptions.excluded {
        excluded.entry(a).or_default().push(b as u32);
        excluded.entry(b).or_default().push(a as u32);
    }
    // By the body and, if it is one of its own here, the geom.
    let mut included: HashMap<(usize, Option<usize>), Vec<u32>> = HashMap::new();
    for &[a, b] in &context.exceptions.pairs {
        for ((body, geom), (other, _)) in [(a, b), (b, a)] {
            let own = all[body].geoms[geom].is_apart().then_some(geom);
            included.entry((body, own)).or_default().push(other as u32);
        }
    }
    for (index, body) in all.iter().enumerate() {
        let load = loads[index];
        let together = || body.geoms.iter().filter(|geom| !geom.is_apart());
        let filter = CollisionFilter {
            kind: together().fold(0, |bits, geom| bits | geom.text.contact),
            affinity: together().fold(0, |bits, geom| bits | geom.text.affinity),
            member: index as u32,
            cluster: clusters[index] as u32,
            outer: outer_cluster(all, &clusters, index, context.options).map(|outer| outer as u32),
            excluded: excluded.remove(&index).unwrap_or_default(),
            included: included.remove(&(index, None)).unwrap_or_default(),
        };
        check_masks(body);
        let massless = ((share * load.mass).max(LEAST), Vector3::repeat((share * load.moment).max(LEAST)));
        let apart = body.geoms.iter().enumerate().filter(|(_, geom)| geom.is_apart());
        for (number, (place, geom)) in apart.enumerate() {
            // A body may be called as the geom is.
            let own = geom.name.clone().filter(|name| !converted.body_names.0.contains(name));
            let name = converted.body_names.give(own.unwrap_or_else(|| {
                let kind = if geom.is_field() { "hfield" } else { "plane" };
                format!("{}_{kind}{number}", body.name)
            }));
            let filter = CollisionFilter {
                kind: geom.text.contact,
                affinity: geom.text.affinity,
                included: included.remove(&(index, Some(place))).unwrap_or_default(),
                ..filter.clone()
            };
            converted.bodies.extend(apart_body(body, geom, &name, context, filter));
        }
        let has_rest = together().next().is_some();
        // The world itself is a body where it has shapes, or joints hold on it.
        if index > 0 || has_rest || is_held(all, 0) {
            converted.has_world |= index == 0;
            converted.bodies.push(rigid_body(body, context, filter, massless));
        }
        if index > 0 && !body.is_static {
            join(body, all, context, (drives, couplings), massless, &mut converted);
        }
    }
    converted
}

/// Whether joints of other bodies hold on the world.
fn is_held(all: &[Body<'_>], index: usize) -> bool {
    all.iter().skip(1).any(|body| body.parent == index && !body.is_static && !body.is_free())
}

/// Of each body what it carries, itself included; of those without anything that weighs, what carries them. `share`: the part of it
/// that a body without a mass gets.
fn loads(all: &[Body<'_>], share: f64) -> Vec<Load> {
    let mut loads: Vec<Load> = all
        .iter()
        .map(|body| Load { mass: body.mass.mass, moment: body.principal.map_or(0.0, |(moments, _)| moments.min()) })
        .collect();
    for index in (1..all.len()).rev() {
        let Load { mass, moment } = loads[index];
        loads[all[index].parent].mass += mass;
        loads[all[index].parent].moment += moment;
    }
    for index in 1..all.len() {
        let body = &all[index];
        if loads[index].mass > 0.0 || body.is_static {
            continue;
        }
        loads[index] = loads[body.parent];
        if all[body.parent].is_static || loads[index].mass <= 0.0 {
            let action = format!("it has {MASS} kg, since it can move, and what it carries and hangs on has no mass");
            let expected = "an `inertial`, or geoms with a mass";
            body.element.warn(ProblemKind::Absent, "inertial", "", expected, &action);
            let mass = MASS / share;
            loads[index] = Load { mass, moment: 0.4 * mass * RADIUS * RADIUS };
        }
    }
    loads
}

/// For each body the first of those that are fixed to each other.
pub(super) fn clusters(all: &[Body<'_>]) -> Vec<usize> {
    let mut clusters = vec![0; all.len()];
    for (index, body) in all.iter().enumerate().skip(1) {
        clusters[index] = if body.joints.is_empty() { clusters[body.parent] } else { index };
    }
    clusters
}

/// The cluster that carries the one of a body and does not collide with it: the world does, as in MuJoCo.
fn outer_cluster(all: &[Body<'_>], clusters: &[usize], index: usize, options: &Options) -> Option<usize> {
    let first = clusters[index];
    let outer = clusters[all[first].parent];
    (first != 0 && outer != 0 && options.filters_parents).then_some(outer)
}

/// Names what is lost where a body has geoms that collide with different ones.
fn check_masks(body: &Body<'_>) {
    let together = body.geoms.iter().filter(|geom| geom.collides() && !geom.is_apart());
    let mut masks = together.map(|geom| (geom.text.contact, geom.text.affinity));
    let Some(first) = masks.next() else { return };
    if masks.any(|other| other != first) {
        let found = "of different geoms are not the same";
        let action = "each of its geoms collides with what any of them does";
        body.element.problem(
            crate::adf::Severity::Info,
            ProblemKind::OutOfRange,
            "contype",
            found,
            "one for the body",
            action,
        );
    }
}

/// A plane is a body of its own, since nothing else is infinite, and a height field, since nothing else has hollows.
fn apart_body(
    body: &Body<'_>,
    geom: &Geom<'_>,
    name: &str,
    context: &Context<'_>,
    filter: CollisionFilter,
) -> Option<RigidBody> {
    let what = if geom.is_field() { "height field" } else { "plane" };
    if !body.is_static {
        let (found, expected) = (format!("moves, and has a {what}"), format!("{what}s of bodies that stand still"));
        let action = format!("the {what} is left out");
        body.element.error(ProblemKind::Structure, "", &found, &expected, &action);
        return None;
    }
    let pose = body.in_world * geom.part.offset;
    let mut made = still(name, body, context);
    if geom.collides() && context.options.has_contacts {
        made.collision = if geom.is_field() {
            let parts = vec![Part { geometry: geom.part.geometry.clone(), offset: pose }];
            CollisionGeometry::Parts { parts, kind: CollisionMeshKind::ConcaveMesh }
        } else {
            let normal = pose.rotation * Vector3::z();
            let primitive = Primitive::Plane { normal, offset: normal.dot(&pose.translation.vector) };
            CollisionGeometry::Primitive { primitive, offset: None }
        };
        made.surface = surface(std::iter::once(geom));
        made.collision_filter = Some(filter);
    }
    if geom.is_drawn() {
        // A plane about its own middle: that of the description has its place.
        let part = Part { geometry: geom.part.geometry.clone(), offset: pose };
        made.visual.geometry = VisualGeometry::Parts(vec![VisualPart { part, material: geom.material.clone() }]);
        made.visual.remove_duplicates = geom.is_field();
    }
    Some(made)
}

/// A body that stands still at the origin, without shapes.
fn still(name: &str, body: &Body<'_>, context: &Context<'_>) -> RigidBody {
    RigidBody {
        common: common(&body_identifier(name), name, context.namespace, body.element.source()),
        location: Isometry3::identity(),
        scale: 1.0,
        mass: 0.0,
        inertia: None,
        inertial_offset: Some(Isometry3::identity()),
        gravity: None,
        visual: Visual::default(),
        collision: CollisionGeometry::None,
        collision_margin: 0.001,
        collision_groups: vec![],
        collision_filter: None,
        self_collision: false,
        continuous_collision: None,
        surface: surface(std::iter::empty()),
        controller: None,
        publish_children_names: false,
        publish_joint_names: true,
        publish_joint_positions: true,
    }
}

fn rigid_body(
    body: &Body<'_>,
    context: &Context<'_>,
    filter: CollisionFilter,
    massless: (f64, Vector3<f64>),
) -> RigidBody {
    let mut made = still(&body.name, body, context);
    made.location = body.in_world;
    let solid = || body.geoms.iter().filter(|geom| !geom.is_apart());
    let parts: Vec<Part> = solid().filter(|geom| geom.collides()).map(|geom| geom.part.clone()).collect();
    if !parts.is_empty() && context.options.has_contacts {
        // Hulls, as in MuJoCo, also of what stands still.
        made.collision = CollisionGeometry::Parts { parts, kind: CollisionMeshKind::ConvexHull };
        made.surface = surface(solid().filter(|geom| geom.collides()));
        made.collision_filter = Some(filter);
    }
    let drawn = solid().filter(|geom| geom.is_drawn());
    let drawn: Vec<VisualPart> =
        drawn.map(|geom| VisualPart { part: geom.part.clone(), material: geom.material.clone() }).collect();
    if !drawn.is_empty() {
        made.visual.geometry = VisualGeometry::Parts(drawn);
    }
    if body.is_static {
        return made;
    }
    let sphere = |mass: f64| Vector3::repeat(0.4 * mass * RADIUS * RADIUS);
    let has_shape = made.collision != CollisionGeometry::None;
    let moments = |moments: Vector3<f64>, mass| match moments.min() > 0.0 {
        true => Some(moments),
        false if body.joints.is_empty() => Some(moments.sup(&(sphere(mass) * context.massless_share()))),
        false => (!has_shape).then(|| sphere(mass)),
    };
    match &body.principal {
        Some((given, pose)) if body.mass.mass > 0.0 || given.min() > 0.0 => {
            made.mass = if body.mass.mass > 0.0 { body.mass.mass } else { massless.0 };
            made.inertia = moments(*given, made.mass);
            made.inertial_offset = Some(*pose);
        }
        _ => {
            made.mass = massless.0;
            made.inertia = moments(massless.1, made.mass);
        }
    }
    let joint = body.joints.iter().find(|joint| joint.kind == Kind::Free && joint.drive_train.damping != 0.0);
    if let Some(joint) = joint.filter(|_| context.options.has_damping) {
        damp(&mut made, body, joint);
    }
    if body.lift != 0.0 {
        made.gravity = Some(context.options.gravity * (1.0 - body.lift));
    }
    made
}

/// Gives a body the damping of its free joint, N·s/m and N·m·s/rad. A body has shares of velocities that it loses in 1 s: those of its
/// centre of mass, about all axes the same.
fn damp(made: &mut RigidBody, body: &Body<'_>, joint: &Joint<'_>) {
    let damping = joint.drive_train.damping;
    let (Some(moments), true) = (made.inertia, body.mass.mass > 0.0) else { return joint.lose("damping", damping) };
    let rates = [damping / made.mass, damping / moments.mean()];
    let share = |rate: f64| -(-rate.min(FASTEST_LOSS)).exp_m1();
    (made.surface.linear_damping, made.surface.angular_damping) = (share(rates[0]), share(rates[1]));
    let centre = made.inertial_offset.map_or(0.0, |offset| offset.translation.vector.amax());
    let is_alike = moments.max() - moments.min() <= 1e-6 * moments.max() && centre <= 1e-9;
    if !(is_alike && rates.iter().all(|rate| *rate <= FASTEST_LOSS)) {
        let found = format!(
            "{damping}: what is lost are {:.1e}/s of the velocity and {:.1e}/s of the turning",
            rates[0], rates[1]
        );
        let expected =
            format!("at most {FASTEST_LOSS}/s of a body with equal moments and its centre of mass at its frame");
        let action =
            format!("about the centre of mass it loses that, with the mean of its moments, {FASTEST_LOSS}/s at most");
        joint.element.warn(ProblemKind::OutOfRange, "damping", &found, &expected, &action);
    }
}

/// What surfaces of a body are like: friction of the geom with the highest priority, or else the highest.
fn surface<'g>(geoms: impl Iterator<Item = &'g Geom<'g>>) -> Surface {
    let ranked = |a: &&Geom<'_>, b: &&Geom<'_>| {
        (a.text.priority, sliding(a)).partial_cmp(&(b.text.priority, sliding(b))).unwrap_or(std::cmp::Ordering::Equal)
    };
    let first = geoms.max_by(ranked);
    Surface {
        static_friction: first.map_or(1.0, sliding),
        rolling_friction: Some(first.map_or(0.0, |geom| {
            const WITH_ROLLING: f64 = 6.0;
            if geom.text.dimensions >= WITH_ROLLING {
                geom.text.friction[2].max(0.0)
            } else {
                0.0
            }
        })),
        linear_damping: 0.0,
        angular_damping: 0.0,
        restitution: 0.0,
    }
}

/// Sliding friction of a geom.
fn sliding(geom: &Geom<'_>) -> f64 {
    const WITHOUT_FRICTION: f64 = 1.0;
    if geom.text.dimensions <= WITHOUT_FRICTION {
        0.0
    } else {
        geom.text.friction[0].max(0.0)
    }
}

/// Adds the joints that lead to a body, and the bodies between several of them.
fn join(
    body: &Body<'_>,
    all: &[Body<'_>],
    context: &Context<'_>,
    (drives, couplings): (&Drives, &Couplings),
    massless: (f64, Vector3<f64>),
    converted: &mut Converted,
) {
    if body.is_free() {
        return;
    }
    let parent = &all[body.parent];
    let mut outer = (body_identifier(&parent.name), body.in_parent);
    let last = body.joints.len().saturating_sub(1);
    if body.joints.is_empty() {
        let name = converted.joint_names.give(format!("{}_fixed", body.name));
        let mut joint = adf_joint(&name, body.element.source(), JointKind::Fixed, context);
        place(&mut joint, outer, body_identifier(&body.name), None);
        converted.joints.push(joint);
        return;
    }
    converted.has_massless |= last > 0;
    for (number, joint) in body.joints.iter().enumerate() {
        let child = match number == last {
            true => body_identifier(&body.name),
            false => {
                let name = converted.body_names.give(format!("{}_{}", body.name, joint.name));
                let mut between = still(&name, body, context);
                between.common.passive = true;
                between.location = body.in_world;
                between.mass = massless.0;
                between.inertia = Some(massless.1);
                let identifier = between.common.identifier.clone();
                converted.bodies.push(between);
                identifier
            }
        };
        let mut made = adf_joint(&joint.name, joint.element.source(), joint.adf_kind(), context);
        made.common.passive = !joint.has_coordinate();
        place(&mut made, outer, child.clone(), Some(joint));
        made.limits = joint.limits.filter(|_| context.options.has_limits);
        made.drive_train = DriveTrain {
            damping: if context.options.has_damping { joint.drive_train.damping } else { 0.0 },
            friction: if context.options.has_friction { joint.drive_train.friction } else { 0.0 },
            ..joint.drive_train
        };
        if let Some(drive) = drives.get(&joint.name) {
            (made.controller, made.max_motor_impulse) = drive.apply(&mut made.drive_train);
        } else {
            made.max_motor_impulse = motor_impulse(&made.drive_train);
        }
        match couplings.get(&joint.name) {
            Some(Coupling { leaders, offset }) if leaders.is_empty() => {
                made.limits = Some(Limits { low: *offset, high: *offset });
            }
            Some(Coupling { leaders, offset }) => {
                let leader = |leader: &Leader| Leader { joint: joint_identifier(&leader.joint), ratio: leader.ratio };
                made.coupling = Some(Coupling { leaders: leaders.iter().map(leader).collect(), offset: *offset });
            }
            None => (),
        }
        let spring = (joint.stiffness > 0.0 && context.options.has_springs)
            .then(|| spring(&made, joint, &converted.joint_names.give(format!("{}_spring", joint.name))));
        converted.joints.push(made);
        converted.joints.extend(spring);
        outer = (child, Isometry3::identity());
    }
}

/// A spring beside a joint.
fn spring(joint: &AdfJoint, of: &Joint<'_>, name: &str) -> AdfJoint {
    let mut spring = joint.clone();
    spring.common.identifier = joint_identifier(name);
    spring.common.name = name.split_whitespace().collect();
    spring.common.passive = true;
    spring.kind = if of.kind == Kind::Slide { JointKind::LinearSpring } else { JointKind::TorsionSpring };
    // The lower end above the upper one: unlimited.
    spring.limits = Some(Limits { low: 1.0, high: -1.0 });
    spring.stiffness = of.stiffness;
    spring.equilibrium_point = Some(of.rest);
    (spring.drive_train, spring.coupling, spring.controller) = (DriveTrain::default(), None, Controller::default());
    spring
}

/// Puts a joint between a body, in whose frame the child stands as `outer` says, and its child.
fn place(joint: &mut AdfJoint, (parent, outer): (String, Isometry3<f64>), child: String, of: Option<&Joint<'_>>) {
    (joint.parent, joint.child) = (parent, child);
    let rest = outer * of.map_or_else(Isometry3::identity, |of| of.pose(0.0));
    let (pivot, axis) = of.map_or((Vector3::zeros(), Vector3::z()), |of| (of.position, of.axis.into_inner()));
    joint.parent_pivot = (rest * nalgebra::Point3::from(pivot)).coords;
    joint.child_pivot = pivot;
    joint.parent_axis = rest.rotation * axis;
    joint.child_axis = axis;
    joint.child_rotation = Some(rest.rotation);
}

/// A joint that is still to be placed.
pub(super) fn adf_joint(name: &str, source: SourcePos, kind: JointKind, context: &Context<'_>) -> AdfJoint {
    let mut common = common(&joint_identifier(name), name, context.namespace, source);
    // Joint states and commands of ROS are about the joints with a coordinate.
    common.passive = !matches!(kind, JointKind::Revolute | JointKind::Prismatic);
    AdfJoint {
        common,
        kind,
        parent: String::new(),
        child: String::new(),
        parent_pivot: Vector3::zeros(),
        child_pivot: Vector3::zeros(),
        parent_axis: Vector3::z(),
        child_axis: Vector3::z(),
        child_offset: 0.0,
        child_rotation: Some(UnitQuaternion::identity()),
        joint_offset: 0.0,
        limits: None,
        enable_motor: true,
        enable_feedback: false,
        max_motor_impulse: motor_impulse(&DriveTrain::default()),
        drive_train: DriveTrain::default(),
        coupling: None,
        damping: 0.0,
        stiffness: 0.0,
        equilibrium_point: None,
        erp: 0.1,
        cfm: 0.1,
        // The collision filters of the bodies say that.
        ignore_inter_collision: false,
        assemble: true,
        controller: Controller::default(),
    }
}

pub(super) fn common(identifier: &str, name: &str, namespace: &str, source: SourcePos) -> Common {
    Common {
        identifier: identifier.to_owned(),
        name: name.split_whitespace().collect(),
        namespace: namespace.to_owned(),
        passive: false,
        publish_frequency: None,
        plugins: vec![],
        source,
    }
}

/// The world as a body that joints can hold on.
pub(super) fn world(body: &Body<'_>, context: &Context<'_>) -> RigidBody {
    still(&body.name, body, context)
}

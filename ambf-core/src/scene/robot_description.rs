//! A scene as URDF, the robot description format of ROS (<https://wiki.ros.org/urdf/XML>), so that programs which know
//! ROS but not this simulator can show it.
//!
//! URDF knows one tree of links. The link `world` is its root; a link stands for each rigid body, with the body frame
//! as its frame. Of the joints, those of a spanning tree are in it: a joint that closes a loop, or gives a body a second
//! parent, is left out. A body without such a joint, and one whose joint URDF cannot say, hangs on the world where it was
//! at the start: with a fixed joint if it is static, else with a floating one.
//!
//! The frame of a URDF link lies on the axis of its joint. Where the body frame lies elsewhere, a link without mass
//! stands between: `<parent>` –joint→ `<child>__joint` –fixed→ `<child>`.
//!
//! ## Limitations
//! No cones, planes, soft bodies and wheels; colours, but no textures and shaders. URDF wants an effort and a velocity
//! with every limit: [`UNLIMITED`] stands for both.

use std::fmt::{self, Write};
use std::path::Path;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{JointType, VisualBody, VisualJoint, VisualScene};
use crate::adf::{Axis, CollisionGeometry, Material, Part, PartGeometry, Primitive, VisualGeometry};
use crate::ids::{BodyId, Table};

/// The root link.
pub const WORLD_LINK: &str = "world";

/// What a URDF holds where the scene has no limit, N, N·m, m/s, rad/s or m.
pub const UNLIMITED: f64 = 1e6;

/// A body frame this close to its joint's axis counts as on it, m.
const ON_AXIS: f64 = 1e-9;

/// A frame that is rigidly attached to a body.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkFrame {
    /// Name of the link.
    pub link: String,
    /// The body.
    pub body: BodyId,
    /// Pose of the frame in the body's inertial frame, whose pose is in the [`Snapshot`](crate::comm::Snapshot).
    pub pose: Isometry3<f64>,
}

/// A scene as URDF.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RobotDescription {
    /// The file.
    pub urdf: String,
    /// The frames of all links but the world's.
    pub frames: Vec<LinkFrame>,
}

impl RobotDescription {
    /// Describes what of `scene` is in it now. `link`: the name of the link that stands for a body, each another one and none
    /// [`WORLD_LINK`]; bodies without one, and removed ones, are left out.
    pub fn new(scene: &VisualScene, link: impl Fn(BodyId) -> Option<String>) -> Self {
        let name = |(id, body): (BodyId, &VisualBody)| if body.object.removed { None } else { link(id) };
        let links: Table<BodyId, Option<String>> = scene.bodies.entries().map(name).collect();
        let writer = Writer { scene, joints: spanning_tree(scene, &links), links };
        let mut description = Self::default();
        // Writing to memory cannot fail.
        let _ = writer.write(&mut description);
        description
    }
}

/// The joint with which each body hangs on another one: the first that leads to it and closes no loop.
fn spanning_tree<'s>(
    scene: &'s VisualScene,
    links: &Table<BodyId, Option<String>>,
) -> Table<BodyId, Option<&'s VisualJoint>> {
    let mut tree: Table<BodyId, Option<&VisualJoint>> = scene.bodies.iter().map(|_| None).collect();
    let is_there = |body: BodyId| links.get(body).is_some_and(Option::is_some);
    for joint in scene.joints.iter().filter(|joint| !joint.removed && urdf_type(joint).is_some()) {
        let is_taken = !is_there(joint.parent) || !is_there(joint.child) || tree[joint.child].is_some();
        if !is_taken && !hangs_on(&tree, joint.parent, joint.child) {
            tree[joint.child] = Some(joint);
        }
    }
    tree
}

/// Whether `body` is `ancestor`, or hangs on it.
fn hangs_on(tree: &Table<BodyId, Option<&VisualJoint>>, mut body: BodyId, ancestor: BodyId) -> bool {
    while body != ancestor {
        let Some(joint) = tree[body] else { return false };
        body = joint.parent;
    }
    true
}

/// What URDF calls a joint; `None` for one that it does not know.
fn urdf_type(joint: &VisualJoint) -> Option<&'static str> {
    match joint.kind {
        JointType::Revolute | JointType::TorsionSpring if joint.limits.is_some() => Some("revolute"),
        JointType::Revolute | JointType::TorsionSpring => Some("continuous"),
        JointType::Prismatic | JointType::LinearSpring => Some("prismatic"),
        JointType::Fixed => Some("fixed"),
        _ => None,
    }
}

struct Writer<'s> {
    scene: &'s VisualScene,
    links: Table<BodyId, Option<String>>,
    joints: Table<BodyId, Option<&'s VisualJoint>>,
}

impl Writer<'_> {
    fn write(&self, out: &mut RobotDescription) -> fmt::Result {
        writeln!(out.urdf, "<?xml version=\"1.0\"?>\n<robot name=\"ambf\">\n  <link name=\"{WORLD_LINK}\"/>")?;
        let mut used = Vec::new();
        for (id, body) in self.scene.bodies.entries() {
            let Some(link) = &self.links[id] else { continue };
            write_link(&mut out.urdf, link, body)?;
            out.frames.push(LinkFrame { link: link.clone(), body: id, pose: body.offset });
            match self.joints[id] {
                Some(joint) => self.joint(out, link, id, joint, &mut used)?,
                None => write_root(&mut out.urdf, link, body)?,
            }
        }
        out.urdf.push_str("</robot>\n");
        Ok(())
    }

    /// The joint on which `link` hangs. `used`: names of joints until now.
    fn joint(
        &self,
        out: &mut RobotDescription,
        link: &str,
        child: BodyId,
        joint: &VisualJoint,
        used: &mut Vec<String>,
    ) -> fmt::Result {
        let (Some(parent), Some(kind)) = (&self.links[joint.parent], urdf_type(joint)) else { return Ok(()) };
        let [parent_offset, child_offset] = [joint.parent, child].map(|body| self.scene.bodies[body].offset);
        let [in_parent, in_child] =
            [parent_offset.inverse() * joint.frames[0], child_offset.inverse() * joint.frames[1]];
        let to_axis = Translation3::from(in_child.translation.vector);
        // The child at coordinate 0, and from there to its joint's origin.
        let origin = in_parent * in_child.inverse() * to_axis;
        let axis = origin.rotation.inverse() * (parent_offset.rotation.inverse() * joint.axis);
        let name = free_name(&joint.name, used);
        let is_on_axis = kind == "fixed" || to_axis.vector.norm() <= ON_AXIS;
        let origin = if kind == "fixed" { in_parent * in_child.inverse() } else { origin };
        let moved = if is_on_axis { link.to_owned() } else { format!("{link}__joint") };
        let text = &mut out.urdf;
        writeln!(text, "  <joint name=\"{}\" type=\"{kind}\">", escaped(&name))?;
        writeln!(text, "    <parent link=\"{}\"/>\n    <child link=\"{}\"/>", escaped(parent), escaped(&moved))?;
        write_origin(text, 4, &origin)?;
        if kind != "fixed" {
            writeln!(text, "    <axis xyz=\"{}\"/>", Numbers(axis.as_slice()))?;
        }
        let limits = joint.limits.or((kind == "prismatic").then_some((-UNLIMITED, UNLIMITED)));
        if let Some((low, high)) = limits.filter(|_| kind != "fixed") {
            // Limits the wrong way round lock a joint; URDF has no such thing.
            let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
            let rest = format_args!("effort=\"{UNLIMITED}\" velocity=\"{UNLIMITED}\"");
            writeln!(text, "    <limit lower=\"{low}\" upper=\"{high}\" {rest}/>")?;
        }
        text.push_str("  </joint>\n");
        if is_on_axis {
            return Ok(());
        }
        writeln!(text, "  <link name=\"{}\"/>", escaped(&moved))?;
        let name = free_name(&format!("{name}__fixed"), used);
        writeln!(text, "  <joint name=\"{}\" type=\"fixed\">", escaped(&name))?;
        writeln!(text, "    <parent link=\"{}\"/>\n    <child link=\"{}\"/>", escaped(&moved), escaped(link))?;
        write_origin(text, 4, &Isometry3::from(to_axis.inverse()))?;
        text.push_str("  </joint>\n");
        out.frames.push(LinkFrame { link: moved, body: child, pose: child_offset * to_axis });
        Ok(())
    }
}

/// `name`, with a number if it is used already.
fn free_name(name: &str, used: &mut Vec<String>) -> String {
    let numbered = (2..).map(|number| format!("{name}_{number}"));
    let free = std::iter::once(name.to_owned()).chain(numbered).find(|name| !used.contains(name)).unwrap_or_default();
    used.push(free.clone());
    free
}

/// The joint of a body that hangs on no other.
fn write_root(text: &mut String, link: &str, body: &VisualBody) -> fmt::Result {
    let (link, kind) = (escaped(link), if body.mass > 0.0 { "floating" } else { "fixed" });
    writeln!(text, "  <joint name=\"{link}__{WORLD_LINK}\" type=\"{kind}\">")?;
    writeln!(text, "    <parent link=\"{WORLD_LINK}\"/>\n    <child link=\"{link}\"/>")?;
    write_origin(text, 4, &(body.initial_pose * body.offset))?;
    text.push_str("  </joint>\n");
    Ok(())
}

fn write_link(text: &mut String, link: &str, body: &VisualBody) -> fmt::Result {
    writeln!(text, "  <link name=\"{}\">", escaped(link))?;
    let inertial = body.offset.inverse();
    if body.mass > 0.0 {
        text.push_str("    <inertial>\n");
        write_origin(text, 6, &inertial)?;
        let [x, y, z] = body.inertia.into();
        writeln!(text, "      <mass value=\"{}\"/>", body.mass)?;
        writeln!(text, "      <inertia ixx=\"{x}\" ixy=\"0\" ixz=\"0\" iyy=\"{y}\" iyz=\"0\" izz=\"{z}\"/>")?;
        text.push_str("    </inertial>\n");
    }
    if let Some(visual) = body.visual().filter(|visual| visual.visible) {
        for (part, material) in visual_parts(&visual.geometry, visual.material.as_ref(), body.scale) {
            write_part(text, "visual", &part, material)?;
        }
    }
    for part in body.collision().map(|of| collision_parts(of, &inertial, body.scale)).unwrap_or_default() {
        write_part(text, "collision", &part, None)?;
    }
    text.push_str("  </link>\n");
    Ok(())
}

/// What is drawn, in the body frame. `scale`: of the body's own mesh.
fn visual_parts<'v>(
    geometry: &'v VisualGeometry,
    material: Option<&'v Material>,
    scale: f64,
) -> Vec<(Part, Option<&'v Material>)> {
    let primitive = |primitive: &Primitive, offset: &Isometry3<f64>| {
        let geometry = PartGeometry::Primitive(primitive.clone());
        (Part { geometry, offset: *offset }, material)
    };
    match geometry {
        VisualGeometry::None => Vec::new(),
        VisualGeometry::Primitive(shape) => vec![primitive(shape, &Isometry3::identity())],
        VisualGeometry::Compound(parts) => parts.iter().map(|part| primitive(&part.primitive, &part.offset)).collect(),
        VisualGeometry::Mesh { path } => vec![(whole_mesh(path, scale), material)],
        VisualGeometry::Parts(parts) => {
            parts.iter().map(|part| (part.part.clone(), part.material.as_ref().or(material))).collect()
        }
    }
}

/// What collides, in the body frame. `inertial`: pose of the inertial frame there; `scale`: of the body's own mesh.
fn collision_parts(geometry: &CollisionGeometry, inertial: &Isometry3<f64>, scale: f64) -> Vec<Part> {
    let primitive = |primitive: &Primitive, offset: Isometry3<f64>| Part {
        geometry: PartGeometry::Primitive(primitive.clone()),
        offset,
    };
    match geometry {
        CollisionGeometry::None => Vec::new(),
        CollisionGeometry::Primitive { primitive: shape, offset } => {
            vec![primitive(shape, offset.unwrap_or(*inertial))]
        }
        CollisionGeometry::Compound(parts) => {
            parts.iter().map(|part| primitive(&part.primitive, part.offset)).collect()
        }
        CollisionGeometry::Mesh { path, .. } => vec![whole_mesh(path, scale)],
        CollisionGeometry::Parts { parts, .. } => parts.clone(),
    }
}

fn whole_mesh(path: &Path, scale: f64) -> Part {
    let geometry = PartGeometry::Mesh { path: path.to_owned(), scale: Vector3::repeat(scale) };
    Part { geometry, offset: Isometry3::identity() }
}

fn write_part(text: &mut String, element: &str, part: &Part, material: Option<&Material>) -> fmt::Result {
    for (offset, geometry) in geometries(part) {
        writeln!(text, "    <{element}>")?;
        write_origin(text, 6, &offset)?;
        writeln!(text, "      <geometry>{geometry}</geometry>")?;
        if let Some(Material { diffuse: [r, g, b], alpha, .. }) = material {
            // The name is what programs tell materials apart by.
            let colour = Numbers(&[*r, *g, *b, *alpha]).to_string();
            writeln!(text, "      <material name=\"{colour}\"><color rgba=\"{colour}\"/></material>")?;
        }
        writeln!(text, "    </{element}>")?;
    }
    Ok(())
}

/// The elements of URDF that a part is made of, at their poses; none for a shape that URDF does not know.
fn geometries(part: &Part) -> Vec<(Isometry3<f64>, String)> {
    let one = |geometry: String| vec![(part.offset, geometry)];
    let along = |axis: &Axis| part.offset * turn_of_axis(*axis);
    let cylinder = |radius: f64, length: f64| format!("<cylinder radius=\"{radius}\" length=\"{length}\"/>");
    let sphere = |radius: f64| format!("<sphere radius=\"{radius}\"/>");
    match &part.geometry {
        PartGeometry::Primitive(Primitive::Box { size }) => {
            one(format!("<box size=\"{}\"/>", Numbers(size.as_slice())))
        }
        PartGeometry::Primitive(Primitive::Sphere { radius }) => one(sphere(*radius)),
        PartGeometry::Primitive(Primitive::Cylinder { radius, height, axis }) => {
            vec![(along(axis), cylinder(*radius, *height))]
        }
        PartGeometry::Primitive(Primitive::Capsule { radius, height, axis }) => {
            let shaft = (height - 2.0 * radius).max(0.0);
            let cap = |side: f64| (along(axis) * Translation3::new(0.0, 0.0, side * shaft / 2.0), sphere(*radius));
            vec![(along(axis), cylinder(*radius, shaft)), cap(-1.0), cap(1.0)]
        }
        PartGeometry::Primitive(Primitive::Cone { .. } | Primitive::Ellipsoid { .. } | Primitive::Plane { .. }) => {
            Vec::new()
        }
        // URDF has meshes in files only.
        PartGeometry::Triangles(_) => Vec::new(),
        PartGeometry::Mesh { path, scale } => {
            let path = std::path::absolute(path).unwrap_or_else(|_| path.clone());
            let file = path.display().to_string();
            one(format!("<mesh filename=\"file://{}\" scale=\"{}\"/>", escaped(&file), Numbers(scale.as_slice())))
        }
    }
}

/// Turns z, the axis of URDF's cylinders, to `axis`.
fn turn_of_axis(axis: Axis) -> UnitQuaternion<f64> {
    use std::f64::consts::FRAC_PI_2;
    match axis {
        Axis::X => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2),
        Axis::Y => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2),
        Axis::Z => UnitQuaternion::identity(),
    }
}

fn write_origin(text: &mut String, indent: usize, pose: &Isometry3<f64>) -> fmt::Result {
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    let xyz = Numbers(pose.translation.vector.as_slice());
    writeln!(text, "{:indent$}<origin xyz=\"{xyz}\" rpy=\"{}\"/>", "", Numbers(&[roll, pitch, yaw]))
}

/// Numbers with blanks between.
struct Numbers<'n>(&'n [f64]);

impl fmt::Display for Numbers<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, number) in self.0.iter().enumerate() {
            let separator = if index == 0 { "" } else { " " };
            write!(f, "{separator}{number}")?;
        }
        Ok(())
    }
}

/// Text inside an attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

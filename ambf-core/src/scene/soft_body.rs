//! Live soft bodies: a mesh whose vertices are nodes and whose edges are links.

use nalgebra::{Isometry3, Vector3};

use super::build::Builder;
use super::commands::{Commanded, Commands};
use super::list::SceneObject;
use super::{Identity, ObjectType, Scene};
use crate::adf;
use crate::bullet::{self, SoftBodyHandle, World};
use crate::comm::{ObjectKind, Snapshot, SoftBodyCommand, SoftBodyReading};
use crate::control::Profile;
use crate::ids::SoftBodyId;
use crate::mesh::{Mesh, SubMesh};

/// A soft body of a [`Scene`](super::Scene).
#[derive(Debug)]
pub struct SoftBody {
    /// Names and publishing rates.
    pub identity: Identity,
    /// Total mass, kg.
    pub mass: f64,
    /// Number of nodes.
    pub nodes: usize,
    pub(crate) handle: SoftBodyHandle,
}

impl SceneObject for SoftBody {
    type Id = SoftBodyId;
    type Saved = ();
    const TYPE: ObjectType = ObjectType::SoftBody;
    const RANK: u8 = 4;

    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn add_all(builder: &mut Builder<'_>, model: &adf::Model) {
        for soft in &model.soft_bodies {
            builder.with_plugins(Self::TYPE, &soft.common, |builder| builder.add_soft_body(soft));
        }
    }

    fn kind(&self, id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::SoftBody(id, self.mass))
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        let nodes = vec![[0.0; 3]; self.nodes];
        snapshot.soft_bodies.push(SoftBodyReading { nodes, ..SoftBodyReading::default() });
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        let reading = &mut snapshot.soft_bodies[id];
        reading.center = scene.world.soft_center(self.handle).unwrap_or_default();
        scene.world.read_soft_nodes(self.handle, &mut reading.nodes);
    }

    fn commands(id: Self::Id) -> Option<Box<dyn Commands>> {
        Some(Commanded::new(id, |Scene { soft_bodies, world, .. }, id, command, _| {
            soft_bodies[id].apply_command(world, command);
        }))
    }

    /// Not turned, at its centre of mass.
    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        scene.world.soft_center(self.handle).map(|center| Isometry3::from_parts(center.into(), Default::default()))
    }

    /// x, y, z of each node.
    fn values(&self, scene: &Scene, out: &mut Vec<f64>) {
        let mut nodes = vec![[0.0; 3]; self.nodes];
        self.read_nodes(&scene.world, &mut nodes);
        out.extend(nodes.as_flattened());
    }

    /// In its first shape, at rest.
    fn reset(Scene { soft_bodies, world, .. }: &mut Scene, id: Self::Id) {
        world.restore_soft_body(soft_bodies[id].handle);
    }

    fn save(&self) {
        // All fields by name, so that no new one is forgotten. Nothing is kept beside Bullet.
        let Self { identity: _, mass: _, nodes: _, handle: _ } = self;
    }

    fn restore(&mut self, _saved: &()) {}
}

impl SoftBody {
    /// Executes a command; it acts in the next update.
    pub(crate) fn apply_command(&self, world: &mut World, command: &SoftBodyCommand) {
        if command.force != Vector3::zeros() {
            world.apply_soft_force(self.handle, &command.force);
        }
    }

    /// Positions of the nodes in the world, m, as many as `out` has place for.
    pub fn read_nodes(&self, world: &World, out: &mut [[f64; 3]]) {
        world.read_soft_nodes(self.handle, out);
    }
}

/// A soft body as it is made in Bullet, and remarks on what of the description could not be used.
///
/// The legacy profile keeps the habits of the C++ program: only the last part of the mesh counts, a vertex that became
/// node 0 cannot be fixed by its number in the file, and the list of fixed nodes ends at the first number that is too
/// large. Coefficients beyond the ranges of Bullet, which the reader named, are used as they are.
pub(super) fn describe(soft: &adf::SoftBody, mesh: &Mesh, profile: Profile) -> (bullet::SoftBody, Vec<String>) {
    let mut remarks = Vec::new();
    let filled: Vec<&SubMesh> = mesh.sub_meshes.iter().filter(|sub| !sub.vertices.is_empty()).collect();
    let used: &[&SubMesh] = match (profile, filled.as_slice()) {
        (Profile::Legacy, [rest @ .., last]) if !rest.is_empty() => {
            remarks.push(format!("only the last of the {} parts of its mesh is simulated", filled.len()));
            std::slice::from_ref(last)
        }
        (_, all) => all,
    };
    let (mut nodes, mut faces, mut lines, mut fixed_nodes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut file_nodes = std::collections::BTreeMap::new();
    for sub in used {
        // Positions are finite and indices in range: the readers see to it.
        let first = nodes.len() as u32;
        nodes.extend_from_slice(&sub.vertices);
        faces.extend(sub.triangles.iter().map(|face| face.map(|node| node + first)));
        lines.extend(sub.lines.iter().map(|link| link.map(|node| node + first)));
        file_nodes.extend(sub.file_vertices.iter().map(|&(vertex, node)| (vertex, node + first)));
    }
    for &number in &soft.config.fixed_nodes {
        let node = if file_nodes.is_empty() { Some(number) } else { file_nodes.get(&number).copied() };
        match node {
            Some(0) if profile == Profile::Legacy && !file_nodes.is_empty() => remarks.push(format!(
                "`fixed nodes`: vertex {number} stays free, as in the C++ program, because the first face begins with it; the \
                 accurate profile fixes it"
            )),
            Some(node) if (node as usize) < nodes.len() => fixed_nodes.push(node),
            _ => {
                remarks
                    .push(format!("`fixed nodes`: there is no vertex {number}; it and those after it are left free"));
                break;
            }
        }
    }
    let mut links = bullet::SoftBody::triangle_links(&faces);
    links.extend(lines);
    let bounded;
    let described = match profile {
        Profile::Legacy => &soft.config,
        Profile::Accurate => {
            bounded = soft.config.within_range();
            &bounded
        }
    };
    let body = bullet::SoftBody {
        nodes,
        links,
        faces,
        mass: soft.mass,
        margin: soft.collision_margin,
        pose: soft.location,
        config: described.numbers,
        material: described.material.map(|material| [material.kLST, material.kAST, material.kVST]),
        pose_matching: soft.config.pose_matching,
        bending_distance: soft.config.bending_constraint,
        clusters: soft.config.clusters,
        fixed_nodes,
        randomize: soft.randomize_constraints,
    };
    (body, remarks)
}

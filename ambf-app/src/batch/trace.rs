//! Trace files: what the state of a scene was, step by step, as comma-separated values.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use ambf_core::bullet::BodyKinematics;
use ambf_core::ids::{BodyId, JointId, Table};
use ambf_core::sim::Simulation;
use nalgebra::Isometry3;

/// Trace files of bodies, joints and soft bodies. Only what exists in the scene is written.
pub struct TraceWriter {
    bodies: Option<BufWriter<File>>,
    joints: Option<BufWriter<File>>,
    soft_nodes: Option<BufWriter<File>>,
    names: Table<BodyId, String>,
    /// Bodies in order of their qualified identifiers.
    order: Vec<BodyId>,
    /// Joints in order of their qualified identifiers.
    joint_order: Vec<JointId>,
    states: Table<BodyId, BodyKinematics>,
    /// Room for the nodes of the largest soft body.
    nodes: Vec<[f64; 3]>,
    full: bool,
}

impl TraceWriter {
    /// Creates `PREFIX_bodies.csv`, `PREFIX_joints.csv` and `PREFIX_softnodes.csv` with their headings. `names` names
    /// each body; with `full` the pose of the inertial frame at the end of the step is written too.
    ///
    /// # Errors
    /// When a file or its folder cannot be made.
    pub fn create(prefix: &Path, simulation: &Simulation, names: Vec<String>, full: bool) -> io::Result<Self> {
        let scene = simulation.scene();
        if let Some(folder) = prefix.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder)?;
        }
        let create = |suffix: &str, heading: &str, wanted: bool| -> io::Result<Option<BufWriter<File>>> {
            if !wanted {
                return Ok(None);
            }
            let mut path = prefix.as_os_str().to_owned();
            path.push(suffix);
            let mut writer = BufWriter::new(File::create(path)?);
            writeln!(writer, "{heading}")?;
            Ok(Some(writer))
        };
        let mut heading = String::from("sim_step,sim_time,body,px,py,pz,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz");
        if full {
            heading += ",cx,cy,cz,cqx,cqy,cqz,cqw";
        }
        let mut order: Vec<BodyId> = scene.bodies.ids().collect();
        order.sort_by_cached_key(|&body| (scene.bodies[body].identity.key(), body));
        let mut joint_order: Vec<JointId> = scene.joints.ids().collect();
        joint_order.sort_by_key(|&joint| &scene.joints[joint].key);
        Ok(Self {
            bodies: create("_bodies.csv", &heading, !scene.bodies.is_empty())?,
            joints: create(
                "_joints.csv",
                "sim_step,sim_time,joint,type,parent,child,position,velocity,effort",
                !scene.joints.is_empty(),
            )?,
            soft_nodes: create(
                "_softnodes.csv",
                "sim_step,sim_time,softbody,node,x,y,z",
                !scene.soft_bodies.is_empty(),
            )?,
            nodes: vec![[0.0; 3]; scene.soft_bodies.iter().map(|soft| soft.nodes).max().unwrap_or(0)],
            states: Table::filled(BodyKinematics::default(), scene.bodies.len()),
            names: names.into(),
            order,
            joint_order,
            full,
        })
    }

    /// Writes the present state as the row of step `step`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&mut self, simulation: &Simulation, step: u64) -> io::Result<()> {
        let (scene, time) = (simulation.scene(), simulation.sim_time());
        if let Some(out) = &mut self.bodies {
            scene.world.read_bodies(self.states.as_mut_slice());
            for &id in &self.order {
                let (body, state) = (&scene.bodies[id], &self.states[id]);
                write!(out, "{step},{time:?},{}", self.names[id])?;
                write_pose(out, &state.body_pose(&body.inertial_offset_inverse))?;
                write_numbers(out, &state.linear_velocity)?;
                write_numbers(out, &state.angular_velocity)?;
                if self.full {
                    let pose = scene.world.bodies().get(id.index()).and_then(|&handle| scene.world.pose(handle));
                    write_pose(out, &pose.unwrap_or_else(Isometry3::identity))?;
                }
                writeln!(out)?;
            }
        }
        if let Some(out) = &mut self.joints {
            for joint in self.joint_order.iter().map(|&joint| &scene.joints[joint]) {
                let (parent, child) = (&self.names[joint.parent], &self.names[joint.child]);
                write!(out, "{step},{time:?},{},{},{parent},{child}", joint.name, joint.joint_type.code())?;
                write_numbers(out, &[joint.position, joint.velocity, joint.effort])?;
                writeln!(out)?;
            }
        }
        if let Some(out) = &mut self.soft_nodes {
            for soft in &scene.soft_bodies {
                let nodes = &mut self.nodes[..soft.nodes];
                soft.read_nodes(&scene.world, nodes);
                for (number, node) in nodes.iter().enumerate() {
                    write!(out, "{step},{time:?},{},{number}", soft.identity.communication_name())?;
                    write_numbers(out, node)?;
                    writeln!(out)?;
                }
            }
        }
        Ok(())
    }

    /// Makes sure that all is on disk.
    ///
    /// # Errors
    /// When the rest cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        let files = [self.bodies.as_mut(), self.joints.as_mut(), self.soft_nodes.as_mut()];
        files.into_iter().flatten().try_for_each(BufWriter::flush)
    }
}

fn write_pose(out: &mut impl Write, pose: &Isometry3<f64>) -> io::Result<()> {
    write_numbers(out, pose.translation.vector.as_slice())?;
    write_numbers(out, pose.rotation.coords.as_slice())
}

/// 17 significant digits: they give the same number back.
fn write_numbers(out: &mut impl Write, numbers: &[f64]) -> io::Result<()> {
    numbers.iter().try_for_each(|number| write!(out, ",{number:.16e}"))
}

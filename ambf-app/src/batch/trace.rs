//! Trace files: what the state of a scene was, step by step, as comma-separated values.

use std::io::{self, Write};
use std::path::Path;

use ambf_core::bullet::BodyKinematics;
use ambf_core::files::{folder_for, Output, WriteError};
use ambf_core::ids::{BodyId, JointId, Table};
use ambf_core::sim::Simulation;
use nalgebra::Isometry3;

/// Trace files of bodies, joints and soft bodies. Only what exists in the scene is written.
pub struct TraceWriter {
    bodies: Option<Output>,
    joints: Option<Output>,
    soft_nodes: Option<Output>,
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
    pub fn create(prefix: &Path, simulation: &Simulation, names: Vec<String>, full: bool) -> Result<Self, WriteError> {
        let scene = simulation.scene();
        folder_for(prefix)?;
        let create = |suffix: &str, heading: &str, wanted: bool| -> Result<Option<Output>, WriteError> {
            if !wanted {
                return Ok(None);
            }
            let mut path = prefix.as_os_str().to_owned();
            path.push(suffix);
            let mut output = Output::create(Path::new(&path))?;
            output.add(|out| writeln!(out, "{heading}"))?;
            Ok(Some(output))
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
    pub fn write(&mut self, simulation: &Simulation, step: u64) -> Result<(), WriteError> {
        let Self { bodies, joints, soft_nodes, names, order, joint_order, states, nodes, full } = self;
        let (scene, time) = (simulation.scene(), simulation.sim_time());
        if let Some(out) = bodies {
            scene.world.read_bodies(states.as_mut_slice());
            out.add(|out| {
                for &id in &*order {
                    let (body, state) = (&scene.bodies[id], &states[id]);
                    write!(out, "{step},{time:?},{}", names[id])?;
                    write_pose(out, &state.body_pose(&body.inertial_offset_inverse))?;
                    write_numbers(out, &state.linear_velocity)?;
                    write_numbers(out, &state.angular_velocity)?;
                    if *full {
                        let pose = scene.world.bodies().get(id.index()).and_then(|&handle| scene.world.pose(handle));
                        write_pose(out, &pose.unwrap_or_else(Isometry3::identity))?;
                    }
                    writeln!(out)?;
                }
                Ok(())
            })?;
        }
        if let Some(out) = joints {
            out.add(|out| {
                for joint in joint_order.iter().map(|&joint| &scene.joints[joint]) {
                    let (parent, child) = (&names[joint.parent], &names[joint.child]);
                    write!(out, "{step},{time:?},{},{},{parent},{child}", joint.name, joint.joint_type.code())?;
                    write_numbers(out, &[joint.position, joint.velocity, joint.effort])?;
                    writeln!(out)?;
                }
                Ok(())
            })?;
        }
        if let Some(out) = soft_nodes {
            out.add(|out| {
                for soft in &scene.soft_bodies {
                    let nodes = &mut nodes[..soft.nodes];
                    soft.read_nodes(&scene.world, nodes);
                    for (number, node) in nodes.iter().enumerate() {
                        write!(out, "{step},{time:?},{},{number}", soft.identity.communication_name())?;
                        write_numbers(out, node)?;
                        writeln!(out)?;
                    }
                }
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Completes the files, each whatever becomes of the others; what failed.
    pub fn finish(self) -> Vec<WriteError> {
        let files = [self.bodies, self.joints, self.soft_nodes];
        files.into_iter().flatten().filter_map(|file| file.finish().err()).collect()
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

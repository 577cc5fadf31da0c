//! The physics side of input devices: their end-effectors, before and after each step.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector3;

use super::Simulation;
use crate::adf;
use crate::comm::{CartesianCommandType, JointCommandType, RigidBodyCommand};
use crate::control::Profile;
use crate::device::host::{BodyState, CameraSum, Controls, DeviceHost, Followed, Hand, PhysicsEnd};
use crate::device::law::{joint_target, Drive, EffectorInput, EndEffector, Grip};
use crate::scene::{EndEffectorParts, PreparedEndEffector, Scene};

/// All devices of a simulation.
pub(super) struct Devices {
    list: Vec<Coupled>,
    controls: Arc<Controls>,
    /// Period of the physics loop, s.
    pub nominal_dt: f64,
    paused: bool,
    resets: u64,
}

/// A device and what it moves.
struct Coupled {
    entry: adf::InputDevice,
    end: PhysicsEnd,
    law: EndEffector,
    followed: Followed,
    /// The newest that the device has said.
    hand: Hand,
    cameras_moved: CameraSum,
    parts: EndEffectorParts,
    is_there: bool,
    /// Bodies that are not gripped, by index: the root link and all below it.
    own: Vec<bool>,
    /// Joints below the root link.
    joints: Vec<usize>,
    /// Proximity sensors of the root link.
    sensors: Vec<usize>,
    /// Paired cameras.
    cameras: Vec<usize>,
}

impl Coupled {
    /// Finds its parts in a scene that has changed.
    fn find_parts(&mut self, scene: &Scene) {
        let root = self.parts.root;
        self.is_there = !scene.models[scene.bodies[root].identity.model].removed;
        self.own = vec![false; scene.bodies.len()];
        self.own[root] = true;
        let below = scene.graph.descendants(root);
        below.iter().for_each(|below| self.own[below.body] = true);
        self.joints = below.iter().map(|below| below.joint).collect();
        self.sensors = scene.proximity_sensors(root).collect();
        self.cameras = scene.paired_cameras(&self.entry.pair_cameras).0;
    }

    fn tell(&mut self, scene: &Scene, paused: bool, resets: u64) {
        let root = &scene.bodies[self.parts.root];
        let (linear_velocity, angular_velocity) = scene.world.velocity(root.handle).unwrap_or_default();
        self.end.state.write(BodyState {
            stamp: Some(Instant::now()),
            pose: root.pose(&scene.world),
            linear_velocity,
            angular_velocity,
            is_there: self.is_there,
            camera: self.cameras.first().map(|&camera| scene.cameras[camera].placed.pose.rotation),
            paused,
            resets,
        });
    }
}

impl Simulation {
    /// Builds or finds an end-effector for every device of `host` that has none yet, in the order of their entries. One sentence for each
    /// that got none, and what was dropped, replaced or guessed; a device without an end-effector is closed.
    pub fn add_devices(&mut self, host: &mut DeviceHost) -> Vec<String> {
        let mut said = Vec::new();
        for (index, entry) in host.waiting() {
            let prepared = PreparedEndEffector::read(&entry);
            let known = self.scene.counts();
            let (parts, notes) = match prepared.and_then(|prepared| self.scene.add_end_effector(prepared)) {
                Ok(added) => added,
                Err(why) => {
                    said.push(format!("{}: device `{}` is left out: {why}", entry.source, entry.identifier));
                    host.release(index);
                    continue;
                }
            };
            said.extend(notes.iter().map(ToString::to_string));
            let missing = self.scene.paired_cameras(&entry.pair_cameras).1;
            said.extend(missing.iter().map(|why| format!("{}: device `{}`: {why}", entry.source, entry.identifier)));
            let end = host.couple(index, parts.initial_pose);
            let hand = *{ end }.hand.peek_output_buffer();
            let _ = hand;
            let _ = known;
        }
        said
    }
}

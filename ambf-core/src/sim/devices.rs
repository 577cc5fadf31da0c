//! The physics side of input devices: what their end-effectors do before each step, and the states that go to devices after it.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::{Isometry3, Vector3};

use super::physics::Physics;
use super::session::{recorded_path, Entry, Recorder};
use super::Simulation;
use crate::adf;
use crate::comm::{CartesianCommandType, JointCommandType, RigidBodyCommand};
use crate::control::Profile;
use crate::device::host::{BodyState, CameraSum, Controls, DeviceHost, Followed, Hand, PhysicsEnd};
use crate::device::law::{
    joint_target, Drive, EffectorInput, EffectorOutput, EndEffector, GainChange, Grip, UNKNOWN_OPENING,
};
use crate::ids::{BodyId, CameraId, JointId, SensorId, Table};
use crate::scene::{EndEffectorParts, PreparedEndEffector, Scene};

/// A gripper switches tools when it comes below this, and again after it was above the other: 0 is closed, 1 open.
const CLOSES_BELOW: f64 = 0.3;
const OPENS_ABOVE: f64 = 0.5;

/// All devices of a simulation.
pub(super) struct Devices {
    list: Vec<Coupled>,
    controls: Arc<Controls>,
    /// Period of the physics loop, s.
    nominal_dt: f64,
    paused: bool,
    resets: u64,
    /// The switch as it was noted last.
    noted_assist: Option<bool>,
}

/// A device and what it moves.
struct Coupled {
    entry: adf::InputDevice,
    end: PhysicsEnd,
    law: EndEffector,
    followed: Followed,
    cameras_moved: CameraSum,
    parts: EndEffectorParts,
    is_there: bool,
    /// Whether its gripper, or the button that stands for one, is closed; `None`: not seen yet.
    is_closed: Option<bool>,
    /// (bodies x 1) what is not gripped: the root link and all below it.
    own: Table<BodyId, bool>,
    /// Joints below the root link.
    joints: Vec<JointId>,
    /// Proximity sensors of the root link.
    sensors: Vec<SensorId>,
    /// Paired cameras.
    cameras: Vec<CameraId>,
    /// What the device told when that was noted last.
    noted: Option<Hand>,
}

impl Coupled {
    fn new(entry: adf::InputDevice, end: PhysicsEnd, parts: EndEffectorParts) -> Self {
        Self {
            law: EndEffector::new(&entry, &parts.controller),
            entry,
            end,
            followed: Followed::default(),
            cameras_moved: CameraSum::default(),
            parts,
            is_there: true,
            is_closed: None,
            own: Table::default(),
            joints: Vec::new(),
            sensors: Vec::new(),
            cameras: Vec::new(),
            noted: None,
        }
    }

    /// Entry of the device itself.
    fn entry(&self) -> Entry<'static> {
        let adf::InputDevice { source, identifier, .. } = &self.entry;
        Entry::Device { file: recorded_path(&source.file), line: source.line.into(), name: identifier.clone() }
    }

    /// Notes what the device, the `index`-th, tells, as far as that is new.
    fn note_hand(&mut self, index: usize, hand: &Hand, physics: &mut Physics) {
        if physics.recorder.is_none() {
            return;
        }
        let bits = |hand: &Hand| {
            let pose = hand.reference;
            let [a, b, c] = pose.translation.vector.into();
            let [d, e, f, g] = pose.rotation.coords.into();
            [a, b, c, d, e, f, g, hand.gripper].map(f64::to_bits)
        };
        let before = self.noted.replace(*hand);
        if before.is_none_or(|before| bits(&before) != bits(hand)) {
            physics.note(&Entry::Hand { device: index, reference: hand.reference, gripper: hand.gripper });
        }
        let (ticks, moved) = hand.cameras.parts();
        if before.map_or(0, |before| before.cameras.parts().0) != ticks {
            physics.note(&Entry::HandCameras { device: index, ticks, moved });
        }
    }

    /// Finds its parts in a scene that has changed.
    fn find_parts(&mut self, scene: &Scene) {
        let root = self.parts.root;
        // Also when the model is added again.
        self.is_there &= !scene.body_is_gone(root);
        self.own = Table::filled(false, scene.bodies.len());
        self.own[root] = true;
        let below = scene.graph.descendants(root);
        below.iter().for_each(|below| self.own[below.body] = true);
        self.joints = below.iter().map(|below| below.joint).collect();
        self.sensors = scene.proximity_sensors(root).collect();
        self.cameras = scene.paired_cameras(&self.entry.pair_cameras).0;
    }

    fn tell(&mut self, scene: &Scene, paused: bool, resets: u64) {
        let root = &scene.bodies[self.parts.root];
        self.end.state.write(BodyState {
            stamp: Some(Instant::now()),
            pose: root.pose(&scene.world),
            is_there: self.is_there,
            camera: self.cameras.first().map(|&camera| scene.cameras[camera].attached.pose.rotation),
            paused,
            resets,
        });
    }

    fn move_cameras(&mut self, scene: &mut Scene, hand: &Hand) {
        if let Some(motion) = hand.cameras.since(&self.cameras_moved) {
            self.cameras_moved = hand.cameras;
            for &camera in &self.cameras {
                let pose: &mut Isometry3<f64> = &mut scene.cameras[camera].attached.pose;
                *pose = motion.applied(pose);
            }
        }
    }

    /// Takes hold of the nearest foreign body that a sensor of the root link sees, or releases it.
    fn grip(&self, scene: &mut Scene, grip: Grip) {
        let Scene { actuators, sensors, bodies, world, .. } = scene;
        let actuator = &mut actuators[self.parts.actuator];
        match grip {
            Grip::Attach if !actuator.is_actuated() => {
                let foreign = |body: BodyId| !self.own[body];
                let hits = self.sensors.iter().filter_map(|&sensor| sensors[sensor].nearest_body(bodies, foreign));
                if let Some((body, _)) = hits.min_by(|a, b| a.1.total_cmp(&b.1)) {
                    actuator.hold(world, bodies, body, None);
                }
            }
            Grip::Release if actuator.is_actuated() => actuator.release(world, bodies),
            Grip::Attach | Grip::Release | Grip::Leave => (),
        }
    }

    /// Whether its gripper has been closed since this was asked the last time. One that is closed when it is first seen has
    /// not been closed.
    fn has_closed(&mut self, gripper: f64) -> bool {
        if self.is_closed.is_none() && gripper == UNKNOWN_OPENING {
            return false;
        }
        let limit = if self.is_closed == Some(true) { OPENS_ABOVE } else { CLOSES_BELOW };
        let is_closed = gripper < limit;
        self.is_closed.replace(is_closed) == Some(false) && is_closed
    }

    fn drive_root(&self, physics: &mut Physics, output: &EffectorOutput) {
        let Scene { bodies, world, profile, .. } = &mut physics.scene;
        let root = self.parts.root;
        let body = &mut bodies[root];
        if !body.is_dynamic() {
            return;
        }
        let force = |drive: Option<Drive>| match drive {
            Some(Drive::Force(u)) => u,
            _ => Vector3::zeros(),
        };
        let velocity = |drive: Option<Drive>| match drive {
            Some(Drive::Velocity(u)) => Some(u),
            _ => None,
        };
        world.apply_wrench(body.handle, &force(output.linear), &force(output.angular));
        match (velocity(output.linear), velocity(output.angular)) {
            (None, None) => (),
            (Some(linear_velocity), Some(angular_velocity)) if *profile == Profile::Accurate => {
                // Held in all sub-steps.
                let command = RigidBodyCommand::velocity(linear_velocity, angular_velocity);
                if body.set_target(world, &command) {
                    physics.targets.bodies.push(root);
                }
            }
            (linear, angular) => {
                // The other half goes on as it is.
                let (linear_now, angular_now) = world.velocity(body.handle).unwrap_or_default();
                world.set_velocity(body.handle, &linear.unwrap_or(linear_now), &angular.unwrap_or(angular_now));
            }
        }
    }

    fn drive_joints(&self, physics: &mut Physics, opening: f64) {
        for &joint in &self.joints {
            let limits = physics.scene.joints[joint].limits;
            let target = limits.and_then(|limits| joint_target(opening, limits.low, limits.high));
            if let Some(target) = target {
                physics.apply_joint_command(joint, JointCommandType::Position, target);
            }
        }
    }
}

impl Devices {
    /// What controllers of end-effectors remember. Devices are in hands and stay where they are.
    pub fn save(&self) -> Vec<EndEffector> {
        self.list.iter().map(|device| device.law.clone()).collect()
    }

    pub fn restore(&mut self, saved: &[EndEffector]) {
        for (device, law) in self.list.iter_mut().zip(saved) {
            device.law.clone_from(law);
        }
    }

    fn tell(&mut self, scene: &Scene) {
        for device in &mut self.list {
            device.tell(scene, self.paused, self.resets);
        }
    }

    /// Drives all end-effectors in the update of `physics` that has begun.
    fn drive(&mut self, physics: &mut Physics, notices: &mut Vec<String>) {
        let switches = self.controls.switches();
        if physics.recorder.is_some()
            && self.noted_assist.replace(switches.gripping_assist) != Some(switches.gripping_assist)
        {
            physics.note(&Entry::Assist { on: switches.gripping_assist });
        }
        for (index, device) in self.list.iter_mut().enumerate().filter(|(_, device)| device.is_there) {
            let Coupled { law, followed, .. } = device;
            followed.catch_up(&self.controls, |change| {
                physics.note(&Entry::Gain { device: index, quantity: change.quantity as u8, step: change.step });
                if let Some(value) = law.change(change) {
                    let (name, label) = (&device.entry.identifier, change.quantity.label());
                    notices.push(format!("{name}: {label} = {value:.4}"));
                }
            });
            let hand = *device.end.hand.read();
            device.note_hand(index, &hand, physics);
            device.move_cameras(&mut physics.scene, &hand);
            let Scene { bodies, world, .. } = &physics.scene;
            let root = &bodies[device.parts.root];
            let output = device.law.tick(&EffectorInput {
                reference: hand.reference,
                pose: root.pose(world),
                gripper: hand.gripper,
                dt: physics.time.interval,
                nominal_dt: self.nominal_dt,
                force_active: root.control == CartesianCommandType::Force,
                gripping_assist: switches.gripping_assist,
            });
            device.grip(&mut physics.scene, output.grip);
            if device.has_closed(hand.gripper) {
                physics.scene.switch_tools_of(device.parts.root);
            }
            device.drive_root(physics, &output);
            if let Some(opening) = output.joints {
                device.drive_joints(physics, opening);
            }
        }
    }
}

impl Simulation {
    /// Builds or finds an end-effector for each device of `host` that has none yet, in the order of their entries; to
    /// be called before the simulation runs. Says what was dropped, replaced or guessed, and which devices got none:
    /// these are closed.
    pub fn add_devices(&mut self, host: &mut DeviceHost) -> Vec<String> {
        let mut said = Vec::new();
        for (index, entry) in host.waiting() {
            let place = format!("{}: device `{}`", entry.source, entry.identifier);
            let controls = Arc::clone(host.controls());
            match self.add_device(entry, &controls, |pose| host.couple(index, pose)) {
                Ok(notes) => said.extend(notes),
                Err(why) => {
                    said.push(format!("{place} is left out: {why}"));
                    host.release(index);
                }
            }
        }
        said
    }

    /// Builds or finds the end-effector of a device; what was dropped, replaced or guessed. `couple` gets the pose that its
    /// root link starts from, body frame in the world.
    ///
    /// # Errors
    /// Why there is none; the scene is as it was.
    pub(super) fn add_device(
        &mut self,
        entry: adf::InputDevice,
        controls: &Arc<Controls>,
        couple: impl FnOnce(Isometry3<f64>) -> PhysicsEnd,
    ) -> Result<Vec<String>, String> {
        let place = format!("{}: device `{}`", entry.source, entry.identifier);
        let prepared = PreparedEndEffector::read(&entry)?;
        let (parts, notes) = self.physics.scene.add_end_effector(prepared)?;
        let mut said: Vec<String> = notes.into_iter().collect();
        said.extend(
            self.physics.scene.paired_cameras(&entry.pair_cameras).1.iter().map(|why| format!("{place}: {why}")),
        );
        let added_model = parts.model;
        let device = Coupled::new(entry, couple(parts.initial_pose), parts);
        self.physics.note(&device.entry());
        let nominal_dt = self.physics.sub_step;
        let devices = self.devices.get_or_insert_with(|| {
            Box::new(Devices {
                list: Vec::new(),
                controls: Arc::clone(controls),
                nominal_dt,
                paused: false,
                resets: 0,
                noted_assist: None,
            })
        });
        devices.list.push(device);
        self.grow();
        if let Some(link) = &mut self.link {
            // The actuator that grips has no State.
            link.hub.add_objects(self.physics.scene.objects_of(|model| Some(model) == added_model));
            link.follow_scene(&self.physics.scene, &self.physics.wrenches);
        }
        Ok(said)
    }

    /// Notes the devices that there are at the beginning of a recording.
    pub(super) fn note_devices(&mut self, recorder: &mut Recorder) {
        let Some(devices) = &mut self.devices else { return };
        devices.list.iter().for_each(|device| recorder.note(&device.entry()));
        recorder.note(&Entry::Period { period: devices.nominal_dt });
        devices.noted_assist = None;
        // A replay sees the hands for the first time.
        devices.list.iter_mut().for_each(|device| (device.noted, device.is_closed) = (None, None));
    }

    /// The root link of the `device`-th device, which its hand moves; `None`: there is no such device.
    pub fn device_root(&self, device: usize) -> Option<BodyId> {
        Some(self.devices.as_ref()?.list.get(device)?.parts.root)
    }

    /// Changes a gain of the `device`-th device as its user did; false if there is no such device.
    pub(super) fn change_device_gain(&mut self, device: usize, change: GainChange) -> bool {
        let Some(coupled) = self.devices.as_mut().and_then(|devices| devices.list.get_mut(device)) else {
            return false;
        };
        self.physics.note(&Entry::Gain { device, quantity: change.quantity as u8, step: change.step });
        coupled.law.change(change);
        true
    }

    /// Finds the parts of end-effectors in a scene that has changed.
    pub(super) fn find_device_parts(&mut self) {
        if let Some(devices) = &mut self.devices {
            devices.list.iter_mut().for_each(|device| device.find_parts(&self.physics.scene));
            devices.tell(&self.physics.scene);
        }
    }

    /// Says how often updates are made, Hz: for gains that shrink in longer steps.
    pub(super) fn set_nominal_frequency(&mut self, frequency: f64) {
        self.set_device_period(1.0 / frequency);
    }

    /// Says how long an update is meant to be, s.
    pub(super) fn set_device_period(&mut self, period: f64) {
        if let Some(devices) = &mut self.devices {
            self.physics.note(&Entry::Period { period });
            devices.nominal_dt = period;
        }
    }

    /// Tells devices at once that no steps are made, or that they are again.
    pub(super) fn pause_devices(&mut self, paused: bool) {
        if let Some(devices) = self.devices.as_mut().filter(|devices| devices.paused != paused) {
            devices.paused = paused;
            devices.tell(&self.physics.scene);
        }
    }

    /// Tells devices that bodies were reset.
    pub(super) fn reset_devices(&mut self) {
        if let Some(devices) = &mut self.devices {
            devices.resets += 1;
            devices.list.iter_mut().for_each(|device| device.law.reset());
            devices.tell(&self.physics.scene);
        }
    }

    /// Tells devices what the step made of their end-effectors.
    pub(super) fn tell_devices(&mut self) {
        if let Some(devices) = &mut self.devices {
            devices.tell(&self.physics.scene);
        }
    }

    /// Drives all end-effectors in the update that has begun.
    pub(super) fn drive_devices(&mut self) {
        if let Some(devices) = &mut self.devices {
            devices.drive(&mut self.physics, &mut self.notices);
        }
    }
}

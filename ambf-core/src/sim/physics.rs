//! A scene in time: what a step does to it, and what commands do to it.

use std::borrow::Cow;
use std::time::{Duration, Instant, SystemTime};

use nalgebra::Vector3;

use super::session::{Entry, Recorder, SinceStart, HASH_INTERVAL};
use super::targets::ActiveTargets;
use crate::adf::VolumeTool;
use crate::bullet::{JointReadings, PlausibleBounds};
use crate::comm::{CartesianCommandType, JointCommandType, RigidBodyCommand, Snapshot, Timing, Wrench};
use crate::control::Profile;
use crate::ids::{BodyId, JointId, Table, VolumeId};
use crate::scene::{Scene, VolumeError};

/// Simulated time.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Time {
    /// Sum of all intervals, s.
    pub sim_time: f64,
    /// Sum of the intervals since the start or the latest reset of the world, s: the time of controllers, so that what
    /// they do does not depend on how long it ran before.
    pub since_start: f64,
    /// Interval of the latest update, s.
    pub interval: f64,
    /// Interval before that, s: what object updates and controllers get.
    pub dt: f64,
    /// Updates that stepped.
    pub iteration: u64,
    /// Sub-steps that the latest update should have done.
    pub due: u32,
    /// Simulated time that was never integrated because of the cap on sub-steps, s.
    pub lost_time: f64,
}

impl Time {
    fn pass(&mut self, seconds: f64) {
        self.sim_time += seconds;
        self.since_start += seconds;
    }
}

/// The part of a [`Simulation`](super::Simulation) that moves. It knows nothing of clients, devices, plugins and
/// windows; these work on it.
pub(super) struct Physics {
    pub scene: Scene,
    pub sub_step: f64,
    pub bounds: PlausibleBounds,
    pub time: Time,
    /// As it was before the latest update.
    pub time_before: Time,
    /// Time spent inside Bullet's step; `None`: it is not measured.
    pub bullet_time: Option<Duration>,
    /// When the latest update was; taken where somebody listens.
    pub stamp: Option<SystemTime>,
    /// Snapshots are stamped with simulated time since 1970 instead.
    pub has_simulated_stamps: bool,
    /// Room for what is read of joints in an update.
    pub joint_readings: JointReadings,
    pub wrenches: Table<BodyId, Wrench>,
    pub targets: ActiveTargets,
    pub recorder: Option<Box<Recorder>>,
    pub since_start: SinceStart,
    /// Nobody looks at the reactions of joints after this update: those of an earlier one stay.
    pub skips_reactions: bool,
}

impl Physics {
    pub fn new(scene: Scene, sub_step: f64) -> Self {
        let (wanted, usual) = (&scene.description.physics, PlausibleBounds::default());
        let bounds = PlausibleBounds {
            speed: wanted.largest_speed.unwrap_or(usual.speed),
            distance: wanted.largest_distance.unwrap_or(usual.distance),
        };
        let mut physics = Self {
            sub_step,
            bounds,
            time: Time::default(),
            time_before: Time::default(),
            bullet_time: None,
            stamp: None,
            has_simulated_stamps: false,
            joint_readings: JointReadings::default(),
            wrenches: Table::default(),
            targets: ActiveTargets::default(),
            recorder: None,
            since_start: SinceStart::default(),
            skips_reactions: false,
            scene,
        };
        physics.grow();
        // As after a reset: in the same order everything is found.
        physics.scene.world.recover();
        physics
    }

    /// Makes place for what the scene has now.
    pub fn grow(&mut self) {
        self.targets.follow_scene(&self.scene);
        self.joint_readings.make_room(self.scene.world.constraints().len());
        if self.scene.has_feedback {
            self.wrenches.grow(self.scene.bodies.len(), Wrench::default());
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.grow(&self.scene);
        }
    }

    /// Notes what is about to change the motion: every such change passes here, once, before it is made.
    pub fn note(&mut self, entry: &Entry<'_>) {
        self.since_start.note(entry);
        if let Some(recorder) = &mut self.recorder {
            recorder.note(entry);
        }
    }

    /// Notes what the state is after an update, now and then.
    pub fn note_hash(&mut self) {
        let Time { iteration, sim_time, .. } = self.time;
        if let (Some(recorder), true) = (&mut self.recorder, iteration.is_multiple_of(HASH_INTERVAL)) {
            recorder.note_hash(&self.scene, iteration, sim_time);
        }
    }

    /// Counts an update of `interval` s that begins.
    pub fn begin_update(&mut self, interval: f64) {
        self.time_before = self.time;
        self.time.iteration += 1;
        self.time.dt = self.time.interval;
        self.time.interval = interval;
    }

    /// Steps the world by the interval of this update.
    pub fn step(&mut self) {
        let cap = self.scene.max_sub_steps;
        if self.scene.has_measured {
            self.scene.world.set_reactions(!self.skips_reactions);
        }
        let begin = self.bullet_time.map(|before| (before, Instant::now()));
        self.time.due = self.targets.step(&mut self.scene, self.time.interval, cap, self.sub_step);
        self.bullet_time = begin.map(|(before, begin)| before + begin.elapsed());
        self.time.lost_time += f64::from(self.time.due.saturating_sub(cap)) * self.sub_step;
        self.time.pass(self.time.interval);
    }

    /// Lets `seconds` of simulated time pass in which nothing moves.
    pub fn lose_time(&mut self, seconds: f64) {
        if seconds != 0.0 {
            self.note(&Entry::LoseTime { seconds });
        }
        self.time.lost_time += seconds;
        self.time.pass(seconds);
    }

    /// Brings what follows from a step up to date: joints, efforts, wrenches, then ghost objects, sensors, vehicles.
    pub fn observe(&mut self) {
        self.scene.observe_joints(self.time.dt, &mut self.joint_readings);
        if self.scene.has_feedback && !self.skips_reactions {
            self.estimate_efforts();
        }
        if self.scene.has_measured && !self.skips_reactions {
            let Scene { joints, bodies, world, .. } = &mut self.scene;
            joints.iter_mut().filter(|joint| joint.is_measured).for_each(|joint| joint.measure(world, bodies));
        }
        self.scene.update_elements(self.sub_step, self.time.interval.max(self.sub_step));
    }

    /// Sums the reactions of all joints with feedback on their bodies, each in the body's inertial frame.
    fn estimate_efforts(&mut self) {
        self.wrenches.as_mut_slice().fill(Wrench::default());
        let Scene { joints, bodies, world, .. } = &mut self.scene;
        for joint in joints.iter_mut().filter(|joint| joint.feedback) {
            let Some(reaction) = joint.handle.and_then(|handle| world.joint_wrench(handle)) else { continue };
            let mut local = |body: BodyId, force: &Vector3<f64>, torque: &Vector3<f64>| {
                let to_body = world.pose(bodies[body].handle).map(|pose| pose.rotation.inverse()).unwrap_or_default();
                let wrench = &mut self.wrenches[body];
                wrench.force += to_body * force;
                wrench.torque += to_body * torque;
                (to_body * force, to_body * torque)
            };
            let (force, torque) = local(joint.parent, &reaction.force_a, &reaction.torque_a);
            local(joint.child, &reaction.force_b, &reaction.torque_b);
            joint.estimate_effort(&force, &torque);
        }
    }

    /// Iterations that stepped. Wraps like the counter on the wire.
    pub fn sim_step(&self) -> u32 {
        self.time.iteration as u32
    }

    /// The timing of iterations whose cost nobody measures.
    pub fn timing(&self) -> Timing {
        Timing { sub_step_cap: self.scene.max_sub_steps, ..Timing::default() }
    }

    /// Stamp of the state of this moment.
    pub fn stamp_now(&self) -> SystemTime {
        match self.has_simulated_stamps {
            true => SystemTime::UNIX_EPOCH + Duration::try_from_secs_f64(self.time.sim_time).unwrap_or_default(),
            false => self.stamp.unwrap_or_else(SystemTime::now),
        }
    }

    /// Fills a snapshot with the state of this moment; `wall_time` in s.
    pub fn fill(&self, snapshot: &mut Snapshot, wall_time: f64, timing: Timing) {
        let scene = &self.scene;
        snapshot.stamp = self.stamp_now();
        snapshot.sim_step = self.sim_step();
        snapshot.wall_time = wall_time;
        snapshot.sim_time = self.time.sim_time;
        snapshot.timing = Timing { lost_time: self.time.lost_time, ..timing };
        scene.world.read_bodies(snapshot.bodies.as_mut_slice());
        snapshot.wrenches.as_mut_slice().copy_from_slice(self.wrenches.as_slice());
        for (i, joint) in scene.joints.entries() {
            snapshot.joint_positions[i] = joint.position;
            snapshot.joint_velocities[i] = joint.velocity;
            snapshot.joint_efforts[i] = joint.effort;
            snapshot.joint_wrenches[i] = joint.wrench;
        }
        scene.fill_elements(snapshot);
    }

    /// Adds a tool to those of a volume; its place among them.
    ///
    /// # Errors
    /// [`VolumeError`]; nothing is added then.
    pub fn add_tool(&mut self, volume: VolumeId, tool: &VolumeTool) -> Result<usize, VolumeError> {
        let place = self.scene.add_tool(volume, tool)?;
        self.note(&Entry::NewTool { volume: volume.index(), tool: Cow::Borrowed(tool) });
        Ok(place)
    }

    /// Switches a tool of a volume, or gives it another tip.
    ///
    /// # Errors
    /// [`VolumeError`]; nothing has changed then.
    pub fn set_tool(
        &mut self,
        volume: VolumeId,
        tool: usize,
        on: Option<bool>,
        radius: Option<f64>,
    ) -> Result<(), VolumeError> {
        self.note(&Entry::Tool { volume: volume.index(), tool, on, radius });
        self.scene.set_tool(volume, tool, on, radius)
    }

    /// Gives a volume the voxels of the start back, as a reset does.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`].
    pub fn restore_voxels(&mut self, volume: VolumeId) -> Result<(), VolumeError> {
        self.note(&Entry::RestoreVoxels { volume: volume.index() });
        self.scene.restore_voxels(volume)
    }

    /// Applies a whole command to a body; it acts in the next update.
    pub fn command_body(&mut self, body: BodyId, command: &RigidBodyCommand) {
        let Scene { bodies, world, profile, kinematic_bodies, .. } = &mut self.scene;
        let commanded = &mut bodies[body];
        commanded.control = command.cartesian;
        let has_target = if commanded.is_dynamic() { *profile == Profile::Accurate } else { *kinematic_bodies };
        if !has_target || command.cartesian == CartesianCommandType::Force {
            commanded.apply_command(world, command, self.time.dt);
        } else if commanded.set_target(world, command) {
            self.targets.bodies.push(body);
        }
        let n = command.joint_commands.len().min(self.scene.active_joints(body).len());
        for (i, &value) in command.joint_commands[..n].iter().enumerate() {
            let kind = command.joint_command_types.get(i).copied().unwrap_or_default();
            self.command_joint(body, i, kind, value);
        }
    }

    /// Applies a command to the `index`-th active joint of a body: effort (N·m, N), position (rad, m) or velocity
    /// (rad/s, m/s). False when there is no such joint or the value is not finite.
    pub fn command_joint(&mut self, body: BodyId, index: usize, kind: JointCommandType, value: f64) -> bool {
        if !value.is_finite() {
            return false;
        }
        let Some(&joint) = self.scene.active_joints(body).get(index) else { return false };
        self.apply_joint_command(joint, kind, value);
        true
    }

    /// Applies a finite command to a joint.
    pub fn apply_joint_command(&mut self, joint: JointId, kind: JointCommandType, value: f64) {
        let Scene { joints, bodies, world, profile, .. } = &mut self.scene;
        if *profile == Profile::Legacy {
            joints[joint].apply_command(world, bodies, kind, value, self.time.since_start);
        } else if joints[joint].set_target(world, kind, value) {
            self.targets.joints.push(joint);
        }
    }

    /// Returns rigid bodies, with what is on them, to their initial poses at rest. Commands stay in force.
    pub fn reset_bodies(&mut self) {
        self.targets.forget_jumps();
        self.scene.reset(true, &mut self.joint_readings);
    }

    /// Returns everything to the start; nothing is left of what was before. The clocks go on.
    pub fn reset(&mut self) {
        self.scene.end_commands();
        self.targets.clear();
        self.scene.reset(false, &mut self.joint_readings);
        self.wrenches.as_mut_slice().fill(Wrench::default());
        // No update was before the next one.
        let Time { sim_time, iteration, lost_time, .. } = self.time;
        self.time = Time { sim_time, iteration, lost_time, ..Time::default() };
    }

    /// Takes the latest update back in the count of updates and in time, after a reset: it is about to be made anew.
    pub fn uncount_update(&mut self) {
        self.note(&Entry::Again {});
        let Time { sim_time, iteration, lost_time, .. } = self.time_before;
        self.time = Time { sim_time, iteration, lost_time, ..self.time };
    }
}

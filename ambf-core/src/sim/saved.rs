//! Saving and restoring a simulation.

use super::commands::{Link, SavedCommands};
use super::physics::{Physics, Time};
use super::plugins::Attachment;
use super::session::{EarlyEnd, Entry};
use super::targets::ActiveTargets;
use super::window::Picking;
use super::Simulation;
use crate::bullet::StateError;
use crate::comm::Wrench;
use crate::device::law::EndEffector;
use crate::ids::{BodyId, Table};
use crate::scene::SavedScene;

/// The state of a [`Simulation`] at one moment: poses, velocities, contacts with what the solver starts from,
/// controllers, motors, springs, what actuators hold, sensors, soft bodies, vehicles, commands in force, clocks. It
/// belongs to its simulation, and can be restored as often as wanted; any number of them may exist.
///
/// ## Limitations
/// What plugins keep for themselves is not part of it, nor where a hand holds an input device, nor the time that was
/// spent in Bullet.
pub struct SavedState {
    scene: SavedScene,
    time: Time,
    time_before: Time,
    wrenches: Table<BodyId, Wrench>,
    commands: SavedCommands,
    picking: Picking,
    targets: ActiveTargets,
    attachments: Vec<Attachment>,
    devices: Vec<EndEffector>,
    /// The recording that ran, and how many entries it had.
    recorded: Option<(u64, u64)>,
}

impl std::fmt::Debug for SavedState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut out = f.debug_struct("SavedState");
        out.field("sim_time", &self.time.sim_time)
            .field("iteration", &self.time.iteration)
            .field("size", &self.size())
            .finish_non_exhaustive()
    }
}

impl SavedState {
    /// Memory that it takes, bytes, but for little.
    pub fn size(&self) -> usize {
        self.scene.size()
    }

    /// Simulated time of the state, s.
    pub fn sim_time(&self) -> f64 {
        self.time.sim_time
    }
}

impl Simulation {
    /// Saves everything that decides what the simulation does from now on, between two updates. Nothing changes. The
    /// scene must have been loaded with [`SceneOptions::savable`](crate::scene::SceneOptions::savable).
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::TooLarge`].
    pub fn save(&self) -> Result<SavedState, StateError> {
        // All fields by name, so that no new one is forgotten.
        let Self {
            plugins: _,
            plugin_state,
            physics,
            link,
            // Requests of others, and notices for them.
            requests: _,
            recordings: _,
            window: _,
            recording: _,
            notices: _,
            picking,
            devices,
        } = self;
        let Physics {
            scene,
            sub_step: _,
            bounds: _,
            time,
            time_before,
            // Measured, not simulated.
            bullet_time: _,
            stamp: _,
            // How clients want it.
            has_simulated_stamps: _,
            // Read anew in each update.
            joint_readings: _,
            wrenches,
            targets,
            recorder,
            // Recordings begin at the start or after a reset, not at a saved state.
            since_start: _,
            // Set for each update.
            skips_reactions: _,
        } = physics;
        Ok(SavedState {
            scene: scene.save()?,
            time: *time,
            time_before: *time_before,
            wrenches: wrenches.clone(),
            commands: link.as_ref().map(Link::save).unwrap_or_default(),
            picking: picking.clone(),
            targets: targets.clone(),
            attachments: plugin_state.save(),
            devices: devices.as_ref().map(|devices| devices.save()).unwrap_or_default(),
            recorded: recorder.as_ref().map(|recorder| recorder.position()),
        })
    }

    /// Brings the simulation back to a saved state: from now on it does what it did from then on, bit for bit, if it is
    /// told the same.
    ///
    /// # Errors
    /// [`StateError::NotSavable`]; [`StateError::OtherSimulation`], also for another simulation of the same files;
    /// [`StateError::Changed`] when models or devices were added or removed since; [`StateError::TooLarge`]. Nothing
    /// has changed then.
    pub fn restore(&mut self, saved: &SavedState) -> Result<(), StateError> {
        self.restore_keeping(saved, false)
    }

    /// [`restore`](Self::restore), which leaves cameras where they are if `keep_cameras`.
    pub(super) fn restore_keeping(&mut self, saved: &SavedState, keep_cameras: bool) -> Result<(), StateError> {
        let cameras = keep_cameras.then(|| self.physics.scene.cameras.clone());
        let physics = &mut self.physics;
        physics.scene.restore(&saved.scene)?;
        self.note_restored(saved, keep_cameras);
        let physics = &mut self.physics;
        (physics.time, physics.time_before) = (saved.time, saved.time_before);
        physics.wrenches.clone_from(&saved.wrenches);
        physics.targets.restore(&saved.targets);
        if let Some(link) = &mut self.link {
            link.restore(&saved.commands, &physics.scene);
        }
        // Whoever held something then does not any more.
        self.picking.clone_from(&saved.picking);
        self.let_go();
        self.plugin_state.restore(&saved.attachments);
        if let Some(devices) = &mut self.devices {
            devices.restore(&saved.devices);
        }
        if let Some(cameras) = cameras {
            *self.physics.scene.cameras = cameras;
        }
        self.tell_devices();
        Ok(())
    }

    fn note_restored(&mut self, saved: &SavedState, keep_cameras: bool) {
        self.physics.since_start.note_restored();
        let Some(recorder) = &self.physics.recorder else { return };
        match saved.recorded {
            Some((id, position)) if id == recorder.position().0 => {
                self.physics.note(&Entry::Restore { position, keep_cameras, sim_time: saved.sim_time() });
            }
            // Who writes the recording says so.
            _ => {
                if let Some(mut recorder) = self.physics.recorder.take() {
                    recorder.end(EarlyEnd::WentBack);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Vector3;

    use super::*;
    use crate::comm::{JointCommandType, ObjectKind, RigidBodyCommand};
    use crate::control::Profile;
    use crate::ids::JointId;
    use crate::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};

    fn simulation(model: &str, profile: Profile) -> Simulation {
        let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
        let files = SceneFiles {
            world: Some(resources.join("world/world.yaml")),
            models: vec![resources.join("models").join(model)],
        };
        let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
        let loaded = load(&files, &SceneOptions { physics, savable: true, ..SceneOptions::default() });
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, 0.001)
    }

    fn run(simulation: &mut Simulation, steps: u32) {
        for step in 0..steps {
            for body in simulation.physics.scene.bodies.ids() {
                for joint in 0..simulation.physics.scene.active_joints(body).len() {
                    let goal = 0.3 * f64::from(step).sin();
                    simulation.command_joint(body, joint, JointCommandType::Position, goal);
                }
            }
            simulation.update(0.001).expect("finite");
        }
    }

    /// Stronger than what can be seen: all of it, even what is free.
    #[test]
    fn memory_is_the_same_when_the_same_was_done() {
        for model in
            ["gripper.yaml", "arm7.yaml", "car.yaml", "stack.yaml", "ghost.yaml", "touch.yaml", "boxes200.yaml"]
        {
            for profile in [Profile::Legacy, Profile::Accurate] {
                let mut simulation = simulation(model, profile);
                run(&mut simulation, 50);
                let saved = simulation.save().expect("savable");
                run(&mut simulation, 100);
                let first = simulation.save().expect("savable");
                assert!(first.scene.bytes() != saved.scene.bytes());
                simulation.restore(&saved).expect("of this simulation");
                assert!(simulation.save().expect("savable").scene.bytes() == saved.scene.bytes());
                run(&mut simulation, 100);
                let second = simulation.save().expect("savable");
                let words = |state: &SavedState| state.scene.bytes().chunks(8).map(<[u8]>::to_vec).collect::<Vec<_>>();
                let (first, second) = (words(&first), words(&second));
                assert_eq!(first.len(), second.len(), "{model} {profile:?}");
                let pairs = || first.iter().zip(&second).filter(|(a, b)| a != b);
                // Structures are copied with what was on the stack between an `int` and what follows it: a contact
                // point of 47 words has one such place.
                let same = pairs().count() <= 8 + first.len() / 47 && pairs().all(|(a, b)| a[..4] == b[..4]);
                assert!(same, "{model} {profile:?}: a pointer to the heap, or something that was not initialised");
            }
        }
    }

    #[test]
    fn commands_in_force_are_restored_with_the_time_they_have_left() {
        let mut simulation = simulation("pendulum.yaml", Profile::Legacy);
        let hub = simulation.connect();
        let objects = hub.objects().clone();
        let joints = |body: &BodyId| simulation.physics.scene.active_joints(*body);
        let is_body = |kind: &ObjectKind| matches!(kind, ObjectKind::RigidBody(body, _) if !joints(body).is_empty());
        let (object, _) = objects.entries().find(|(_, object)| is_body(&object.info.kind)).expect("a body with joints");
        let push = |effort: f64| {
            let command = RigidBodyCommand {
                joint_commands: vec![effort],
                joint_command_types: vec![JointCommandType::Effort],
                ..RigidBodyCommand::default()
            };
            hub.post(object, &command).expect("finite");
        };
        let step = |simulation: &mut Simulation| {
            simulation.execute_commands().expect("finite");
            simulation.update(0.001).expect("finite");
            simulation.physics.scene.joints[JointId::new(0)].position
        };
        let without = simulation.save().expect("savable");
        push(3.0);
        step(&mut simulation);
        let with = simulation.save().expect("savable");
        let expected: Vec<_> = (0..50).map(|_| step(&mut simulation)).collect();
        // Longer than the watchdog waits.
        std::thread::sleep(crate::comm::WATCHDOG_TIMEOUT + std::time::Duration::from_millis(100));
        simulation.restore(&with).expect("of this simulation");
        let again: Vec<_> = (0..50).map(|_| step(&mut simulation)).collect();
        assert_eq!(again, expected);
        simulation.restore(&without).expect("of this simulation");
        step(&mut simulation);
        let free: Vec<_> = (0..50).map(|_| step(&mut simulation)).collect();
        assert_ne!(free, expected, "the command came later");
    }

    /// What a state holds beside Bullet's memory and the clocks that go on.
    fn beside_bullet(state: &SavedState) -> String {
        let SavedState {
            scene,
            time,
            time_before: _,
            wrenches,
            commands,
            picking,
            targets,
            attachments,
            devices,
            recorded: _,
        } = state;
        let Time { sim_time: _, since_start, interval, dt, iteration: _, due, lost_time: _ } = time;
        assert!(attachments.is_empty() && devices.is_empty(), "neither plugins nor devices are there");
        let (objects, held) = (scene.objects(), commands.count());
        format!("{objects:#?} {since_start} {interval} {dt} {due} {wrenches:?} {held} {picking:?} {targets:?}")
    }

    /// What came before is found nowhere after a reset: neither a number in Bullet's memory of a body, a joint, a soft body
    /// or the world, nor anything that is kept beside it.
    #[test]
    fn nothing_of_what_was_before_a_reset_is_left_in_the_state() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/models");
        for entry in folder.read_dir().expect("models") {
            let model = entry.expect("an entry").file_name().into_string().expect("Unicode");
            for profile in [Profile::Legacy, Profile::Accurate] {
                for is_lost in [false, true] {
                    let mut simulation = simulation(&model, profile);
                    let start = simulation.save().expect("savable");
                    let words = simulation.physics.scene.world.words();
                    run(&mut simulation, 50);
                    let body = simulation.physics.scene.bodies.ids().last().expect("a body");
                    if is_lost {
                        simulation.set_velocity(body, Vector3::repeat(1e300), Vector3::repeat(1e300));
                        let _ = simulation.update(0.001);
                    }
                    simulation.reset_world();
                    let what = format!("{model} {profile:?}, lost: {is_lost}");
                    let again = simulation.save().expect("savable");
                    assert_eq!(beside_bullet(&again), beside_bullet(&start), "{what}");
                    for ((name, before), (_, after)) in words.iter().zip(simulation.physics.scene.world.words()) {
                        // Pointers and counters are no normal numbers.
                        let differs = |(a, b): &(u64, u64)| {
                            a != b && [a, b].iter().any(|&&word| f64::from_bits(word).is_normal())
                        };
                        let found = before.iter().copied().zip(after).position(|pair| differs(&pair));
                        assert_eq!(found, None, "{what}: {name}, word");
                    }
                }
            }
        }
    }

    #[test]
    fn states_may_go_to_other_threads() {
        fn is_free<T: Send + Sync>() {}
        is_free::<SavedState>();
    }
}

//! Iterations when the caller wants them, in the caller's thread.

use std::sync::Arc;

use ambf_volume::Carved;
use nalgebra::Isometry3;

use super::{AddedModel, Control, LostState, ModelError, Models, SavedState, Simulation, WindowLink};
use crate::bullet::{SolverStatistics, StateError};
use crate::comm::{ActuatorCommand, CarveCommand, Hub, HubIndex, ObjectList, RigidBodyCommand, Snapshot};
use crate::ids::{CameraId, LightId, VolumeId};
use crate::scene::{
    ParameterChange, ParameterError, PreparedModel, SetStateError, StateChange, VisualScene, VolumeError,
};

/// A simulation without a clock and without threads of its own: it moves in [`step`](Self::step) and nowhere else.
///
/// It does what a [`Runner`](super::Runner) with fixed steps does for [orders of steps](crate::comm::Hub::step), number
/// for number. An iteration is update, commands, publication; between calls the physics rests after the update of an
/// iteration, before its commands. So a command acts from the second iteration of a call on, and what is seen after `n`
/// iterations is what the n-th publishes. Commands stay in force until they are changed: there is no watchdog.
pub struct Stepper {
    simulation: Simulation,
    interval: f64,
    published: Published,
    lost: Option<LostState>,
    notices: Vec<String>,
}

/// Where a [`Stepper`] publishes.
struct Published {
    snapshot: Snapshot,
    hub: Arc<Hub>,
    /// Windows show what is published.
    is_shown: bool,
}

impl Published {
    fn publish(&mut self, simulation: &mut Simulation) {
        simulation.physics.fill(&mut self.snapshot, 0.0, simulation.physics.timing());
        self.show(simulation);
    }

    /// Lets windows see the present states.
    fn show(&self, simulation: &mut Simulation) {
        if self.is_shown {
            simulation.publish(self.hub.now().as_secs_f64(), simulation.physics.timing());
        }
    }
}

/// What windows of a [`Stepper`] work with.
pub struct StepperWindow {
    /// States of all objects, and what can be drawn: brought up to date with each publication.
    pub hub: Arc<Hub>,
    /// Way to the simulation for what is done in a window.
    pub link: WindowLink,
    /// Pause and single steps; who steps the simulation obeys them, or does not.
    pub control: Arc<Control>,
    /// Adding and removing models, which is refused: the simulation belongs to who steps it.
    pub models: Models,
}

/// The state of a [`Stepper`] at one moment: that of its simulation, and what it has published.
#[derive(Debug, Clone)]
pub struct StepperState {
    simulation: Arc<SavedState>,
    snapshot: Snapshot,
    lost: Option<LostState>,
}

impl StepperState {
    /// The state of the simulation.
    pub fn simulation(&self) -> &SavedState {
        &self.simulation
    }

    /// The states that were published.
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }
}

/// Most notices that wait to be taken; further ones are dropped.
const MAX_NOTICES: usize = 1000;

impl Stepper {
    /// Steps `simulation` by `interval` s (above 0) an iteration. The first update is done here, as it is before a
    /// client sees anything of a simulator.
    pub fn new(mut simulation: Simulation, interval: f64) -> Self {
        let hub = simulation.connect();
        simulation.set_nominal_frequency(1.0 / interval);
        let snapshot = simulation.scene().snapshot(simulation.wrenches());
        let mut published = Published { snapshot, hub, is_shown: false };
        let lost = simulation.advance(interval).err();
        published.publish(&mut simulation);
        Self { simulation, interval, published, lost, notices: Vec::new() }
    }

    /// Steps `simulation` from where it is, which is between the halves of an iteration: no update is done here. For one
    /// that somebody else moves, as a replay does, through [`follow`](Self::follow).
    pub fn at_rest(mut simulation: Simulation, interval: f64) -> Self {
        let hub = simulation.connect();
        let snapshot = simulation.scene().snapshot(simulation.wrenches());
        let mut published = Published { snapshot, hub, is_shown: false };
        published.publish(&mut simulation);
        Self { simulation, interval, published, lost: None, notices: Vec::new() }
    }

    /// Lets `act` move the simulation, and publishes what became of it.
    pub fn follow<R>(&mut self, act: impl FnOnce(&mut Simulation) -> R) -> R {
        let result = act(&mut self.simulation);
        self.lost = self.simulation.check_state().err();
        self.follow_scene();
        result
    }

    /// The simulation.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// The simulation, to begin and end recordings: what else changes it belongs to the methods below.
    pub fn simulation_mut(&mut self) -> &mut Simulation {
        &mut self.simulation
    }

    /// Takes what the solver did since this was called the last time; see [`Simulation::take_solver_statistics`].
    pub fn take_solver_statistics(&mut self) -> SolverStatistics {
        self.simulation.take_solver_statistics()
    }

    /// Switches the energy ledger on, with all sums at 0, or off; see [`Simulation::set_energy_ledger`].
    pub fn set_energy_ledger(&mut self, enabled: bool) {
        self.simulation.set_energy_ledger(enabled);
    }

    /// All objects that have a State and a Command; positions in this list name them below.
    pub fn objects(&self) -> Arc<ObjectList> {
        Arc::clone(&self.published.hub.objects())
    }

    /// The states that the latest iteration published.
    pub fn snapshot(&self) -> &Snapshot {
        &self.published.snapshot
    }

    /// What windows need. From now on they see each publication; those who had an earlier link are cut off.
    pub fn window(&mut self) -> StepperWindow {
        self.published.is_shown = true;
        self.published.hub.set_listening();
        let link = self.simulation.window_link();
        let models = self.simulation.models();
        // Nobody will answer, so that asking fails at once.
        self.simulation.refuse_models();
        self.published.show(&mut self.simulation);
        StepperWindow { hub: Arc::clone(&self.published.hub), link, control: Arc::default(), models }
    }

    /// Does what was asked for in windows, and resets that plugins asked for: cameras are moved, bodies held, everything
    /// returns to the start. It is done in each iteration, and has to be called when there are none for a while. Costs next
    /// to nothing when there is nothing to do.
    pub fn serve_window(&mut self) {
        let (was_reset, outcome) = self.simulation.do_requested_resets_at_rest();
        if was_reset {
            self.show_reset(outcome);
        }
        if self.published.is_shown && self.simulation.do_requested_changes() {
            self.published.show(&mut self.simulation);
        }
    }

    /// What can be drawn of the scene; another value whenever the scene has changed.
    pub fn visuals(&self) -> Option<Arc<VisualScene>> {
        self.published.hub.visuals()
    }

    /// The command in force for a body, to be changed. `None` when the object at that position is no body.
    pub fn body_command(&mut self, object: HubIndex) -> Option<&mut RigidBodyCommand> {
        self.simulation.link.as_mut()?.body_command(object)
    }

    /// The command in force for an actuator, to be changed. `None` when the object at that position is no actuator.
    pub fn actuator_command(&mut self, object: HubIndex) -> Option<&mut ActuatorCommand> {
        self.simulation.link.as_mut()?.actuator_command(object)
    }

    /// Makes `steps` iterations.
    ///
    /// # Errors
    /// [`LostState`]; then, and until the next [`reset`](Self::reset), nothing moves. A state that is lost while the
    /// physics comes to rest after the last iteration is the error of the next call: what was published is sound.
    pub fn step(&mut self, steps: u32) -> Result<(), LostState> {
        self.step_while(steps, || true).map(|_| ())
    }

    /// Makes `steps` iterations, or fewer if `go_on`, which is asked in each of them, says that the next one is the last; how
    /// many were made.
    ///
    /// # Errors
    /// Those of [`step`](Self::step).
    pub fn step_while(&mut self, steps: u32, mut go_on: impl FnMut() -> bool) -> Result<u32, LostState> {
        let mut last = steps;
        for made in 1..=steps {
            self.serve_window();
            if let Some(problem) = &self.lost {
                return Err(problem.clone());
            }
            let outcome = self.simulation.exchange(|simulation| {
                if made == last {
                    self.published.publish(simulation);
                }
            });
            if let Err(problem) = outcome {
                self.lost = Some(problem.clone());
                return Err(problem);
            }
            self.hear();
            // Plugins may ask for resets.
            self.simulation.do_requested_resets();
            if made + 1 < last && !go_on() {
                last = made + 1;
            }
            // The last iteration publishes what the one before leaves, and leaves what the next call publishes or saves.
            let outcome = match made + 1 < last {
                true => self.simulation.advance_unseen(self.interval),
                false => self.simulation.advance(self.interval),
            };
            self.lost = outcome.err();
            if made == last {
                return Ok(made);
            }
        }
        Ok(0)
    }

    /// Returns everything to the start, as [`new`](Self::new) left it: see [`Simulation::reset_world`]. The iteration whose
    /// commands are due is made anew from there, so that time and the count of iterations go on as without a reset.
    pub fn reset(&mut self) {
        let outcome = self.simulation.reset_at_rest();
        self.show_reset(outcome);
    }

    fn show_reset(&mut self, outcome: Result<(), LostState>) {
        self.lost = outcome.err();
        if self.lost.is_none() {
            self.published.publish(&mut self.simulation);
        }
    }

    /// Sets a state, and publishes it. It is the state before the commands of the next iteration: as after a reset, that
    /// iteration publishes it once more, and the next one what became of it. Sensors follow with the iteration.
    ///
    /// # Errors
    /// [`SetStateError`]; nothing has changed then.
    pub fn set_state(&mut self, change: &StateChange) -> Result<(), SetStateError> {
        if self.lost.is_some() {
            return Err(SetStateError::Lost);
        }
        self.simulation.set_state(change)?;
        self.published.publish(&mut self.simulation);
        Ok(())
    }

    /// Changes masses, surfaces, limits, gains, gravity, colours: settings, which resets keep.
    ///
    /// # Errors
    /// [`ParameterError`]; nothing has changed then.
    pub fn set_parameters(&mut self, change: &ParameterChange) -> Result<(), ParameterError> {
        self.simulation.set_parameters(change)
    }

    /// Whether [`set_parameters`](Self::set_parameters) would change these.
    ///
    /// # Errors
    /// [`ParameterError`].
    pub fn check_parameters(&self, change: &ParameterChange) -> Result<(), ParameterError> {
        self.simulation.physics.scene.check_parameters(change)
    }

    /// Cuts a volume, and publishes its voxels; what was removed.
    ///
    /// # Errors
    /// [`VolumeError`]; nothing is cut then.
    pub fn carve(&mut self, volume: VolumeId, command: &CarveCommand) -> Result<Carved, VolumeError> {
        let carved = self.simulation.carve(volume, command)?;
        self.published.publish(&mut self.simulation);
        Ok(carved)
    }

    /// Gives a volume the voxels of the start back, as a reset does, and publishes them.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`].
    pub fn restore_voxels(&mut self, volume: VolumeId) -> Result<(), VolumeError> {
        self.simulation.restore_voxels(volume)?;
        self.published.publish(&mut self.simulation);
        Ok(())
    }

    /// Puts a camera at a pose in the world (it looks along its −x axis, +z is up); a reset returns it. Publishes it.
    pub fn place_camera(&mut self, camera: CameraId, pose: &Isometry3<f64>) {
        let scene = &mut self.simulation.physics.scene;
        let parent = scene.global_pose(scene.cameras[camera].attached.parent, &Isometry3::identity());
        let pose = parent.inverse() * pose;
        self.simulation.place(camera.into(), pose);
        self.published.publish(&mut self.simulation);
    }

    /// Puts a light at a pose in the world (it shines along its +x axis); a reset returns it. Publishes it.
    pub fn place_light(&mut self, light: LightId, pose: &Isometry3<f64>) {
        let scene = &mut self.simulation.physics.scene;
        let parent = scene.global_pose(scene.lights[light].attached.parent, &Isometry3::identity());
        let pose = parent.inverse() * pose;
        self.simulation.place(light.into(), pose);
        self.published.publish(&mut self.simulation);
    }

    /// Builds a model into the scene, and publishes it; ids and positions of other objects stay. See
    /// [`Simulation::add_model`].
    ///
    /// # Errors
    /// Those of [`Simulation::add_model`].
    pub fn add_model(&mut self, prepared: PreparedModel) -> Result<AddedModel, ModelError> {
        let added = self.simulation.add_model(prepared)?;
        self.follow_scene();
        Ok(added)
    }

    /// Removes the model whose key is `name`, or the only one whose key holds `name`; its key. Ids and positions of other
    /// objects stay.
    ///
    /// # Errors
    /// [`ModelError::Unknown`].
    pub fn remove_model(&mut self, name: &str) -> Result<String, ModelError> {
        let removed = self.simulation.remove_model(name)?;
        self.follow_scene();
        Ok(removed)
    }

    /// Makes place for what the scene has now.
    fn follow_scene(&mut self) {
        self.published.snapshot = self.simulation.scene().snapshot(self.simulation.wrenches());
        self.published.publish(&mut self.simulation);
    }

    /// Saves everything: see [`Simulation::save`]; it is at rest.
    ///
    /// # Errors
    /// Those of [`Simulation::save`].
    pub fn save(&self) -> Result<StepperState, StateError> {
        let simulation = Arc::new(self.simulation.save()?);
        Ok(StepperState { simulation, snapshot: self.published.snapshot.clone(), lost: self.lost.clone() })
    }

    /// Brings everything back to a saved state, commands in force and what was published too.
    ///
    /// # Errors
    /// Those of [`Simulation::restore`]; nothing has changed then.
    pub fn restore(&mut self, state: &StepperState) -> Result<(), StateError> {
        self.simulation.restore(&state.simulation)?;
        self.published.snapshot.clone_from(&state.snapshot);
        self.lost.clone_from(&state.lost);
        self.published.show(&mut self.simulation);
        Ok(())
    }

    /// Why nothing moves; `None` while all is well.
    pub fn lost(&self) -> Option<&LostState> {
        self.lost.as_ref()
    }

    /// Takes the sentences about commands that name what is not there, and what plugins have to say.
    pub fn take_notices(&mut self) -> Vec<String> {
        self.hear();
        std::mem::take(&mut self.notices)
    }

    fn hear(&mut self) {
        let heard = self.simulation.take_notices();
        let room = MAX_NOTICES.saturating_sub(self.notices.len());
        self.notices.extend(heard.into_iter().take(room));
    }
}

impl Drop for Stepper {
    fn drop(&mut self) {
        self.simulation.close_plugins();
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::comm::Wrench;
    use crate::control::Profile;
    use crate::ids::{BodyId, Table};
    use crate::scene::{load, SceneFiles, SceneOptions};
    use crate::sim::WindowRequest;

    fn stepper() -> Stepper {
        let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
        let files = SceneFiles {
            world: Some(resources.join("world/world.yaml")),
            models: vec![resources.join("models/pendulum.yaml")],
        };
        Stepper::new(Simulation::new(load(&files, &SceneOptions::default()).scene, 0.001), 0.001)
    }

    /// An arm in the accurate profile of whose joints all wrenches are measured.
    fn measured_arm() -> Stepper {
        let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
        let files = SceneFiles {
            world: Some(resources.join("world/world.yaml")),
            models: vec![resources.join("models/arm7.yaml")],
        };
        let default_profile = Some(Profile::Accurate);
        let options = SceneOptions { default_profile, joint_wrenches: true, ..SceneOptions::default() };
        Stepper::new(Simulation::new(load(&files, &options).scene, 0.001), 0.001)
    }

    /// The reactions of joints in the scene itself, which nobody has published.
    fn reactions(stepper: &Stepper) -> (Vec<Wrench>, Vec<f64>, Table<BodyId, Wrench>) {
        let joints = &stepper.simulation.scene().joints;
        let wrenches = joints.iter().map(|joint| joint.wrench).collect();
        (wrenches, joints.iter().map(|joint| joint.effort).collect(), stepper.simulation.wrenches().clone())
    }

    #[test]
    fn reactions_are_those_of_steps_one_by_one() {
        let (mut together, mut one_by_one) = (measured_arm(), measured_arm());
        for steps in [1, 2, 9, 3, 1] {
            together.step(steps).expect("sound");
            (0..steps).for_each(|_| one_by_one.step(1).expect("sound"));
            let [a, b] = [together.snapshot(), one_by_one.snapshot()];
            assert!(a.joint_wrenches.iter().any(|wrench| wrench.force.norm() > 1.0), "they carry something");
            assert_eq!(
                (&a.joint_wrenches, &a.joint_efforts, &a.wrenches),
                (&b.joint_wrenches, &b.joint_efforts, &b.wrenches)
            );
            assert_eq!(reactions(&together), reactions(&one_by_one), "what rests is what the next call may publish");
        }
    }

    #[test]
    fn reactions_that_nobody_sees_are_not_computed() {
        let mut stepper = measured_arm();
        let before = reactions(&stepper);
        stepper.simulation.advance_unseen(0.001).expect("sound");
        assert_eq!(reactions(&stepper), before);
        stepper.simulation.advance(0.001).expect("sound");
        let seen = reactions(&stepper);
        assert_ne!(seen, before);
        stepper.window();
        stepper.simulation.advance_unseen(0.001).expect("sound");
        assert_ne!(reactions(&stepper), seen, "a window sees them");
    }

    #[test]
    fn whoever_stops_in_between_sees_the_reactions_too() {
        let (mut stopped, mut one_by_one) = (measured_arm(), measured_arm());
        let mut asked = 0;
        let made = stopped.step_while(20, || {
            asked += 1;
            asked < 5
        });
        let made = made.expect("sound");
        assert!(made < 20, "{made}");
        (0..made).for_each(|_| one_by_one.step(1).expect("sound"));
        assert_eq!(stopped.snapshot().joint_wrenches, one_by_one.snapshot().joint_wrenches);
        assert_eq!(reactions(&stopped), reactions(&one_by_one));
    }

    #[test]
    fn windows_see_each_publication_and_change_nothing_of_the_motion() {
        let (mut shown, mut alone) = (stepper(), stepper());
        let window = shown.window();
        let seen = || window.hub.snapshot().as_ref().map(|snapshot| (snapshot.sim_step, snapshot.bodies.clone()));
        assert_eq!(seen().map(|(step, _)| step), Some(1), "also before the first step");
        for _ in 0..5 {
            shown.step(7).expect("sound");
            alone.step(7).expect("sound");
            assert_eq!(shown.snapshot().bodies, alone.snapshot().bodies);
            assert_eq!(seen(), Some((shown.snapshot().sim_step, shown.snapshot().bodies.clone())));
        }
        assert!(window.hub.visuals().is_some());
    }

    #[test]
    fn what_is_done_in_a_window_needs_no_step() {
        let mut shown = stepper();
        let window = shown.window();
        let pose = Isometry3::translation(1.0, 2.0, 3.0);
        window
            .link
            .post(WindowRequest::PlaceCamera { camera: CameraId::new(0), pose, distance: 1.0 })
            .expect("there is room");
        shown.serve_window();
        let seen = window.hub.snapshot().as_ref().map(|snapshot| snapshot.views[CameraId::new(0)].pose);
        assert!((seen.expect("published").translation.vector - pose.translation.vector).norm() < 1e-9);
        let begin = Instant::now();
        assert!(window.models.list().is_err(), "models belong to who steps");
        assert!(begin.elapsed() < Duration::from_secs(1), "and that is said at once");
    }
}

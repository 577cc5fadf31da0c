//! An arm for programs of any kind.

use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use parking_lot::Mutex;
use ros_node::Peer;
use thiserror::Error;

use crate::dialect::{arms, Dialect, Names};
use crate::frames::{is_finite, Frames, Wrench};
use crate::gravity::GravityTerm;
use crate::hub::{published, Hub};
use crate::inner::{Inner, Mode, Servo};
use crate::options::ArmOptions;
use crate::pedals::Pedal;
use crate::sender;

/// Why an arm cannot be used, or not in that way.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ArmError {
    /// Error when a name cannot be part of a topic.
    #[error("\"{0}\" is no name of an arm: expected letters, digits and _ with a letter first, for example MTMR; the same for each part of a namespace")]
    Name(String),
    /// Error when the address of the master is none.
    #[error(transparent)]
    Master(#[from] ros_node::CallError),
    /// Error when no thread can be made.
    #[error("no thread could be made: {0}")]
    Thread(std::io::Error),
    /// Error when a number is not finite; nothing was changed or sent.
    #[error("{0} has numbers that are not finite")]
    NotFinite(&'static str),
    /// Error when nothing can be sent to the arm: its node is away, or does not listen to that topic.
    #[error("{0} is not there, or does not listen to {1}")]
    NotHeard(String, &'static str),
    /// Error when the arm's dialect has no such command, or [`ArmOptions::motion`] is off.
    #[error("{0} is not told: {1} is no topic of its dialect, or motion commands were not asked for")]
    Unsupported(String, &'static str),
}

/// Names of the arms that publish their pose at present, sorted, in `namespace` or, without one, where arms usually
/// are.
///
/// # Errors
/// [`ArmError::Master`] when the master does not answer.
pub fn active_arms(namespace: Option<&str>) -> Result<Vec<String>, ArmError> {
    let master = Peer::new(&ros_node::master_uri(), "/dvrk_arm", Duration::from_secs(1))?;
    Ok(arms(namespace, &published(&master)?))
}

/// An arm of a da Vinci Research Kit: its state as it comes over ROS, and commands to it.
///
/// All poses, forces and torques are in the *device frame*: those of the arm seen from the origin, see [`Frames`]. A
/// thread of its own sends the newest command at 1 kHz and stops 50 ms after the caller has stopped giving commands;
/// forces end with a zero then. The arm may start, stop and restart, and change its dialect, at any time; so may the
/// ROS master. Nothing here moves an arm unasked.
///
/// Dropping it is [closing](Self::close) it.
pub struct Arm {
    inner: Arc<Inner>,
    hub: Arc<Hub>,
    sender: Option<JoinHandle<()>>,
    /// The wrench to which [`set_force`](Self::set_force) and [`set_moment`](Self::set_moment) add their half.
    wrench: Mutex<Wrench>,
}

impl Arm {
    /// The arm of that name. Returns at once; the arm need not be there yet, see
    /// [`wait_until_available`](Self::wait_until_available).
    ///
    /// # Errors
    /// [`ArmError::Name`], [`ArmError::Master`], [`ArmError::Thread`].
    pub fn connect(name: &str, options: ArmOptions) -> Result<Self, ArmError> {
        let arm = options.arm.clone().unwrap_or_else(|| name.to_owned());
        let names = Names::new(options.namespace.as_deref(), &arm)
            .ok_or_else(|| ArmError::Name(format!("{}/{arm}", options.namespace.as_deref().unwrap_or_default())))?;
        let hub = Hub::get()?;
        let inner = Arc::new(Inner::new(names, &arm, options));
        hub.add(&inner);
        let thread = std::thread::Builder::new().name(format!("dvrk-{arm}"));
        let sending = Arc::clone(&inner);
        let sender = thread.spawn(move || sender::run(&sending));
        // From here on dropping cleans up.
        let mut connected = Self { inner, hub, sender: None, wrench: Mutex::default() };
        connected.sender = Some(sender.map_err(ArmError::Thread)?);
        Ok(connected)
    }

    /// Its name with its namespace, for example `/MTMR`.
    pub fn name(&self) -> String {
        self.inner.names.identity()
    }

    /// How it speaks; `None` before it was found.
    pub fn dialect(&self) -> Option<Dialect> {
        self.inner.outputs.load().as_ref().map(|outputs| outputs.dialect)
    }

    /// Whether its poses come: the newest is not older than [`ArmOptions::timeout`].
    pub fn is_available(&self) -> bool {
        self.inner.is_available()
    }

    /// Waits until it [is available](Self::is_available), at most so long; whether it is.
    pub fn wait_until_available(&self, timeout: Duration) -> bool {
        let deadline = Instant::now() + timeout;
        while !self.is_available() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.is_available()
    }

    /// Whether its state allows it to be used: enabled, homed and not busy. Arms of the legacy and AMBF dialects are
    /// unless they say `DVRK_UNINITIALIZED`.
    pub fn is_ready(&self) -> bool {
        self.inner.ready.load(Ordering::Acquire)
    }

    /// Name of its state as it says it: `ENABLED`, `DVRK_EFFORT_CARTESIAN`…; `None` before it has said one.
    pub fn state(&self) -> Option<String> {
        self.inner.state.lock().as_ref().map(|state| state.name.clone())
    }

    /// Pose of the tip in the device frame, m; identity before the first.
    pub fn pose(&self) -> Isometry3<f64> {
        self.inner.posed().map_or_else(Isometry3::identity, |posed| posed.pose)
    }

    /// Position of the tip, m.
    pub fn position(&self) -> Vector3<f64> {
        self.pose().translation.vector
    }

    /// Orientation of the tip.
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        self.pose().rotation
    }

    /// Roll, pitch and yaw of the tip about fixed axes, rad.
    pub fn rpy(&self) -> (f64, f64, f64) {
        self.orientation().euler_angles()
    }

    /// Orientation of the tip as a matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.orientation().to_rotation_matrix().into_inner()
    }

    /// Wrench that the arm measures at its tip, in device axes; zero before the first.
    pub fn measured_wrench(&self) -> Wrench {
        let wrench = *self.inner.measured_wrench.lock();
        self.inner.frames.lock().wrench_to_device(&wrench)
    }

    /// Its force, N.
    pub fn measured_force(&self) -> Vector3<f64> {
        self.measured_wrench().force
    }

    /// Its moment, N·m.
    pub fn measured_moment(&self) -> Vector3<f64> {
        self.measured_wrench().torque
    }

    /// Joint positions, rad or m, as many as the arm sends.
    pub fn joint_positions(&self) -> Vec<f64> {
        self.inner.joints.lock().position.clone()
    }

    /// Joint velocities, rad/s or m/s, as many as the arm sends.
    pub fn joint_velocities(&self) -> Vec<f64> {
        self.inner.joints.lock().velocity.clone()
    }

    /// Joint efforts, N·m or N, as many as the arm sends.
    pub fn joint_efforts(&self) -> Vec<f64> {
        self.inner.joints.lock().effort.clone()
    }

    /// Gripper or jaw: 0 closed … 1 open, in the range of [`ArmOptions::gripper`]; 0.5 before the first message.
    pub fn gripper(&self) -> f64 {
        self.inner.gripper()
    }

    /// Angle of the gripper or jaw, rad; `None` before the first message.
    pub fn gripper_angle(&self) -> Option<f64> {
        self.inner.gripper_angle()
    }

    /// Whether the arm says that its gripper is closed.
    pub fn is_gripper_closed(&self) -> bool {
        self.inner.buttons() & 1 != 0
    }

    /// Whether a pedal is pressed.
    pub fn is_pressed(&self, pedal: Pedal) -> bool {
        self.inner.buttons() & pedal.bit() != 0
    }

    /// How often a pedal was tapped quickly since the arm was found.
    pub fn clicks(&self, pedal: Pedal) -> u32 {
        self.inner.pedals.load().clicks(pedal)
    }

    /// Bit 0: gripper closed; then the bits of [`Pedal`].
    pub fn buttons(&self) -> u32 {
        self.inner.buttons()
    }

    /// The mode that the arm has said last, or that the last command implies.
    pub fn mode(&self) -> Mode {
        self.inner.mode()
    }

    /// Whether it is available and in that mode.
    pub fn is_in_mode(&self, mode: Mode) -> bool {
        self.is_available() && self.mode() == mode
    }

    /// Origin and tip offset.
    pub fn frames(&self) -> Frames {
        *self.inner.frames.lock()
    }

    /// Sets the origin, m, in the arm's reference frame.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_origin(&self, origin: &Isometry3<f64>) -> Result<(), ArmError> {
        self.change_frames("the origin", |frames| frames.origin = *origin)
    }

    /// Sets the position of the origin, m, and keeps its rotation.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_origin_position(&self, position: &Vector3<f64>) -> Result<(), ArmError> {
        self.change_frames("the origin", |frames| frames.origin.translation = Translation3::from(*position))
    }

    /// Sets the rotation of the origin and keeps its position.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_origin_rotation(&self, rotation: &UnitQuaternion<f64>) -> Result<(), ArmError> {
        self.change_frames("the origin", |frames| frames.origin.rotation = *rotation)
    }

    /// Sets the offset of the tip, m, in the frame of the tip that the arm reports.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_tip(&self, tip: &Isometry3<f64>) -> Result<(), ArmError> {
        self.change_frames("the tip", |frames| frames.tip = *tip)
    }

    /// Sets the position of the tip offset, m, and keeps its rotation.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_tip_position(&self, position: &Vector3<f64>) -> Result<(), ArmError> {
        self.change_frames("the tip", |frames| frames.tip.translation = Translation3::from(*position))
    }

    /// Sets the rotation of the tip offset and keeps its position.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_tip_rotation(&self, rotation: &UnitQuaternion<f64>) -> Result<(), ArmError> {
        self.change_frames("the tip", |frames| frames.tip.rotation = *rotation)
    }

    fn change_frames(&self, what: &'static str, change: impl FnOnce(&mut Frames)) -> Result<(), ArmError> {
        let mut known = self.inner.frames.lock();
        let mut frames = *known;
        change(&mut frames);
        if !is_finite(&frames.origin) || !is_finite(&frames.tip) {
            return Err(ArmError::NotFinite(what));
        }
        *known = frames;
        Ok(())
    }

    /// Lets the user of the arm feel a wrench, until 50 ms after the last call. There is no limit here: the caller
    /// limits. While the clutch is pressed no force is sent; torques are only with [`ArmOptions::send_torque`]. Never
    /// waits; a call that meets one of another thread is dropped.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_wrench(&self, wrench: &Wrench) -> Result<(), ArmError> {
        if !wrench.is_finite() {
            return Err(ArmError::NotFinite("the wrench"));
        }
        *self.wrench.lock() = *wrench;
        self.inner.command_wrench(wrench);
        Ok(())
    }

    /// [`set_wrench`](Self::set_wrench) with this force, N, and the moment as it was.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_force(&self, force: &Vector3<f64>) -> Result<(), ArmError> {
        let wrench = *self.wrench.lock();
        self.set_wrench(&Wrench { force: *force, ..wrench })
    }

    /// [`set_wrench`](Self::set_wrench) with this moment, N·m, and the force as it was.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn set_moment(&self, moment: &Vector3<f64>) -> Result<(), ArmError> {
        let wrench = *self.wrench.lock();
        self.set_wrench(&Wrench { torque: *moment, ..wrench })
    }

    /// Lets the tip follow a pose, m, until 50 ms after the last call; the arm holds it then. **The arm moves**, as
    /// fast as it can: give small steps at a high rate.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn servo_pose(&self, pose: &Isometry3<f64>) -> Result<(), ArmError> {
        if !is_finite(pose) {
            return Err(ArmError::NotFinite("the pose"));
        }
        let pose = self.frames().to_arm(pose);
        self.inner.command_servo(Servo::Pose(pose));
        Ok(())
    }

    /// [`servo_pose`](Self::servo_pose) to a position, m, with the orientation as it is.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn servo_position(&self, position: &Vector3<f64>) -> Result<(), ArmError> {
        self.servo_pose(&Isometry3::from_parts(Translation3::from(*position), self.orientation()))
    }

    /// [`servo_pose`](Self::servo_pose) to an orientation, with the position as it is.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn servo_orientation(&self, orientation: &UnitQuaternion<f64>) -> Result<(), ArmError> {
        self.servo_pose(&Isometry3::from_parts(self.pose().translation, *orientation))
    }

    /// Lets the joints follow positions, rad or m, as [`servo_pose`](Self::servo_pose) does for the tip.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`].
    pub fn servo_joints(&self, positions: &[f64]) -> Result<(), ArmError> {
        finite_joints(positions)?;
        self.inner.command_servo(Servo::Joints(positions.to_vec()));
        Ok(())
    }

    /// Sends the tip to a pose, m, on a path that the arm plans (`move_cp`, CRTK only). **The arm moves.** Said once.
    ///
    /// # Errors
    /// [`ArmError::NotFinite`], [`ArmError::Unsupported`], [`ArmError::NotHeard`].
    pub fn move_to_pose(&self, pose: &Isometry3<f64>) -> Result<(), ArmError> {
        if !is_finite(pose) {
            return Err(ArmError::NotFinite("the pose"));
        }
        let pose = self.frames().to_arm(pose);
        self.inner.stop_commands();
        let told = self.motion(|motion| motion.move_pose(&pose));
        self.told(told, "move_cp")
    }

    /// Sends the joints to positions, rad or m, on a path that the arm plans (`move_jp`, CRTK only). **The arm moves.**
    /// Said once.
    ///
    /// # Errors
    /// As [`move_to_pose`](Self::move_to_pose).
    pub fn move_to_joints(&self, positions: &[f64]) -> Result<(), ArmError> {
        finite_joints(positions)?;
        self.inner.stop_commands();
        let told = self.motion(|motion| motion.move_joints(positions));
        self.told(told, "move_jp")
    }

    fn motion(&self, tell: impl FnOnce(&crate::outputs::Motion) -> Option<bool>) -> Option<bool> {
        match &*self.inner.outputs.load() {
            Some(outputs) => outputs.motion().and_then(tell),
            // Not found yet, which is not the dialect's fault.
            None => Some(false),
        }
    }

    fn told(&self, told: Option<bool>, topic: &'static str) -> Result<(), ArmError> {
        match told {
            Some(true) => Ok(()),
            Some(false) => Err(ArmError::NotHeard(self.name(), topic)),
            None => Err(ArmError::Unsupported(self.name(), topic)),
        }
    }

    /// Asks for a mode, and stops repeating commands until the next one. In the dialects of CRTK the first command
    /// makes the mode.
    ///
    /// # Errors
    /// [`ArmError::NotHeard`] in the legacy and AMBF dialects.
    pub fn set_mode(&self, mode: Mode) -> Result<(), ArmError> {
        self.inner.stop_commands();
        match &*self.inner.outputs.load() {
            Some(outputs) if outputs.dialect.is_crtk() => Ok(()),
            Some(outputs) => {
                if mode == Mode::CartesianEffort {
                    outputs.settle(true, true);
                }
                self.told(Some(outputs.ask(mode.name())), "set_robot_state")
            }
            None => Err(ArmError::NotHeard(self.name(), "set_robot_state")),
        }
    }

    /// Asks for a change of state. In the dialects of CRTK: `enable`, `disable`, `pause`, `resume`, `home`, `unhome`.
    /// **`home` moves the arm.**
    ///
    /// # Errors
    /// [`ArmError::NotHeard`].
    pub fn request(&self, state: &str) -> Result<(), ArmError> {
        let told = self.inner.outputs.load().as_ref().is_some_and(|outputs| outputs.ask(state));
        self.told(Some(told), "state_command")
    }

    /// Says whether wrenches are in axes fixed to the base (`true`, which everything here assumes) and whether the arm
    /// carries its own weight. Both are switched on when the arm is found.
    ///
    /// # Errors
    /// [`ArmError::NotHeard`] before that.
    pub fn set_base_axes_and_gravity_compensation(&self, base_axes: bool, gravity: bool) -> Result<(), ArmError> {
        let outputs = self.inner.outputs.load();
        let told = outputs.as_ref().is_some_and(|outputs| outputs.settle(base_axes, gravity));
        self.told(Some(told), "use_gravity_compensation")
    }

    /// Adds a gravity term of the caller's own to every wrench: joint torques, N·m, from joint positions, rad, mapped
    /// to the tip with the body Jacobian that the arm publishes, see [`tip_wrench`](crate::tip_wrench). Limited to
    /// `max_force`, N, and `max_torque`, N·m. Switch the arm's own compensation off, or give the difference. Called in
    /// the thread that sends; must not block.
    pub fn set_gravity_term(
        &self,
        max_force: f64,
        max_torque: f64,
        torques: impl FnMut(&[f64]) -> Option<Vec<f64>> + Send + 'static,
    ) {
        let limits = (max_force.max(0.0), max_torque.max(0.0));
        *self.inner.gravity.lock() = Some(GravityTerm { torques: Box::new(torques), limits });
    }

    /// Adds none any more.
    pub fn clear_gravity_term(&self) {
        *self.inner.gravity.lock() = None;
    }

    /// Wrenches that were sent, repetitions and zeros included.
    pub fn wrenches_sent(&self) -> u64 {
        self.inner.sent.load(Ordering::Relaxed)
    }

    /// Sends a force of zero, twice, and closes the arm; nothing else of ROS in this process is touched.
    pub fn close(self) {
        drop(self);
    }

    pub(crate) fn inner(&self) -> &Inner {
        &self.inner
    }

    pub(crate) fn is_dismissed(&self) -> bool {
        self.hub.is_dismissed()
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        self.inner.closing.store(true, Ordering::Release);
        if let Some(sender) = self.sender.take() {
            sender.thread().unpark();
            // A panic there has been reported by its hook.
            let _ = sender.join();
        }
        self.hub.tidy();
    }
}

fn finite_joints(positions: &[f64]) -> Result<(), ArmError> {
    let finite = positions.iter().all(|x| x.is_finite());
    finite.then_some(()).ok_or(ArmError::NotFinite("the joint positions"))
}

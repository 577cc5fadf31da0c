//! The service `<world>/step`: commands, iterations and states in one request.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use ambf_core::comm::{
    ActuatorCommand, ActuatorInfo, GhostInfo, Hub, HubIndex, ObjectInfo, OrderedCommands, PostError, RigidBodyCommand,
    RigidBodyInfo, SensorInfo, SensorType, Snapshot, StepOrder, WATCHDOG_TIMEOUT,
};
use ambf_core::ids::{ActuatorId, BodyId, GhostId, SensorId};
use parking_lot::Mutex;

use super::messages::ambf_msgs::{ActuatorCmd, RigidBodyCmd, Step, StepReq, StepRes};
use super::service::service_of;
use super::topics::rigid_body::{self, Requests};
use super::topics::{actuator, contact, ghost, sensor};
use ros_node::ServiceServer;

/// Most iterations of one request, and the longest patience, s.
const MAX_STEPS: u32 = 1_000_000;
const MAX_PATIENCE: f64 = 3600.0;

/// An object that can be commanded or observed by steps.
pub(super) struct Steppable {
    /// Position in the hub.
    pub object: HubIndex,
    pub info: ObjectInfo,
    pub kind: Kind,
}

/// What it is.
pub(super) enum Kind {
    Body { source: Box<Mutex<rigid_body::StateSource>>, requests: Arc<Requests>, n_joints: usize },
    Sensor(SensorId, SensorInfo),
    Actuator(ActuatorId, ActuatorInfo),
    Ghost(GhostId, GhostInfo),
}

impl Kind {
    /// The body at `index` of the snapshot's bodies.
    pub fn body(index: BodyId, body: &RigidBodyInfo, info: &ObjectInfo, requests: &Arc<Requests>) -> Self {
        let n_joints = body.joint_names.len().max(body.joints.len());
        let source =
            rigid_body::StateSource::new(index, body.clone(), &info.name, &info.identifier, Arc::clone(requests));
        // The client knows the names.
        let source = source.without_names();
        Self::Body { source: Box::new(Mutex::new(source)), requests: Arc::clone(requests), n_joints }
    }
}

/// Objects by what their topics begin with.
#[derive(Default)]
pub(super) struct Steppables(Mutex<HashMap<String, Arc<Steppable>>>);

impl Steppables {
    /// Adds an object; one of the same name that was there before is forgotten.
    pub fn insert(&self, name: String, steppable: Steppable) {
        self.0.lock().insert(name, Arc::new(steppable));
    }

    /// The object of that name, unless it has been removed from the scene.
    fn find(&self, hub: &Hub, name: &str) -> Result<Arc<Steppable>, String> {
        let found = self.0.lock().get(name).cloned();
        let found = found.filter(|found| hub.objects().get(found.object).is_some_and(|object| !object.is_removed()));
        found.ok_or_else(|| {
            format!("there is no body, sensor, actuator or ghost object \"{name}\"; names are those of topics, without /State")
        })
    }
}

/// The service, called `name`.
pub(super) fn service(name: String, hub: &Arc<Hub>, objects: &Arc<Steppables>) -> Arc<ServiceServer> {
    let (hub, objects) = (Arc::clone(hub), Arc::clone(objects));
    service_of::<Step>(name, move |request| reply(&hub, &objects, &request))
}

/// What a request becomes, whoever asks.
pub(super) fn reply(hub: &Hub, objects: &Steppables, request: &StepReq) -> StepRes {
    let refused = |message| StepRes { success: false, message, ..StepRes::default() };
    answer(hub, objects, request).unwrap_or_else(refused)
}

/// Everything that a request asks for, found and checked.
#[derive(Default)]
struct Checked {
    bodies: Vec<(HubIndex, RigidBodyCommand)>,
    actuators: Vec<(HubIndex, ActuatorCommand)>,
    observed: Vec<Arc<Steppable>>,
}

fn answer(hub: &Hub, objects: &Steppables, request: &StepReq) -> Result<StepRes, String> {
    let order = order(request)?;
    let checked = check(hub, objects, request)?;
    let post = |order: &OrderedCommands| -> Result<(), PostError> {
        checked.bodies.iter().try_for_each(|(object, command)| order.post(*object, command))?;
        checked.actuators.iter().try_for_each(|(object, command)| order.post(*object, command))
    };
    let snapshot = hub.step(order, post).map_err(|error| error.to_string())?;
    let mut answer =
        StepRes { success: true, sim_step: snapshot.sim_step, sim_time: snapshot.sim_time, ..StepRes::default() };
    checked.observed.iter().try_for_each(|observed| observe(observed, &snapshot, &mut answer))?;
    Ok(answer)
}

fn order(request: &StepReq) -> Result<StepOrder, String> {
    if request.steps > MAX_STEPS {
        return Err(format!("{} steps; {MAX_STEPS} are the most", request.steps));
    }
    if !(0.0..=MAX_PATIENCE).contains(&request.patience) {
        return Err(format!("a patience of {} s; expected 0 to {MAX_PATIENCE}", request.patience));
    }
    let patience = Duration::from_secs_f64(request.patience);
    let patience = if patience.is_zero() { WATCHDOG_TIMEOUT } else { patience };
    Ok(StepOrder { steps: request.steps, reset: request.reset, patience })
}

fn check(hub: &Hub, objects: &Steppables, request: &StepReq) -> Result<Checked, String> {
    let mut checked = Checked::default();
    for (name, message) in pairs(&request.body_names, &request.body_commands, "bodies")? {
        let found = objects.find(hub, name)?;
        let Kind::Body { requests, n_joints, .. } = &found.kind else {
            return Err(format!("\"{name}\" is no rigid body"));
        };
        let command = body_command(name, message, *n_joints)?;
        requests.note(message);
        checked.bodies.push((found.object, command));
    }
    for (name, message) in pairs(&request.actuator_names, &request.actuator_commands, "actuators")? {
        let found = objects.find(hub, name)?;
        if !matches!(found.kind, Kind::Actuator(..)) {
            return Err(format!("\"{name}\" is no actuator"));
        }
        checked.actuators.push((found.object, actuator_command(name, message)?));
    }
    for name in &request.observe {
        checked.observed.push(objects.find(hub, name)?);
    }
    Ok(checked)
}

fn pairs<'a, C>(
    names: &'a [String],
    commands: &'a [C],
    what: &str,
) -> Result<impl Iterator<Item = (&'a String, &'a C)>, String> {
    if names.len() != commands.len() {
        return Err(format!("{} names, but {} commands of {what}", names.len(), commands.len()));
    }
    Ok(names.iter().zip(commands))
}

fn body_command(name: &str, message: &RigidBodyCmd, n_joints: usize) -> Result<RigidBodyCommand, String> {
    let command = rigid_body::command(message, n_joints);
    match rigid_body::unknown_type(&command) {
        Some(what) => Err(format!("{name}: {what}")),
        None => finite(name, command),
    }
}

fn actuator_command(name: &str, message: &ActuatorCmd) -> Result<ActuatorCommand, String> {
    let command = actuator::command(message.clone()).map_err(|why| format!("{name}: {why}"))?;
    finite(name, command)
}

/// A step either happens with all its commands or not at all.
fn finite<C: ambf_core::comm::Command>(name: &str, command: C) -> Result<C, String> {
    if command.is_finite() {
        Ok(command)
    } else {
        Err(format!("the command for {name} holds a number that is not finite"))
    }
}

fn observe(observed: &Steppable, snapshot: &Snapshot, answer: &mut StepRes) -> Result<(), String> {
    let Steppable { info, kind, .. } = observed;
    let there = match kind {
        Kind::Body { source, .. } => {
            let state = source.lock().message(snapshot);
            state.map(|state| answer.bodies.push(state))
        }
        Kind::Sensor(index, sensor) if sensor.kind == SensorType::Contact => {
            contact::state(info, *index, sensor, snapshot).map(|state| answer.contact_sensors.push(state))
        }
        Kind::Sensor(index, sensor) => {
            sensor::state(info, *index, sensor, snapshot).map(|state| answer.sensors.push(state))
        }
        Kind::Actuator(index, actuator) => {
            actuator::state(info, *index, actuator, snapshot).map(|state| answer.actuators.push(state))
        }
        Kind::Ghost(index, ghost) => ghost::state(info, *index, ghost, snapshot).map(|state| answer.ghosts.push(state)),
    };
    there.ok_or_else(|| format!("{} is not in the state yet", info.name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectKind, Rates};
    use ambf_core::ids::JointId;

    fn steppables() -> (Arc<Hub>, Steppables) {
        let object = |kind, name: &str| ObjectInfo {
            kind,
            namespace: "/e/".into(),
            name: name.into(),
            identifier: format!("/e/{name}"),
            rates: Rates::default(),
        };
        let body = RigidBodyInfo { joint_names: vec!["j".into()], joints: vec![JointId::new(0)], ..Default::default() };
        let infos = [
            object(ObjectKind::RigidBody(BodyId::new(0), Box::new(body.clone())), "box"),
            object(ObjectKind::Actuator(ActuatorId::new(0), Box::default()), "holder"),
        ];
        let steppables = Steppables::default();
        let kind = Kind::body(BodyId::new(0), &body, &infos[0], &Arc::default());
        steppables.insert("/e/box".into(), Steppable { object: HubIndex(0), info: infos[0].clone(), kind });
        let kind = Kind::Actuator(ActuatorId::new(0), ActuatorInfo::default());
        steppables.insert("/e/holder".into(), Steppable { object: HubIndex(1), info: infos[1].clone(), kind });
        (Arc::new(Hub::new(infos.to_vec())), steppables)
    }

    fn why(request: &StepReq) -> String {
        let (hub, steppables) = steppables();
        match check(&hub, &steppables, request).and_then(|_| order(request)) {
            Ok(_) => String::new(),
            Err(why) => why,
        }
    }

    #[test]
    fn a_request_is_checked_before_anything_moves() {
        let good = StepReq {
            steps: 1,
            body_names: vec!["/e/box".into()],
            body_commands: vec![RigidBodyCmd { joint_cmds: vec![1.0, 2.0], ..Default::default() }],
            actuator_names: vec!["/e/holder".into()],
            actuator_commands: vec![ActuatorCmd::default()],
            observe: vec!["/e/holder".into(), "/e/box".into()],
            ..Default::default()
        };
        assert_eq!(why(&good), "");
        assert!(why(&StepReq { observe: vec!["box".into()], ..good.clone() }).contains("no body"));
        assert!(why(&StepReq { body_names: vec![], ..good.clone() }).contains("0 names, but 1 commands"));
        assert!(why(&StepReq { body_names: vec!["/e/holder".into()], ..good.clone() }).contains("no rigid body"));
        assert!(why(&StepReq { actuator_names: vec!["/e/box".into()], ..good.clone() }).contains("no actuator"));
        let nan = RigidBodyCmd { joint_cmds: vec![f32::NAN], ..Default::default() };
        assert!(why(&StepReq { body_commands: vec![nan], ..good.clone() }).contains("not finite"));
        let unknown = RigidBodyCmd { cartesian_cmd_type: 9, ..Default::default() };
        assert!(why(&StepReq { body_commands: vec![unknown], ..good.clone() }).contains("does not exist"));
        assert!(why(&StepReq { patience: f64::NAN, ..good.clone() }).contains("patience"));
        assert!(why(&StepReq { steps: MAX_STEPS + 1, ..good }).contains("the most"));
    }

    #[test]
    fn removed_objects_are_not_found() {
        let (hub, steppables) = steppables();
        assert!(steppables.find(&hub, "/e/box").is_ok());
        hub.remove_objects([HubIndex(0)]);
        assert!(steppables.find(&hub, "/e/box").is_err());
    }
}

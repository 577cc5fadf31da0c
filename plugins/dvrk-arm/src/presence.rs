//! Whether an arm could be used now: by what the ROS master lists and what the arm says, without telling it anything.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_device::Presence;
use parking_lot::Mutex;
use ros_node::{LinkOptions, Node, NodeName, OwnMaster, Peer};

use crate::dialect::{arms, readings, Dialect, Names, Reading};
use crate::hub::published;
use crate::options::ArmOptions;
use crate::session::subscribe;
use crate::wire;

/// How long the master may take to answer.
const MASTER_TIMEOUT: Duration = Duration::from_secs(1);

/// How long the arm may take to say where it is and in which state: a robot publishes both 100 times a second, or the
/// state once for all who come later.
const PATIENCE: Duration = Duration::from_secs(3);

/// What the arm called `names` says of itself.
pub(crate) fn presence(names: &Names, options: &ArmOptions) -> Presence {
    let uri = ros_node::master_uri();
    let unknown = |error: &dyn std::fmt::Display| {
        Presence::Unknown(format!(
            "{error}; arms are known by their topics only, and looked for while the simulator runs"
        ))
    };
    let topics = Peer::new(&uri, "/dvrk_arm", MASTER_TIMEOUT).and_then(|master| Ok((published(&master)?, master)));
    let (topics, master) = match topics {
        Ok(listed) => listed,
        Err(error) => return unknown(&error),
    };
    let Some(&dialect) = names.dialects(options.dialect, &topics).first() else {
        let others = match arms(options.namespace.as_deref(), &topics) {
            others if others.is_empty() => "no arm is published at all".to_owned(),
            others => format!("arms that are published: {}", others.join(", ")),
        };
        return Presence::NotReady(format!("nobody publishes the pose of {} at {uri}; {others}", names.identity()));
    };
    let has_state = topics_of(names, dialect, Reading::State).iter().any(|topic| topics.contains_key(topic));
    match listen(names, dialect, has_state, master) {
        Ok(heard) => judge(&heard, dialect, has_state),
        Err(error) => unknown(&error),
    }
}

/// What an arm has said.
#[derive(Debug, Clone, Default, PartialEq)]
struct Heard {
    has_pose: bool,
    state: Option<wire::State>,
}

/// Topics of an arm that tell `what`.
fn topics_of(names: &Names, dialect: Dialect, what: Reading) -> Vec<String> {
    let readings = readings(dialect, false).into_iter().filter(|(_, reading)| *reading == what);
    readings.map(|(name, _)| names.topic(dialect, name)).collect()
}

/// Listens to pose and state with a node of its own, until both have come or [`PATIENCE`] is over.
fn listen(names: &Names, dialect: Dialect, has_state: bool, master: Peer) -> std::io::Result<Heard> {
    let heard = Arc::<Mutex<Heard>>::default();
    let node = Node::start(LinkOptions {
        master,
        name: NodeName::Anonymous("dvrk_arm_presence".into()),
        own_master: OwnMaster::None,
        parameters: Vec::new(),
        report: ros_node::silent(),
    })?;
    let quiet = |_: &str| ();
    node.link().add(topics_of(names, dialect, Reading::Pose).into_iter().map(|topic| {
        let heard = Arc::clone(&heard);
        let take = move |kind: &str, bytes: &[u8]| {
            // Robots that speak CRTK mark samples that are not valid by leaving out the time.
            let is_valid = wire::pose(kind, bytes)?.stamped != Some(false) || !dialect.is_crtk();
            heard.lock().has_pose |= is_valid;
            Some(())
        };
        subscribe(topic, wire::POSE_TYPES, take, quiet)
    }));
    node.link().add(topics_of(names, dialect, Reading::State).into_iter().map(|topic| {
        let heard = Arc::clone(&heard);
        let take = move |kind: &str, bytes: &[u8]| {
            heard.lock().state = Some(wire::state(kind, bytes)?);
            Some(())
        };
        subscribe(topic, wire::STATE_TYPES, take, quiet)
    }));
    let deadline = Instant::now() + PATIENCE;
    let is_complete = || {
        let heard = heard.lock();
        heard.has_pose && (heard.state.is_some() || !has_state)
    };
    while !is_complete() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(5));
    }
    node.stop();
    let heard = heard.lock().clone();
    Ok(heard)
}

fn judge(heard: &Heard, dialect: Dialect, has_state: bool) -> Presence {
    let within = PATIENCE.as_secs();
    if !heard.has_pose {
        return Presence::NotReady(format!(
            "the master lists it, but no valid pose comes within {within} s: is its node alive, and does it reach this computer (ROS_IP)?"
        ));
    }
    let Some(state) = &heard.state else {
        return match has_state && dialect.is_crtk() {
            true => {
                Presence::NotReady(format!("poses come, but its state, which is listed, does not within {within} s"))
            }
            false => Presence::There(format!("poses come, dialect {dialect}; it publishes no state")),
        };
    };
    let homed = match state.homed_busy {
        Some((true, _)) => ", homed",
        Some((false, _)) => ", not homed",
        None => "",
    };
    let said = format!("poses come, dialect {dialect}, {}{homed}", state.name);
    match state.is_ready() {
        true => Presence::There(said),
        false => Presence::NotReady(format!("{said}: enable and home it from its console before forces are sent")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_is_judged_by_what_it_says() {
        let state = |name: &str, homed_busy| Some(wire::State { name: name.into(), homed_busy });
        let of = |has_pose, state| judge(&Heard { has_pose, state }, Dialect::CrtkPose, true);
        assert!(matches!(of(true, state("ENABLED", Some((true, false)))), Presence::There(_)));
        for (has_pose, state, part) in [
            (false, state("ENABLED", Some((true, false))), "no valid pose"),
            (true, state("ENABLED", Some((false, false))), "not homed"),
            (true, state("ENABLED", Some((true, true))), "ENABLED"),
            (true, state("DISABLED", Some((true, false))), "DISABLED"),
            (true, None, "its state"),
        ] {
            let Presence::NotReady(why) = of(has_pose, state.clone()) else { panic!("{has_pose} {state:?}") };
            assert!(why.contains(part), "{why}");
        }
        let legacy = |state| judge(&Heard { has_pose: true, state }, Dialect::Legacy, true);
        assert!(matches!(legacy(state("DVRK_EFFORT_CARTESIAN", None)), Presence::There(_)));
        assert!(matches!(legacy(state("DVRK_UNINITIALIZED", None)), Presence::NotReady(_)));
        assert!(matches!(legacy(None), Presence::There(_)), "as the driver takes it");
    }
}

//! A master in a process of its own, which lasts as long as somebody uses it.
//!
//! A master that ends with the program that brought it leaves every other node without one: rospy nodes then freeze
//! without a word. So a program that finds no master starts itself again as one ([`start_master`], [`serve_master`]),
//! and may end and start again while its clients go on.

use std::collections::{BTreeMap, HashSet};
use std::ffi::OsString;
use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use dxr::Value;
use rustix::process::{kill_process, setsid, Pid, Signal};
use thiserror::Error;

use super::log::{LogAggregator, AGGREGATOR};
use super::master::Master;
use super::xmlrpc::{CallError, Peer};

/// First argument of a program that is started to be a master; the second is the socket address it serves.
pub const SERVE_MASTER: &str = "--serve-master";

/// How long a master without any registration goes on.
pub const UNUSED: Duration = Duration::from_secs(15);

/// How often the master looks who is registered.
const POLL: Duration = Duration::from_secs(1);

/// How long a call to a master or a connection to a node of this machine may take.
const TIMEOUT: Duration = Duration::from_secs(1);

/// How long [`end_master`] waits.
const END_TIMEOUT: Duration = Duration::from_secs(5);

/// Starts `program`, which has to hand its arguments to [`serve_master`] when the first is [`SERVE_MASTER`], as a
/// master on `address`. It goes on when this process ends. The id of its process.
///
/// # Errors
/// When the program cannot be started.
pub fn start_master(program: &Path, address: SocketAddr) -> io::Result<u32> {
    let mut command = Command::new(program);
    command.arg(SERVE_MASTER).arg(address.to_string()).current_dir("/");
    // Whoever reads the output of this program is not to wait for the end of the master's.
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    Ok(command.spawn()?.id())
}

/// If `arguments`, those of the process without its name, ask for a master: serves until nobody has been registered for
/// [`UNUSED`]. `None` when they ask for something else.
///
/// Nodes of this machine at whose address nobody listens any more, because they were killed, are unregistered.
pub fn serve_master(mut arguments: impl Iterator<Item = OsString>) -> Option<io::Result<()>> {
    if arguments.next()? != SERVE_MASTER {
        return None;
    }
    let address = arguments.next().and_then(|address| address.to_str()?.parse().ok());
    let usage = || io::Error::new(io::ErrorKind::InvalidInput, format!("{SERVE_MASTER}: expected HOST:PORT"));
    Some(address.ok_or_else(usage).and_then(|address| serve(address, UNUSED)))
}

fn serve(address: SocketAddr, unused: Duration) -> io::Result<()> {
    // Ctrl+C in the terminal of the program that started it, and the end of that terminal, are not meant for it. It
    // fails where it is a session of its own already.
    let _ = setsid();
    let _master = Master::start(address)?;
    let own = match address.ip() {
        ip if ip.is_unspecified() => IpAddr::from([127, 0, 0, 1]),
        ip => ip,
    };
    let uri = format!("http://{}/", SocketAddr::new(own, address.port()));
    let master = Peer::new(&uri, "/master", TIMEOUT).map_err(io::Error::other)?;
    let _log = LogAggregator::start(&master)?;
    let (mut used, mut suspects) = (Instant::now(), HashSet::new());
    while used.elapsed() < unused {
        sleep(POLL);
        let Ok(nodes) = registered(&master) else { continue };
        let gone = nodes.keys().filter(|name| is_gone(&master, name)).cloned().collect::<HashSet<_>>();
        for name in gone.intersection(&suspects) {
            unregister(&master, name, &nodes[name]);
        }
        if nodes.keys().any(|name| !gone.contains(name) && name != AGGREGATOR) {
            used = Instant::now();
        }
        // Only who is gone twice in a row: a node may be just starting.
        suspects = gone;
    }
    Ok(())
}

/// What a node has registered.
#[derive(Debug, Default, PartialEq)]
struct Registrations {
    published: Vec<String>,
    subscribed: Vec<String>,
    services: Vec<String>,
}

/// What is registered at `master`, by node.
fn registered(master: &Peer) -> Result<BTreeMap<String, Registrations>, CallError> {
    let mut nodes: BTreeMap<String, Registrations> = BTreeMap::new();
    let Value::Array(parts) = master.call("getSystemState", vec![])? else { return Ok(nodes) };
    let kinds: [fn(&mut Registrations) -> &mut Vec<String>; 3] =
        [|node| &mut node.published, |node| &mut node.subscribed, |node| &mut node.services];
    for (part, kind) in parts.iter().zip(kinds) {
        for (name, users) in entries(part) {
            for user in users {
                kind(nodes.entry(user.to_owned()).or_default()).push(name.to_owned());
            }
        }
    }
    Ok(nodes)
}

/// Names, and who uses each, in `[[name, [user, …]], …]`: one of the three parts of what `getSystemState` answers.
pub fn entries(part: &Value) -> impl Iterator<Item = (&str, Vec<&str>)> {
    fn list(value: &Value) -> &[Value] {
        match value {
            Value::Array(list) => list,
            _ => &[],
        }
    }
    fn text(value: &Value) -> Option<&str> {
        match value {
            Value::String(text) => Some(text),
            _ => None,
        }
    }
    list(part).iter().filter_map(|entry| match list(entry) {
        [name, users] => Some((text(name)?, list(users).iter().filter_map(text).collect())),
        _ => None,
    })
}

/// The node called `name`, as the master knows it.
///
/// # Errors
/// Those of [`Peer::call`], and of [`Peer::new`] for an address that is none.
pub fn node(master: &Peer, name: &str) -> Result<Peer, CallError> {
    match master.call("lookupNode", vec![Value::String(name.to_owned())])? {
        Value::String(uri) => Peer::new(&uri, "/master", TIMEOUT),
        _ => Err(CallError::NotRos(master.uri().to_owned())),
    }
}

/// Whether the node called `name` was on this machine and nobody listens at its address. Of other machines one cannot
/// tell: they may be out of reach for the master and not for others.
fn is_gone(master: &Peer, name: &str) -> bool {
    let Some(addresses) = node(master, name).ok().and_then(|node| node.addresses().ok()) else { return false };
    let is_here = |address: &SocketAddr| address.ip().is_loopback() || TcpListener::bind((address.ip(), 0)).is_ok();
    let refuses = |address: &SocketAddr| {
        TcpStream::connect_timeout(address, TIMEOUT).is_err_and(|e| e.kind() == io::ErrorKind::ConnectionRefused)
    };
    !addresses.is_empty() && addresses.iter().all(|address| is_here(address) && refuses(address))
}

/// Unregisters all that the node called `name` has.
fn unregister(master: &Peer, name: &str, of: &Registrations) {
    let Ok(uri) = node(master, name).map(|node| node.uri().to_owned()) else { return };
    let master = master.called_by(name);
    let text = |text: &str| Value::String(text.to_owned());
    // It is tried again in the next round.
    for topic in &of.published {
        let _ = master.call("unregisterPublisher", vec![text(topic), text(&uri)]);
    }
    for topic in &of.subscribed {
        let _ = master.call("unregisterSubscriber", vec![text(topic), text(&uri)]);
    }
    for service in &of.services {
        if let Ok(Value::String(api)) = master.call("lookupService", vec![text(service)]) {
            let _ = master.call("unregisterService", vec![text(service), text(&api)]);
        }
    }
}

/// Error when a master cannot be ended.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EndError {
    /// Error when the master is no process that [`start_master`] has started, as `roscore`.
    #[error(
        "the master at {uri} is not one that a simulator left behind (process {pid}): end it where it was started"
    )]
    Foreign {
        /// Its address.
        uri: String,
        /// Its process, on its machine.
        pid: i32,
    },
    /// Error when it answers, but not as a master does.
    #[error(transparent)]
    Call(#[from] CallError),
    /// Error when it cannot be told, or does not end.
    #[error("the master at {uri} (process {pid}) cannot be ended: {reason}")]
    Stays {
        /// Its address.
        uri: String,
        /// Its process.
        pid: i32,
        /// What the system says.
        reason: io::Error,
    },
}

/// Ends the master at `uri`, if it is one that [`start_master`] started on this machine. False when there is none.
///
/// # Errors
/// [`EndError`].
pub fn end_master(uri: &str) -> Result<bool, EndError> {
    let master = Peer::new(uri, "/end_master", TIMEOUT)?;
    let pid = match master.call("getPid", vec![]) {
        Ok(Value::Integer(pid)) => pid,
        Ok(_) => return Err(CallError::NotRos(uri.to_owned()).into()),
        Err(CallError::NoAnswer { .. }) => return Ok(false),
        Err(error) => return Err(error.into()),
    };
    let arguments = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    let is_ours = arguments.split(|&byte| byte == 0).nth(1) == Some(SERVE_MASTER.as_bytes());
    let Some(process) = Pid::from_raw(pid).filter(|_| is_ours) else {
        return Err(EndError::Foreign { uri: uri.to_owned(), pid });
    };
    let stays = |reason| EndError::Stays { uri: uri.to_owned(), pid, reason };
    kill_process(process, Signal::TERM).map_err(|error| stays(error.into()))?;
    let deadline = Instant::now() + END_TIMEOUT;
    while master.call("getPid", vec![]).is_ok() {
        if Instant::now() > deadline {
            return Err(stays(io::ErrorKind::TimedOut.into()));
        }
        sleep(Duration::from_millis(20));
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread;

    fn free_address() -> SocketAddr {
        TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
    }

    fn until(what: &str, mut condition: impl FnMut() -> bool) {
        let deadline = Instant::now() + Duration::from_secs(20);
        while !condition() {
            assert!(Instant::now() < deadline, "waited in vain: {what}");
            sleep(Duration::from_millis(20));
        }
    }

    #[test]
    fn other_arguments_are_not_meant_for_it() {
        let asked = |arguments: &[&str]| serve_master(arguments.iter().map(OsString::from));
        assert!(asked(&[]).is_none() && asked(&["-l", "1"]).is_none());
        assert!(asked(&[SERVE_MASTER]).unwrap().is_err());
        assert!(asked(&[SERVE_MASTER, "somewhere"]).unwrap().is_err());
    }

    /// Goes on while a node is there, unregisters it when it is killed, and ends.
    #[test]
    fn it_serves_as_long_as_somebody_is_registered() {
        let address = free_address();
        let uri = format!("http://{address}/");
        static ENDED: AtomicBool = AtomicBool::new(false);
        let serving = thread::spawn(move || {
            serve(address, Duration::from_secs(3)).unwrap();
            ENDED.store(true, Ordering::Release);
        });
        let master = Peer::new(&uri, "/killed", TIMEOUT).unwrap();
        until("the master answers", || master.call("getPid", vec![]).is_ok());
        assert!(matches!(end_master(&uri), Err(EndError::Foreign { .. })), "this process is no master");

        // A node that only listens at its address.
        let node = TcpListener::bind("127.0.0.1:0").unwrap();
        let text = |text: &str| Value::String(text.to_owned());
        let own = text(&format!("http://{}/", node.local_addr().unwrap()));
        master.call("registerPublisher", vec![text("/topic"), text("std_msgs/Empty"), own.clone()]).unwrap();
        master.call("registerSubscriber", vec![text("/other"), text("std_msgs/Empty"), own.clone()]).unwrap();
        master.call("registerService", vec![text("/service"), text("rosrpc://localhost:1"), own]).unwrap();
        let all = || registered(&master).unwrap();
        let expected = Registrations {
            published: vec!["/topic".into()],
            subscribed: vec!["/other".into()],
            services: vec!["/service".into()],
        };
        assert_eq!(all()["/killed"], expected);
        sleep(Duration::from_secs(5));
        assert!(!ENDED.load(Ordering::Acquire), "somebody is registered");
        assert_eq!(all()["/killed"], expected);

        drop(node);
        until("it is unregistered", || registered(&master).is_ok_and(|nodes| !nodes.contains_key("/killed")));
        until("the master has ended", || ENDED.load(Ordering::Acquire));
        serving.join().unwrap();
        assert!(matches!(end_master(&uri), Ok(false)), "nobody is there any more");
    }
}

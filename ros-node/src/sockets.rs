//! Options of rosrust's sockets, which it neither sets nor hands out.
//!
//! Without a send time-out one subscriber that stops reading holds up all others of its topic for ever; without
//! `TCP_NODELAY` small messages wait for each other. On Linux an accepted socket inherits these from the listening one.
//! A second descriptor of each socket of this process is had through `pidfd_getfd`, without `unsafe`.

use std::collections::HashSet;
use std::fs;
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsFd, OwnedFd, RawFd};
use std::time::Duration;

use parking_lot::Mutex;
use rustix::net::sockopt;
use rustix::net::AddressFamily;
use rustix::process::{getpid, pidfd_getfd, pidfd_open, PidfdFlags, PidfdGetfdFlags};

use super::Report;

/// How long one subscriber may hold up the others of its topic before it is dropped.
const SEND_TIMEOUT: Duration = Duration::from_millis(200);

/// How long a client that connects to a topic and says nothing keeps others from connecting to it.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// What the kernel may hold back for one subscriber, bytes: some hundred states. Left to itself it takes megabytes, and
/// it takes that long to see that nobody reads.
const SEND_BUFFER: usize = 256 << 10;

/// A peer that vanished without a word is noticed after this much silence and a few unanswered probes.
const KEEP_ALIVE: Duration = Duration::from_secs(10);

/// Looks after the sockets of this process.
pub struct Sockets {
    pidfd: Option<OwnedFd>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// Sockets that have been looked at: descriptor and inode.
    seen: HashSet<(RawFd, String)>,
    /// Local ports on which this process listens.
    ports: HashSet<u16>,
}

impl Sockets {
    /// Reports once when the kernel does not allow it; sweeps then do nothing.
    pub fn new(report: &Report) -> Self {
        let pidfd = pidfd_open(getpid(), PidfdFlags::empty());
        // Containers forbid pidfd_getfd at times: try it on standard error, which is nearly always open.
        let pidfd = pidfd.and_then(|pidfd| match pidfd_getfd(&pidfd, 2, PidfdGetfdFlags::empty()) {
            Ok(_) | Err(rustix::io::Errno::BADF) => Ok(pidfd),
            Err(error) => Err(error),
        });
        if let Err(error) = &pidfd {
            report(format_args!(
                "ROS: the kernel does not let this process set its socket options ({error}): a subscriber that hangs can hold up \
                 others of its topic; in a container, allow pidfd_getfd (--cap-add SYS_PTRACE)"
            ));
        }
        Self { pidfd: pidfd.ok(), state: Mutex::default() }
    }

    /// Sets the options of all sockets that have come up since the last sweep.
    pub fn sweep(&self) {
        let Some(pidfd) = &self.pidfd else { return };
        let mut state = self.state.lock();
        let present = open_sockets();
        let fresh: Vec<OwnedFd> = present
            .difference(&state.seen)
            .filter_map(|&(fd, _)| pidfd_getfd(pidfd, fd, PidfdGetfdFlags::empty()).ok())
            .filter(|socket| {
                let domain = sockopt::socket_domain(socket);
                matches!(domain, Ok(AddressFamily::INET | AddressFamily::INET6))
                    && sockopt::socket_type(socket) == Ok(rustix::net::SocketType::STREAM)
            })
            .collect();
        state.seen = present;
        let (listening, connected): (Vec<_>, Vec<_>) =
            fresh.into_iter().partition(|socket| sockopt::socket_acceptconn(socket).unwrap_or(false));
        for socket in listening {
            let port = set_listening(socket);
            state.ports.extend(port);
        }
        for socket in connected {
            set_connected(socket, &state.ports);
        }
    }

    /// Bounds the wait for a subscriber's first words on the listening sockets at `ports`. Only for rosrust's topics:
    /// other servers take the failed `accept` that comes of it, once per time-out without a client, for the end.
    pub fn bound_handshakes(&self, ports: &HashSet<u16>) {
        let Some(pidfd) = &self.pidfd else { return };
        for (fd, _) in open_sockets() {
            let Ok(socket) = pidfd_getfd(pidfd, fd, PidfdGetfdFlags::empty()) else { continue };
            if sockopt::socket_acceptconn(&socket) != Ok(true) {
                continue;
            }
            let listener = TcpListener::from(socket);
            if listener.local_addr().is_ok_and(|address| ports.contains(&address.port())) {
                let _ = sockopt::set_socket_timeout(&listener, sockopt::Timeout::Recv, Some(HANDSHAKE_TIMEOUT));
            }
        }
    }

    /// Ports on which this process listens.
    pub fn ports(&self) -> Vec<u16> {
        self.state.lock().ports.iter().copied().collect()
    }
}

/// Descriptor and name (`socket:[inode]`) of every socket of this process.
fn open_sockets() -> HashSet<(RawFd, String)> {
    let entries = fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    entries
        .filter_map(|entry| {
            let fd = entry.file_name().to_str()?.parse().ok()?;
            let target = fs::read_link(entry.path()).ok()?.into_os_string().into_string().ok()?;
            target.starts_with("socket:").then_some((fd, target))
        })
        .collect()
}

/// A socket may be closed any time, so that errors mean nothing here and below.
fn set_listening(socket: OwnedFd) -> Option<u16> {
    let _ = sockopt::set_tcp_nodelay(&socket, true);
    set_accepting(&socket);
    let _ = sockopt::set_socket_keepalive(&socket, true);
    let _ = sockopt::set_tcp_keepidle(&socket, KEEP_ALIVE);
    TcpListener::from(socket).local_addr().ok().map(|address| address.port())
}

fn set_connected(socket: OwnedFd, listening_ports: &HashSet<u16>) {
    let _ = sockopt::set_socket_keepalive(&socket, true);
    let _ = sockopt::set_tcp_keepidle(&socket, KEEP_ALIVE);
    let stream = TcpStream::from(socket);
    let _ = stream.set_nodelay(true);
    // Others than accepted ones may wait for their peer as long as they like.
    if stream.local_addr().is_ok_and(|address| listening_ports.contains(&address.port())) {
        set_accepting(&stream);
    }
}

fn set_accepting(socket: impl AsFd) {
    let _ = sockopt::set_socket_timeout(&socket, sockopt::Timeout::Send, Some(SEND_TIMEOUT));
    let _ = sockopt::set_socket_send_buffer_size(&socket, SEND_BUFFER);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepted_sockets_inherit_from_the_listening_one_and_older_ones_are_swept() {
        let sockets = Sockets::new(&crate::silent());
        if sockets.pidfd.is_none() {
            println!("skipped: this kernel or container forbids pidfd_getfd");
            return;
        }
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let _early_client = TcpStream::connect(address).unwrap();
        let early = listener.accept().unwrap().0;
        assert_eq!((early.nodelay().unwrap(), early.write_timeout().unwrap()), (false, None));
        sockets.sweep();
        assert!(sockets.ports().contains(&address.port()));
        let _client = TcpStream::connect(address).unwrap();
        let late = listener.accept().unwrap().0;
        for stream in [early, late] {
            assert!(stream.nodelay().unwrap());
            assert_eq!(stream.write_timeout().unwrap(), Some(SEND_TIMEOUT));
        }
    }
}

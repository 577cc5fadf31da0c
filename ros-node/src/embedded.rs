//! A ROS master of our own, for when nobody else runs one.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::thread::JoinHandle;

use tokio::sync::oneshot;

use super::xmlrpc::Peer;
use super::Report;

/// A ROS master in this process. It lives until it is dropped.
pub struct EmbeddedMaster {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl EmbeddedMaster {
    /// Serves on `address`.
    ///
    /// # Errors
    /// When the port is taken or the runtime cannot be made.
    pub fn start(address: SocketAddr, report: Report) -> io::Result<Self> {
        // The master reports a failed bind only after it was started: see first whether the port is free.
        drop(TcpListener::bind(address)?);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new().name("ros-master".into()).spawn(move || {
            let master = ros_core_rs::core::Master::new(&address);
            runtime.block_on(async {
                tokio::select! {
                    result = master.serve() => {
                        if let Err(error) = result {
                            report(format_args!("ROS: the embedded master on {address} has ended: {error}"));
                        }
                    }
                    _ = stopped => (),
                }
            });
        })?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for EmbeddedMaster {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Where a master for `peer` has to listen so that `peer` reaches it: on loopback for a loopback address, on all
/// interfaces for another address of this machine; `None` when the address is that of another machine.
pub fn local_address(peer: &Peer) -> Option<SocketAddr> {
    let addresses = peer.addresses().ok()?;
    let v4 = addresses.iter().find(|address| address.is_ipv4());
    let address = *v4.or(addresses.first())?;
    if address.ip().is_loopback() {
        return Some(address);
    }
    // Only an address of this machine can be bound.
    TcpListener::bind((address.ip(), 0)).ok()?;
    let any = if address.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { std::net::Ipv6Addr::UNSPECIFIED.into() };
    Some(SocketAddr::new(any, address.port()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    fn peer(uri: &str) -> Peer {
        Peer::new(uri, "/test", Duration::from_secs(1)).unwrap()
    }

    #[test]
    fn only_addresses_of_this_machine_are_served() {
        assert_eq!(local_address(&peer("http://localhost:11311/")), Some("127.0.0.1:11311".parse().unwrap()));
        assert_eq!(local_address(&peer("http://127.0.0.1:7")), Some("127.0.0.1:7".parse().unwrap()));
        assert_eq!(local_address(&peer("http://192.0.2.1:11311/")), None, "TEST-NET-1 is nobody's");
    }

    #[test]
    fn it_answers_while_it_lives_and_frees_its_port() {
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let peer = peer(&format!("http://{address}/"));
        let master = EmbeddedMaster::start(address, crate::silent()).unwrap();
        let deadline = Instant::now() + Duration::from_secs(20);
        while peer.call("getPid", vec![]).is_err() {
            assert!(Instant::now() < deadline, "no answer");
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(EmbeddedMaster::start(address, crate::silent()).is_err(), "the port is taken");
        drop(master);
        assert!(peer.call("getPid", vec![]).is_err());
        drop(TcpListener::bind(address).expect("the port is free again"));
    }
}

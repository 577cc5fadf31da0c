//! Socket addresses of hosts.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs};

/// Socket addresses of `host`, a name or an address; resolving a name may take seconds.
///
/// `localhost` is 127.0.0.1 where the system does not know that name, as in containers without `/etc/hosts`.
///
/// # Errors
/// Those of the system, for a name that it does not know.
pub(crate) fn resolve(host: &str, port: u16) -> io::Result<Vec<SocketAddr>> {
    or_loopback(host, port, (host, port).to_socket_addrs().map(Iterator::collect))
}

/// What the system says of `host`, or what [`resolve`] promises in its place.
fn or_loopback(host: &str, port: u16, system: io::Result<Vec<SocketAddr>>) -> io::Result<Vec<SocketAddr>> {
    let is_known = system.as_ref().is_ok_and(|addresses| !addresses.is_empty());
    if !is_known && host.eq_ignore_ascii_case("localhost") {
        return Ok(vec![SocketAddr::from((Ipv4Addr::LOCALHOST, port))]);
    }
    system
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn localhost_needs_no_resolver() {
        let unknown = || Err(io::Error::other("failed to lookup address information"));
        let loopback: Vec<SocketAddr> = vec!["127.0.0.1:11311".parse().unwrap()];
        assert_eq!(or_loopback("localhost", 11311, unknown()).unwrap(), loopback);
        assert_eq!(or_loopback("LocalHost", 11311, Ok(Vec::new())).unwrap(), loopback);
        assert!(or_loopback("robot", 11311, unknown()).is_err());
    }

    #[test]
    fn what_the_system_knows_counts() {
        let v6: Vec<SocketAddr> = vec!["[::1]:11311".parse().unwrap()];
        assert_eq!(or_loopback("localhost", 11311, Ok(v6.clone())).unwrap(), v6);
        assert_eq!(resolve("192.0.2.7", 80).unwrap(), ["192.0.2.7:80".parse().unwrap()]);
        assert!(resolve("localhost", 80).unwrap().iter().all(|address| address.ip().is_loopback()));
    }
}

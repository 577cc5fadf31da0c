//! Services of the simulator: their messages, for the servers of [`ros_node`].

use std::sync::Arc;

use ros_node::{ServiceKind, ServiceServer};
use rosrust::{RosMsg, ServicePair};

use super::received::{self, FromClient};
use super::signal::RateLimitedLog;

/// Longest request, bytes: a request is a file, a name or some commands.
const LONGEST: usize = 64 << 10;

/// The service `name`. `answer` runs in a thread of its own for each client, so in several at once; it may block. What a
/// client did wrong is reported.
pub(super) fn service_of<S>(
    name: String,
    answer: impl Fn(S::Request) -> S::Response + Send + Sync + 'static,
) -> Arc<ServiceServer>
where
    S: ServicePair,
    S::Request: FromClient,
{
    let kind = ServiceKind { name: S::msg_type(), md5sum: S::md5sum(), longest: LONGEST };
    let complaints = RateLimitedLog::default();
    let answer = move |request: &[u8]| {
        let mut bytes = Vec::new();
        answer(received::read(request)?).encode(&mut bytes).map_err(|error| error.to_string())?;
        Ok(bytes)
    };
    ServiceServer::new(name, kind, answer, move |what| {
        complaints.report(what);
    })
}

//! Names of objects.

use ambf_core::comm::ObjectInfo;
use ambf_core::scene::Body;

/// The name under which an object is found: namespace and name, with one slash between their parts and `_` for what is
/// neither a letter, a digit nor a slash. The same as that of its topics where the simulator serves ROS.
pub fn of(object: &ObjectInfo) -> String {
    join(&object.namespace, &object.name)
}

/// The same of a body, whether it has a State and a Command or not.
pub fn of_body(body: &Body) -> String {
    let identity = &body.identity;
    join(&identity.namespace, &format!("{}{}", identity.name, identity.suffix))
}

fn join(namespace: &str, name: &str) -> String {
    let own = if name.is_empty() { "_" } else { name };
    let parts = namespace.split('/').chain(own.split('/')).filter(|part| !part.is_empty());
    parts.fold(String::new(), |name, part| {
        let legal = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        name + "/" + &part.chars().map(legal).collect::<String>()
    })
}

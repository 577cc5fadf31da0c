//! Names of objects.

use ambf_core::comm::ObjectInfo;

/// The name under which an object is found: namespace and name, with one slash between their parts and `_` for what is
/// neither a letter, a digit nor a slash. The same as that of its topics where the simulator serves ROS.
pub fn of(object: &ObjectInfo) -> String {
    let own = if object.name.is_empty() { "_" } else { &object.name };
    let parts = object.namespace.split('/').chain(own.split('/')).filter(|part| !part.is_empty());
    parts.fold(String::new(), |name, part| {
        let legal = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        name + "/" + &part.chars().map(legal).collect::<String>()
    })
}

//! Hashes of the messages are those that rosidl computes.

mod common;

use common::description;

/// The beginnings of the hashes that the generators of ROS 2 Jazzy compute, as `tests/ros2` finds them with rclpy, and
/// the package rosbags.
const HASHES: [(&str, &str); 25] = [
    ("ActuatorCmd", "e6432ad5d2e8781c"),
    ("ActuatorState", "e652c2f3d05cf6f9"),
    ("CameraCmd", "87c3dfc8593f0ef9"),
    ("CameraState", "7b347348a94c6545"),
    ("ContactData", "795431e39b2f8061"),
    ("ContactEvent", "04412cc71f1a721f"),
    ("ContactSensorCmd", "6aebc756d7d18f84"),
    ("ContactSensorState", "643047c7089043f9"),
    ("GhostObjectCmd", "66d58bd29d994b46"),
    ("GhostObjectState", "53d41b53a67f1ad8"),
    ("LightCmd", "3c00155c879bf93e"),
    ("LightState", "db3a57489794bfbb"),
    ("ObjectCmd", "17f0637fe77393b7"),
    ("ObjectState", "fce49ad6e3b53fa5"),
    ("RigidBodyCmd", "ba3481700d86a4a1"),
    ("RigidBodyState", "078723a1cef0a6bf"),
    ("SensorCmd", "4544b61a780d703b"),
    ("SensorState", "b8ec24784c34bb54"),
    ("SoftBodyCmd", "3169ec1402705ea2"),
    ("SoftBodyState", "8fc621250e7050da"),
    ("Timing", "28b89b6696e573ec"),
    ("VehicleCmd", "d8c4af446b2c0605"),
    ("VehicleState", "7d6e7114143ddef8"),
    ("WorldCmd", "34922435e243b809"),
    ("WorldState", "a4c69813297ee2c2"),
];

#[test]
fn messages_have_the_hashes_of_rosidl() {
    for (name, begins) in HASHES {
        let hash = description("ambf_msgs", name).type_hash();
        assert!(hash.starts_with(&format!("RIHS01_{begins}")), "{name}: {hash}");
    }
    for (name, begins) in [("OperatingState", "5cc57eea589b217f"), ("StringStamped", "83efb802e6596e03")] {
        let hash = description("crtk_msgs", name).type_hash();
        assert!(hash.starts_with(&format!("RIHS01_{begins}")), "{name}: {hash}");
    }
}

//! ROS messages, generated at build time from the definitions on `ROSRUST_MSG_PATH` (see `.cargo/config.toml`), and
//! conversions between their parts and the simulator's types.

#[allow(missing_docs, clippy::all, clippy::pedantic)]
mod generated {
    rosrust::rosmsg_include!(
        ambf_msgs / CameraCmd,
        ambf_msgs / CameraState,
        ambf_msgs / LightCmd,
        ambf_msgs / LightState,
        ambf_msgs / RigidBodyCmd,
        ambf_msgs / RigidBodyState,
        ambf_msgs / Timing,
        ambf_msgs / WorldCmd,
        ambf_msgs / WorldState,
        sensor_msgs / PointCloud,
        std_msgs / Empty,
        std_msgs / Float32
    );
}

use std::time::{SystemTime, UNIX_EPOCH};

use ambf_core::comm::Snapshot;
use nalgebra::{Isometry3, Vector3};

pub use generated::{ambf_msgs, geometry_msgs, sensor_msgs, std_msgs};

/// Header of a state: time stamp of the physics step, empty frame; the publisher fills in the running number. Without a
/// snapshot all zero, which rosrust sends with the time of sending.
pub fn header(snapshot: Option<&Snapshot>) -> std_msgs::Header {
    let mut header = std_msgs::Header::default();
    if let Some(snapshot) = snapshot {
        header.stamp = time(snapshot.stamp);
    }
    header
}

/// System time as a ROS time; times before 1970 become 0.
pub fn time(stamp: SystemTime) -> rosrust::Time {
    let since = stamp.duration_since(UNIX_EPOCH).unwrap_or_default();
    rosrust::Time { sec: since.as_secs() as u32, nsec: since.subsec_nanos() }
}

/// `std_msgs/String`.
pub fn string(text: &str) -> std_msgs::String {
    std_msgs::String { data: text.to_owned() }
}

/// `geometry_msgs/Vector3`.
pub fn vector(v: &Vector3<f64>) -> geometry_msgs::Vector3 {
    geometry_msgs::Vector3 { x: v.x, y: v.y, z: v.z }
}

/// `geometry_msgs/Point`.
pub fn point(v: &Vector3<f64>) -> geometry_msgs::Point {
    geometry_msgs::Point { x: v.x, y: v.y, z: v.z }
}

/// `geometry_msgs/Pose`.
pub fn pose(pose: &Isometry3<f64>) -> geometry_msgs::Pose {
    let q = pose.rotation.coords;
    geometry_msgs::Pose {
        position: point(&pose.translation.vector),
        orientation: geometry_msgs::Quaternion { x: q.x, y: q.y, z: q.z, w: q.w },
    }
}

/// Vector of a `geometry_msgs/Vector3`.
pub fn from_vector(v: &geometry_msgs::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// Vector of a `geometry_msgs/Point`.
pub fn from_point(v: &geometry_msgs::Point) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// Quaternion `[x, y, z, w]`, not normalised.
pub fn from_quaternion(q: &geometry_msgs::Quaternion) -> [f64; 4] {
    [q.x, q.y, q.z, q.w]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rosrust::Message;
    use std::time::Duration;

    #[test]
    fn types_are_those_of_the_original() {
        let sums = [
            (ambf_msgs::CameraCmd::msg_type(), ambf_msgs::CameraCmd::md5sum(), "4c77af9a51e6b28efe30862e7d6b0479"),
            (ambf_msgs::CameraState::msg_type(), ambf_msgs::CameraState::md5sum(), "a407bd98dbe1308fc98fc9d52379c405"),
            (ambf_msgs::LightCmd::msg_type(), ambf_msgs::LightCmd::md5sum(), "4c77af9a51e6b28efe30862e7d6b0479"),
            (ambf_msgs::LightState::msg_type(), ambf_msgs::LightState::md5sum(), "a407bd98dbe1308fc98fc9d52379c405"),
            (
                ambf_msgs::RigidBodyCmd::msg_type(),
                ambf_msgs::RigidBodyCmd::md5sum(),
                "c54fc48da5e84240a367eff7725e74b4",
            ),
            (
                ambf_msgs::RigidBodyState::msg_type(),
                ambf_msgs::RigidBodyState::md5sum(),
                "c0ba0eb38f2481828a038f3b17ce0623",
            ),
            (ambf_msgs::WorldCmd::msg_type(), ambf_msgs::WorldCmd::md5sum(), "6941ddbc8f8196cff4beb0278a6ad79d"),
            (ambf_msgs::WorldState::msg_type(), ambf_msgs::WorldState::md5sum(), "6e545bb4d1457db0c1ee58df8e46d570"),
            (
                sensor_msgs::PointCloud::msg_type(),
                sensor_msgs::PointCloud::md5sum(),
                "d8e9c3f5afbdd8a130fd1d2763945fca",
            ),
        ];
        for (name, sum, expected) in sums {
            assert_eq!(sum, expected, "{name}");
        }
        assert!(ambf_msgs::RigidBodyState::msg_definition().contains("geometry_msgs/Twist twist"));
    }

    #[test]
    fn times_keep_their_nanoseconds() {
        let t = time(UNIX_EPOCH + Duration::new(1_700_000_000, 123_456_789));
        assert_eq!((t.sec, t.nsec), (1_700_000_000, 123_456_789));
        assert_eq!(time(UNIX_EPOCH - Duration::from_secs(1)).sec, 0);
    }

    #[test]
    fn a_pose_goes_there_and_back() {
        let isometry = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.1, 0.2, 0.3));
        let wire = pose(&isometry);
        assert_eq!(from_point(&wire.position), isometry.translation.vector);
        let q = isometry.rotation;
        assert_eq!(from_quaternion(&wire.orientation), [q.i, q.j, q.k, q.w]);
    }
}

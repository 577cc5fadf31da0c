//! ROS messages, generated at build time from the definitions on `ROSRUST_MSG_PATH` (see `.cargo/config.toml`):
//! Debian's packages, and for `crtk_msgs` those under `resources/ros`.

#[allow(missing_docs, clippy::all, clippy::pedantic)]
mod generated {
    rosrust::rosmsg_include!(
        crtk_msgs / OperatingState,
        crtk_msgs / StringStamped,
        crtk_msgs / operating_state,
        geometry_msgs / Pose,
        geometry_msgs / PoseStamped,
        geometry_msgs / TransformStamped,
        geometry_msgs / TwistStamped,
        geometry_msgs / Wrench,
        geometry_msgs / WrenchStamped,
        sensor_msgs / JointState,
        sensor_msgs / Joy,
        std_msgs / Bool,
        std_msgs / Empty,
        std_msgs / Float32,
        std_msgs / Float64MultiArray,
        std_msgs / String
    );
}

pub use generated::{crtk_msgs, geometry_msgs, sensor_msgs, std_msgs};

use nalgebra::{Isometry3, Vector3};

use crate::frames::Wrench;

/// `geometry_msgs/Vector3`.
pub fn vector(v: &Vector3<f64>) -> geometry_msgs::Vector3 {
    geometry_msgs::Vector3 { x: v.x, y: v.y, z: v.z }
}

fn quaternion(pose: &Isometry3<f64>) -> geometry_msgs::Quaternion {
    let q = pose.rotation.coords;
    geometry_msgs::Quaternion { x: q.x, y: q.y, z: q.z, w: q.w }
}

/// `geometry_msgs/Pose`.
pub fn pose(pose: &Isometry3<f64>) -> geometry_msgs::Pose {
    let p = pose.translation;
    geometry_msgs::Pose { position: geometry_msgs::Point { x: p.x, y: p.y, z: p.z }, orientation: quaternion(pose) }
}

/// `geometry_msgs/Transform`.
pub fn transform(pose: &Isometry3<f64>) -> geometry_msgs::Transform {
    geometry_msgs::Transform { translation: vector(&pose.translation.vector), rotation: quaternion(pose) }
}

/// `geometry_msgs/Wrench`.
pub fn wrench(wrench: &Wrench) -> geometry_msgs::Wrench {
    geometry_msgs::Wrench { force: vector(&wrench.force), torque: vector(&wrench.torque) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rosrust::Message;

    #[test]
    fn types_are_those_that_robots_use() {
        fn check<M: Message>(name: &str, sum: &str) {
            assert_eq!((M::msg_type().as_str(), M::md5sum().as_str()), (name, sum));
        }
        check::<geometry_msgs::PoseStamped>("geometry_msgs/PoseStamped", "d3812c3cbc69362b77dc0b19b345f8f5");
        check::<geometry_msgs::TransformStamped>("geometry_msgs/TransformStamped", "b5764a33bfeb3588febc2682852579b0");
        check::<geometry_msgs::WrenchStamped>("geometry_msgs/WrenchStamped", "d78d3cb249ce23087ade7e7d0c40cfa7");
        check::<sensor_msgs::JointState>("sensor_msgs/JointState", "3066dcd76a6cfaef579bd0f34173e9fd");
        check::<sensor_msgs::Joy>("sensor_msgs/Joy", "5a9ea5f83505693b71e785041e67a8bb");
    }

    #[test]
    fn sums_of_our_own_definitions_are_those_of_their_fields() {
        // The checksum is that of the fields without comments, a nested type being replaced by its own checksum (2176…
        // is the header's). That is how genpy computes them: python3 -c "import hashlib; print(hashlib.md5(b'2176…
        // header\nstring string').hexdigest())"
        assert_eq!(crtk_msgs::StringStamped::md5sum(), "5e3e46086181199270f1ac3a28a5977f");
        assert_eq!(crtk_msgs::OperatingState::md5sum(), "b1bd4021639d9d9c5fbfff78d6ff3158");
        assert_eq!(crtk_msgs::operating_state::md5sum(), crtk_msgs::OperatingState::md5sum());
    }
}

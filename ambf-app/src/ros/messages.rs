//! ROS messages and services, generated at build time from the definitions on `ROSRUST_MSG_PATH` (see
//! `.cargo/config.toml`), and conversions between their parts and the simulator's types.

#[allow(missing_docs, clippy::all, clippy::pedantic)]
mod generated {
    rosrust::rosmsg_include!(
        ambf_msgs / ActuatorCmd,
        ambf_msgs / ActuatorState,
        ambf_msgs / AddModel,
        ambf_msgs / CameraCmd,
        ambf_msgs / CameraState,
        ambf_msgs / ContactSensorCmd,
        ambf_msgs / ContactSensorState,
        ambf_msgs / GhostObjectCmd,
        ambf_msgs / GhostObjectState,
        ambf_msgs / LightCmd,
        ambf_msgs / LightState,
        ambf_msgs / ListModels,
        ambf_msgs / RemoveModel,
        ambf_msgs / RigidBodyCmd,
        ambf_msgs / RigidBodyState,
        ambf_msgs / SensorCmd,
        ambf_msgs / SensorState,
        ambf_msgs / SoftBodyCmd,
        ambf_msgs / SoftBodyState,
        ambf_msgs / StartRecording,
        ambf_msgs / Step,
        ambf_msgs / StopRecording,
        ambf_msgs / Timing,
        ambf_msgs / VehicleCmd,
        ambf_msgs / VehicleState,
        ambf_msgs / VolumeCmd,
        ambf_msgs / WorldCmd,
        ambf_msgs / WorldState,
        diagnostic_msgs / DiagnosticArray,
        geometry_msgs / WrenchStamped,
        rosgraph_msgs / Clock,
        sensor_msgs / CameraInfo,
        sensor_msgs / CompressedImage,
        sensor_msgs / Image,
        sensor_msgs / PointCloud,
        sensor_msgs / PointCloud2,
        std_msgs / Bool,
        std_msgs / Empty,
        std_msgs / Float32,
        std_msgs / UInt8,
        tf2_msgs / TFMessage,
        volumetric_drilling_msgs / DrillSize,
        volumetric_drilling_msgs / Index,
        volumetric_drilling_msgs / VolumeInfo,
        volumetric_drilling_msgs / Voxels
    );
}

use std::time::{SystemTime, UNIX_EPOCH};

use ambf_core::comm::Snapshot;
use nalgebra::{Isometry3, Vector3};

pub use generated::{
    ambf_msgs, diagnostic_msgs, geometry_msgs, rosgraph_msgs, sensor_msgs, std_msgs, tf2_msgs, volumetric_drilling_msgs,
};

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

/// For a field of single precision: what is too large for it becomes the largest number, not infinite.
pub fn narrow(x: f64) -> f32 {
    x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

/// Whether nothing but zeros is in `v`.
pub fn is_zero(v: &geometry_msgs::Vector3) -> bool {
    [v.x, v.y, v.z] == [0.0; 3]
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
        fn check<M: Message>(name: &str, sum: &str) {
            assert_eq!((M::msg_type().as_str(), M::md5sum().as_str()), (name, sum));
        }
        check::<ambf_msgs::ActuatorCmd>("ambf_msgs/ActuatorCmd", "95500dea47e70fe03427341c7d1aa9f0");
        check::<ambf_msgs::ActuatorState>("ambf_msgs/ActuatorState", "bb54291f69633b7821b7930b1ec68d2b");
        check::<ambf_msgs::CameraCmd>("ambf_msgs/CameraCmd", "4c77af9a51e6b28efe30862e7d6b0479");
        check::<ambf_msgs::CameraState>("ambf_msgs/CameraState", "a407bd98dbe1308fc98fc9d52379c405");
        check::<ambf_msgs::LightCmd>("ambf_msgs/LightCmd", "4c77af9a51e6b28efe30862e7d6b0479");
        check::<ambf_msgs::LightState>("ambf_msgs/LightState", "a407bd98dbe1308fc98fc9d52379c405");
        check::<ambf_msgs::RigidBodyCmd>("ambf_msgs/RigidBodyCmd", "c54fc48da5e84240a367eff7725e74b4");
        check::<ambf_msgs::RigidBodyState>("ambf_msgs/RigidBodyState", "c0ba0eb38f2481828a038f3b17ce0623");
        check::<ambf_msgs::SensorCmd>("ambf_msgs/SensorCmd", "8f1886769be440a6a76a9e6c56ba2056");
        check::<ambf_msgs::SensorState>("ambf_msgs/SensorState", "e405887246b5afd9e382d4a7a0f69926");
        check::<ambf_msgs::SoftBodyCmd>("ambf_msgs/SoftBodyCmd", "091c255bd5039de21056e952538cf83c");
        check::<ambf_msgs::SoftBodyState>("ambf_msgs/SoftBodyState", "3dc87d37c7ec8f949bfbd135c2cfe5a8");
        check::<ambf_msgs::VehicleCmd>("ambf_msgs/VehicleCmd", "20858f9fdd87217d00304616067bb7b4");
        check::<ambf_msgs::VehicleState>("ambf_msgs/VehicleState", "0196943764f0cf7865b5798046e2027c");
        check::<ambf_msgs::WorldCmd>("ambf_msgs/WorldCmd", "6941ddbc8f8196cff4beb0278a6ad79d");
        check::<ambf_msgs::WorldState>("ambf_msgs/WorldState", "6e545bb4d1457db0c1ee58df8e46d570");
        check::<sensor_msgs::PointCloud>("sensor_msgs/PointCloud", "d8e9c3f5afbdd8a130fd1d2763945fca");
        check::<sensor_msgs::Image>("sensor_msgs/Image", "060021388200f6f0f447d0fcd9c64743");
        check::<sensor_msgs::CompressedImage>("sensor_msgs/CompressedImage", "8f7a12909da2c9d3332d540a0977563f");
        check::<sensor_msgs::PointCloud2>("sensor_msgs/PointCloud2", "1158d486dd51d683ce2f1be655c3c181");
        check::<sensor_msgs::CameraInfo>("sensor_msgs/CameraInfo", "c9a58c1b0b154e0e6da7578cb991d214");
        // Of version 3.0 of the C++ program: from its field lists.
        check::<ambf_msgs::ContactSensorCmd>("ambf_msgs/ContactSensorCmd", "d7be0bb39af8fb9129d5a76e6b63a290");
        check::<ambf_msgs::ContactSensorState>("ambf_msgs/ContactSensorState", "69bafc7aa5201075354dea9d8be980d5");
        check::<ambf_msgs::GhostObjectCmd>("ambf_msgs/GhostObjectCmd", "d7be0bb39af8fb9129d5a76e6b63a290");
        check::<ambf_msgs::GhostObjectState>("ambf_msgs/GhostObjectState", "415d13a1e544582332f8da23ceee6c2f");
        // Of the C++ drilling plugin.
        check::<volumetric_drilling_msgs::DrillSize>(
            "volumetric_drilling_msgs/DrillSize",
            "d9d4da25c106b8208dccc4d469ec477b",
        );
        check::<volumetric_drilling_msgs::Index>("volumetric_drilling_msgs/Index", "95da2541c9d6989c0876f480a9b1c7e4");
        check::<volumetric_drilling_msgs::Voxels>(
            "volumetric_drilling_msgs/Voxels",
            "7cd932ee96e95d914af050c7da8c2ecf",
        );
        check::<volumetric_drilling_msgs::VolumeInfo>(
            "volumetric_drilling_msgs/VolumeInfo",
            "eca5e1d3f35a79d6d1cc4d0b1037724c",
        );
        // Ours, as Debian's genpy computes them.
        check::<ambf_msgs::VolumeCmd>("ambf_msgs/VolumeCmd", "e6a542c8ed43a7763c2652788bb84090");
        check::<ambf_msgs::AddModel>("ambf_msgs/AddModel", "f5bd0122d8d7f607648fac2661ce032e");
        check::<ambf_msgs::ListModels>("ambf_msgs/ListModels", "ff08cbe897983592b3543e831685aaec");
        check::<ambf_msgs::StartRecording>("ambf_msgs/StartRecording", "3ee2846f09ac2bd5e5b041e7b0956bca");
        check::<ambf_msgs::StopRecording>("ambf_msgs/StopRecording", "d6bdf58d6a2102479e8c2b5401f43a85");
        check::<ambf_msgs::Step>("ambf_msgs/Step", "ebe26e09d74f794e63141d69f616e688");
        check::<ambf_msgs::RemoveModel>("ambf_msgs/RemoveModel", "6b1b98e3880995cce04976ee2d7995e8");
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

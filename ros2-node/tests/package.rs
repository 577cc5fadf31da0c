//! The package `resources/ros2/ambf_msgs` has the messages of ROS 1, with the changes that ROS 2 asks for.
//!
//! `AMBF_WRITE_ROS2_MESSAGES=1 cargo test -p ros2-node --test package` makes it anew.

mod common;

use std::fs;

/// A line of a definition as ROS 2 wants it: with the package of `Header`, and no capitals in names of fields.
fn converted(line: &str) -> String {
    if line.trim_start().starts_with('#') {
        return line.into();
    }
    let line = line.strip_prefix("Header ").map_or_else(|| line.into(), |rest| format!("std_msgs/Header {rest}"));
    line.replace(" pInertia", " p_inertia")
}

fn files(folder: &str) -> Vec<String> {
    let entries = fs::read_dir(common::root().join(folder)).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn the_package_of_ros_2_has_the_messages_of_ros_1() {
    let listed = fs::read_to_string(common::root().join("resources/ros2/ambf_msgs/CMakeLists.txt")).unwrap();
    for kind in ["msg", "srv"] {
        let (from, to) = (format!("resources/ros/ambf_msgs/{kind}"), format!("resources/ros2/ambf_msgs/{kind}"));
        for file in files(&from) {
            let text = fs::read_to_string(common::root().join(&from).join(&file)).unwrap();
            let wanted: String = text.lines().map(|line| converted(line) + "\n").collect();
            let own = common::root().join(&to).join(&file);
            if std::env::var_os("AMBF_WRITE_ROS2_MESSAGES").is_some() {
                fs::create_dir_all(own.parent().unwrap()).unwrap();
                fs::write(&own, &wanted).unwrap();
            }
            let is = fs::read_to_string(&own).unwrap_or_default();
            assert_eq!(is, wanted, "{}: AMBF_WRITE_ROS2_MESSAGES=1 makes it anew", own.display());
            assert!(listed.contains(&format!("\"{kind}/{file}\"")), "CMakeLists.txt does not name {kind}/{file}");
        }
        assert_eq!(files(&from), files(&to));
    }
}

"""The message package is the original's: same types, same MD5 sums, as ROS's own tools see them."""

import unittest

import harness

MD5 = {
    "ActuatorCmd": "95500dea47e70fe03427341c7d1aa9f0",
    "ActuatorState": "bb54291f69633b7821b7930b1ec68d2b",
    "CameraCmd": "4c77af9a51e6b28efe30862e7d6b0479",
    "CameraState": "a407bd98dbe1308fc98fc9d52379c405",
    "ContactData": "fa9406851f936701ab8c14a333a3f2e2",
    "ContactEvent": "eb82193058a0ca0d1eedde1e59b63259",
    "ContactSensorCmd": "d7be0bb39af8fb9129d5a76e6b63a290",
    "ContactSensorState": "69bafc7aa5201075354dea9d8be980d5",
    "GhostObjectCmd": "d7be0bb39af8fb9129d5a76e6b63a290",
    "GhostObjectState": "415d13a1e544582332f8da23ceee6c2f",
    "LightCmd": "4c77af9a51e6b28efe30862e7d6b0479",
    "LightState": "a407bd98dbe1308fc98fc9d52379c405",
    "ObjectCmd": "091c255bd5039de21056e952538cf83c",
    "ObjectState": "3dc87d37c7ec8f949bfbd135c2cfe5a8",
    "RigidBodyCmd": "c54fc48da5e84240a367eff7725e74b4",
    "RigidBodyState": "c0ba0eb38f2481828a038f3b17ce0623",
    "SensorCmd": "8f1886769be440a6a76a9e6c56ba2056",
    "SensorState": "e405887246b5afd9e382d4a7a0f69926",
    "SoftBodyCmd": "091c255bd5039de21056e952538cf83c",
    "SoftBodyState": "3dc87d37c7ec8f949bfbd135c2cfe5a8",
    "VehicleCmd": "20858f9fdd87217d00304616067bb7b4",
    "VehicleState": "0196943764f0cf7865b5798046e2027c",
    "WorldCmd": "6941ddbc8f8196cff4beb0278a6ad79d",
    "WorldState": "6e545bb4d1457db0c1ee58df8e46d570",
}


# Ours: the original has no such messages.
OURS = {
    "Timing": "b55fb23c03984cc94da469e767c1edc2",
    "VolumeCmd": "e6a542c8ed43a7763c2652788bb84090",
}

# Ours: the original has no services.
SERVICES = {
    "AddModel": "f5bd0122d8d7f607648fac2661ce032e",
    "ListModels": "ff08cbe897983592b3543e831685aaec",
    "RemoveModel": "6b1b98e3880995cce04976ee2d7995e8",
    "StartRecording": "3ee2846f09ac2bd5e5b041e7b0956bca",
    "Step": "ebe26e09d74f794e63141d69f616e688",
    "StopRecording": "d6bdf58d6a2102479e8c2b5401f43a85",
}


class Messages(unittest.TestCase):
    """No master and no simulator is needed."""

    def test_md5_of_every_message(self):
        """A different sum would keep every existing client from connecting."""
        for name, expected in (MD5 | OURS).items():
            with self.subTest(name):
                self.assertEqual(harness.ros(1, "rosmsg", "md5", f"ambf_msgs/{name}").strip(), expected)

    def test_the_package_holds_these_messages(self):
        """Nothing is missing and nothing unexpected is there."""
        listed = harness.ros(1, "rosmsg", "package", "ambf_msgs").split()
        self.assertEqual(sorted(listed), sorted(f"ambf_msgs/{name}" for name in [*MD5, *OURS]))
        cmake = (harness.REPOSITORY / "resources/ros/ambf_msgs/CMakeLists.txt").read_text()
        for name in listed:
            self.assertIn(name.split("/")[1] + ".msg", cmake)

    def test_services(self):
        """rossrv, the Python classes, the simulator and catkin know the same services."""
        import ambf_msgs.srv  # pylint: disable=import-outside-toplevel

        listed = harness.ros(1, "rossrv", "package", "ambf_msgs").split()
        self.assertEqual(sorted(listed), sorted(f"ambf_msgs/{name}" for name in SERVICES))
        cmake = (harness.REPOSITORY / "resources/ros/ambf_msgs/CMakeLists.txt").read_text()
        for name, expected in SERVICES.items():
            with self.subTest(name):
                self.assertEqual(harness.ros(1, "rossrv", "md5", f"ambf_msgs/{name}").strip(), expected)
                self.assertEqual(getattr(ambf_msgs.srv, name)._md5sum, expected)  # pylint: disable=protected-access
                self.assertIn(name + ".srv", cmake)

    def test_constants(self):
        """Scripts use the names of the command types."""
        from ambf_msgs.msg import RigidBodyCmd  # pylint: disable=import-outside-toplevel

        kinds = (RigidBodyCmd.TYPE_FORCE, RigidBodyCmd.TYPE_POSITION, RigidBodyCmd.TYPE_VELOCITY)
        self.assertEqual(kinds, (0, 1, 2))

"""The class between scripts and their version of ROS, with ROS 1, without a master."""

import os
import subprocess
import sys
import unittest
from unittest import mock

import rospy
from ambf_client import RigidBody, UnsupportedRos
from ambf_client.ros_abstraction_layer import ral
from ambf_msgs.msg import RigidBodyState
from std_msgs.msg import Empty, Header


def setUpModule():
    """ROS time is the system's; no master is needed for that."""
    rospy.rostime.set_rostime_initialized(True)


class Layer(unittest.TestCase):
    """A layer over a node that is there already."""

    def setUp(self):
        self.ral = ral("tests", "/ns/", node=object())

    def test_versions(self):
        """ROS 2 without rclpy, messages of the other version, and versions that do not exist are errors that say what to do."""
        self.assertEqual((ral.ros_version(), self.ral.ros_version()), (1, 1))
        with mock.patch.dict(os.environ, ROS_VERSION="2"):
            self.assertEqual(ral.ros_version(), 2)
            with self.assertRaisesRegex(UnsupportedRos, "rclpy for ROS 2: .*pip install"):
                ral("tests", node=object())
            there = mock.patch("ambf_client.versions.find_spec", return_value=object())
            with there, self.assertRaisesRegex(UnsupportedRos, "ROS 2 is meant.* for ROS 1: set ROS_VERSION=1"):
                ral("tests", node=object())
        with (
            mock.patch.dict(os.environ, ROS_VERSION="3"),
            self.assertRaisesRegex(ImportError, "ROS_VERSION is 3: .*1 or 2"),
        ):
            ral.ros_version()
        with mock.patch.dict(os.environ), mock.patch("ambf_client.versions.find_spec") as find:
            os.environ.pop("ROS_VERSION", None)
            find.side_effect = lambda name: name == "rclpy" or None
            self.assertEqual(ral.ros_version(), 2)
            find.side_effect = lambda name: name
            self.assertEqual(ral.ros_version(), 1)

    def test_what_is_missing(self):
        """A sentence says it when the package is imported, not a chain of errors when a topic is opened."""
        for missing in ("rospy", "std_msgs"):
            hidden = mock.patch(
                "ambf_client.versions.find_spec", lambda name, missing=missing: None if name == missing else name
            )
            with (
                hidden,
                mock.patch.dict(os.environ, ROS_VERSION="1"),
                self.assertRaisesRegex(UnsupportedRos, f"needs .*{missing} for ROS 1: "),
            ):
                ral("tests", node=object())
        program = "import sys; sys.modules['ambf_msgs'] = None; import ambf_client"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        self.assertIn("ambf_msgs for ROS 1 are missing; `source scripts/ros-env`", done.stderr)

    def test_arguments(self):
        """Those for ROS are taken out."""
        self.assertEqual(ral.parse_argv(["program", "-v", "a:=b", "__name:=x", "c"]), ["program", "-v", "c"])

    def test_times(self):
        """Times, headers, messages and durations are seconds."""
        stamp = rospy.Time(3, 500_000_000)
        for thing in (stamp, Header(stamp=stamp), RigidBodyState(header=Header(stamp=stamp)), rospy.Duration(3.5)):
            self.assertEqual(self.ral.to_sec(thing), 3.5)
        self.assertEqual(self.ral.create_duration(0.25).to_nsec(), 250_000_000)
        self.assertEqual(self.ral.create_time().to_nsec(), 0)
        self.assertEqual(self.ral.create_rate(50).sleep_dur.to_sec(), 0.02)
        self.assertLessEqual(self.ral.now().to_sec(), self.ral.to_sec(Header(stamp=self.ral.now_msg())))
        self.assertFalse(self.ral.is_shutdown())
        self.ral.spin()

    def test_names(self):
        """They are put below the namespace; absolute ones are not. A child's namespace is below its parent's."""
        child = self.ral.create_child("arm")
        self.assertIs(self.ral.create_child("arm"), child)
        self.assertEqual((child.node_name(), child.namespace()), ("tests", "/ns/arm"))
        with mock.patch("rospy.Publisher") as publisher, mock.patch("rospy.Subscriber") as subscriber:
            self.ral.publisher("a", Empty)
            publisher.assert_called_with("/ns/a", Empty, queue_size=10, latch=False)
            child.publisher("/a", Empty, 1, True, tcp_nodelay=True)
            publisher.assert_called_with("/a", Empty, queue_size=1, latch=True, tcp_nodelay=True)
            child.subscriber("b", Empty, print, queue_size=3, latch=True)
            subscriber.assert_called_with("/ns/arm/b", Empty, print, queue_size=3)
        with mock.patch("rospy.ServiceProxy") as service:
            self.ral.create_child("/else").service_client("c", "type")
            service.assert_called_with("/else/c", "type")
        with mock.patch("rospy.Publisher") as publisher:
            ral("tests", node=object()).publisher("relative/a", Empty)
            publisher.assert_called_with("relative/a", Empty, queue_size=10, latch=False)

    def test_it_is_no_name(self):
        """A handle that is made with one has the name that comes after it."""
        self.assertEqual(RigidBody(self.ral, "/a").get_name(), "/a")

"""What the tests of the client need to run with either version of ROS."""

from ambf_client.ros_abstraction_layer import ral


def set_up():
    """ROS time is the system's; no master is needed for that."""
    if ral.ros_version() == 1:
        import rospy

        rospy.rostime.set_rostime_initialized(True)

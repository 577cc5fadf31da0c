"""A client as a user would write it: reads states, drives a joint and a body, and ends with status 0 when they obeyed."""

import sys

import rospy
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState


class Driven:
    """A body of the simulator: its newest state, and a publisher of commands."""

    def __init__(self, name):
        self.state = None
        rospy.Subscriber(f"/ambf/env/{name}/State", RigidBodyState, self._receive)
        self.commands = rospy.Publisher(f"/ambf/env/{name}/Command", RigidBodyCmd, queue_size=1)

    def _receive(self, state):
        self.state = state

    def drive(self, command, is_there):
        """Sends `command` at 100 Hz until the state is there."""
        rate = rospy.Rate(100)
        while not (self.state and is_there(self.state)):
            if rospy.is_shutdown():
                sys.exit(1)
            self.commands.publish(command)
            rate.sleep()
        print(f"{self.state.name.data} obeyed", flush=True)


rospy.init_node("client")
base, wall = Driven("Base"), Driven("Wall")

joint = RigidBodyCmd(joint_cmds=[0.4], joint_cmds_types=[RigidBodyCmd.TYPE_POSITION])
base.drive(joint, lambda state: state.joint_names == ["Base-Link"] and abs(state.joint_positions[0] - 0.4) < 0.02)

pose = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
pose.pose.position.z, pose.pose.orientation.w = 1.5, 1.0
wall.drive(pose, lambda state: abs(state.pose.position.z - 1.5) < 1e-4)

"""A rospy client that never ends: `faithful.py BODY`. It commands a velocity for ever, and prints `moves` for each simulator
whose body follows."""

import sys

import rospy
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState


def main(body):
    """Runs until the node is shut down."""
    rospy.init_node("faithful", anonymous=True)
    last = {"node": "", "said": False}
    command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_VELOCITY)
    command.twist.linear.y = 0.25

    def hear(state):
        # rospy keeps with each message what the publisher said of itself.
        node = state._connection_header["callerid"]  # pylint: disable=protected-access
        if node != last["node"]:
            last.update(node=node, said=False)
        if not last["said"] and abs(state.twist.linear.y - 0.25) < 1e-3:
            last["said"] = True
            print("moves", flush=True)

    rospy.Subscriber(f"{body}/State", RigidBodyState, hear)
    publisher, rate = rospy.Publisher(f"{body}/Command", RigidBodyCmd, queue_size=1), rospy.Rate(100)
    while not rospy.is_shutdown():
        publisher.publish(command)
        rate.sleep()


if __name__ == "__main__":
    main(sys.argv[1])

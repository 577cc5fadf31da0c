"""A program for client 3.0 that runs with ROS 1 and with ROS 2: each kind of object, the world, and the layer.

It is started beside a simulator with `jaws.everything`, and ends with status 0 when everything obeyed. Its argument is a model to add."""

import sys
import threading
import time

from ambf_client import Actuator, Camera, ContactSensor, GhostObject, Light, RigidBody, Sensor, SoftBody, Vehicle
from ambf_client.ambf_client import Client
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState
from ambf_msgs.srv import ListModels
from geometry_msgs.msg import Pose
from ros_abstraction_layer import ral
from std_msgs.msg import Float64, Header, String

PATIENCE_S = 60.0


def expect(what, condition):
    """Ends the program if `condition` does not come true, however long that may take on a busy machine."""
    end = time.monotonic() + PATIENCE_S
    while not (obeyed := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    print(what, "ok" if obeyed else f"FAILED: {obeyed!r}", flush=True)
    if not obeyed:
        sys.exit(1)


def expect_error(kind, attempt, *arguments):
    """Ends the program if there is no such error."""
    try:
        attempt(*arguments)
    except kind as error:
        print(type(error).__name__, error, flush=True)
        return
    sys.exit(f"no {kind} from {attempt}")


client = Client("any_ros", 5)
assert client.ral.node_name() == "any_ros" and client.ral is client.get_ral() and not client.is_shutdown()
client.connect()
layer = client.ral
assert layer is client.get_ral() and layer.ros_version() == int(sys.argv[2])
print(layer.node_name(), layer.now_msg(), client.get_common_namespace(), client.get_obj_names(), flush=True)

# --- the layer ----------------------------------------------------------------------------------------------------------------------

begin = client.get_time()
assert abs(begin - time.time()) < PATIENCE_S and abs(layer.to_sec(layer.now_msg()) - begin) < PATIENCE_S
layer.sleep(0.05)
assert layer.to_sec(layer.now()) - begin >= 0.049
rate = client.create_rate(100)
for _ in range(10):
    rate.sleep()
assert layer.to_sec(layer.now()) - begin >= 0.05 + 0.089
assert layer.to_sec(layer.create_duration(2.5)) == 2.5 and layer.to_sec(layer.create_time()) == 0.0
assert abs(layer.to_sec(Header(stamp=layer.now_msg())) - client.get_time()) < PATIENCE_S
ticks = []
timer = layer.create_timer(0.01, lambda: ticks.append(layer.now()))
expect("a timer ticks", lambda: len(ticks) >= 5)
layer.close(timer)

child = layer.create_child("/any_ros").create_child("child")
heard, latched = [], []
subscriber = child.subscriber("topic", Float64, heard.append)
publisher = child.publisher("topic", Float64, queue_size=1)
expect("a topic's ends find each other", lambda: layer.get_num_connections(publisher) == 1)
publisher.publish(Float64(data=1.5))
expect("a message arrives", lambda: [message.data for message in heard] == [1.5])
expect("it is listed", lambda: "/any_ros/child/topic" in [name for name, _ in layer.get_published_topics()])
latching = layer.publisher("/any_ros/latched", String, queue_size=1, latch=True)
latching.publish(String(data="kept"))
late = ral("any_ros").subscriber("/any_ros/latched", String, latched.append, latch=True)
expect("a latched message comes late", lambda: latched and latched[0].data == "kept")
layer.close(publisher)
layer.close(subscriber)


def listing(request, response):
    """Answers."""
    response.models = ["of mine"]
    return response


answers = []
service = child.service("list", ListModels, listing)
call = child.service_client("list", ListModels)
call.wait_for_service(PATIENCE_S)
assert call().models == ["of mine"]
asking = layer.subscriber("/any_ros/ask", String, lambda _: answers.append(call().models))
ask = layer.publisher("/any_ros/ask", String)
expect("somebody who asks", lambda: layer.get_num_connections(ask) == 1)


def fails(_):
    """An error in a callback."""
    raise RuntimeError("this is expected")


failing = layer.subscriber("/any_ros/ask", String, fails)
# rospy has one connection for all of a process.
expect("both hear", lambda: layer.get_num_connections(ask) == layer.ros_version())
ask.publish(String(data="ask"))
expect("a callback calls a service", lambda: answers == [["of mine"]])
ask.publish(String(data="ask"))
expect("an error of a callback is no end of the others", lambda: len(answers) == 2)

# --- objects ------------------------------------------------------------------------------------------------------------------------

kinds = {
    "/ambf/env/psm1/baselink": RigidBody,
    "psm1/left_finger_ghost": GhostObject,
    "psm1/Actuator0": Actuator,
    "scale": ContactSensor,
    "gripper/proximity": Sensor,
    "gripper/holder": Actuator,
    "key_light": Light,
    "main_camera": Camera,
    "car/car": Vehicle,
}
handles = {name: client.get_obj_handle(name) for name in kinds}
for name, kind in kinds.items():
    assert type(handles[name]) is kind, (name, handles[name])
cloth = next(handle for handle in client._objects.values() if isinstance(handle, SoftBody))
arm, needle, cup = handles["/ambf/env/psm1/baselink"], client.get_obj_handle("Needle"), client.get_obj_handle("cup")
world = client.get_world_handle()

# bodies and joints
assert arm.get_joint_names() == ["lift", "left_jaw", "right_jaw"] and arm.get_num_joints() == 3, arm.get_joint_names()
assert len(arm.get_children_names()) == arm.get_num_of_children() == 3
assert arm.get_identifier() == "/ambf/env/psm1/BODY baselink" and arm.get_joint_idx_from_name("left_jaw") == 1
assert cup.get_mass() == 0.5 and cup.get_inertia().x > 0 and arm.get_msg_frame_id() == ""
assert abs(layer.to_sec(arm.get_msg_time_stamp()) - client.get_time()) < PATIENCE_S
number = arm.get_msg_seq_num()
expect("states are numbered", lambda: arm.get_msg_seq_num() > number)
arm.set_joint_pos("lift", 0.1)
arm.set_multiple_joint_pos([0, 0.2, 0.2], [1, 2])
expect(
    "joints move", lambda: abs(arm.get_joint_pos(0) - 0.1) < 0.01 and abs(arm.get_joint_pos("right_jaw") - 0.2) < 0.05
)
assert len(arm.get_all_joint_pos()) == len(arm.get_all_joint_vel()) == len(arm.get_all_joint_effort()) == 3
arm.set_joint_vel("left_jaw", 0.1)
arm.set_joint_effort(2, 0)
entry = client.get_obj_handle("Entry1")
entry.set_pos(1, 0, -0.8)
entry.set_rpy(0, 0, 1)
expect(
    "a static body goes where it is put",
    lambda: abs(entry.get_pos().z + 0.8) < 1e-4 and abs(entry.get_rpy()[2] - 1) < 1e-4,
)
pose = Pose()
pose.position.z, pose.orientation.w = -0.9, 1.0
entry.set_pose(pose)
entry.set_rot([0, 0, 0, 1])
expect("and again", lambda: max(abs(a - b) for a, b in zip(entry.get_pose(), [0, 0, -0.9, 0, 0, 0])) < 1e-4)
entry.pose_command(1, 0, -1, 0, 0, 0)
expect("there and back", lambda: abs(entry.get_pose()[0] - 1) < 1e-4)
cup.set_linear_vel(0, 0, 0.2)
expect("a velocity is held", lambda: abs(cup.get_linear_vel().z - 0.2) < 0.05 and cup.get_pos().z > -0.8)
cup.velocity_command(0, 0, 0, 0, 0, 1)
expect("and a spin", lambda: abs(cup.get_angular_vel().z - 1) < 0.05)


def pushed():
    """Pushes up."""
    cup.wrench_command(0, 0, 10, 0, 0, 0)
    cup.set_torque(0, 0, 0)
    return cup.get_pos().z > -0.5


expect("a force lifts", pushed)
expect("forces end with their setters", lambda: cup.get_force_command().z == 0.0 and cup.get_linear_vel().z < -0.5)
times = []
listening = layer.subscriber(f"{needle.get_name()}/Command", RigidBodyCmd, lambda _: times.append(time.monotonic()))
expect("commands are published again and again", lambda: len(times) > 120)
assert 119 / (times[119] - times[0]) < 140, "at 120 Hz at most"
layer.close(listening)

# ghosts, sensors, actuators
world.reset()
scale, ghost = handles["scale"], handles["psm1/left_finger_ghost"]
expect("a contact sensor feels", lambda: scale.get_all_contact_object_names() == ["/ambf/env/BODY cup"])
expect(
    "where",
    lambda: [data.contact_normal.z for event in scale.get_all_contact_events() for data in event.contact_data if data],
)
arm.set_joint_pos("lift", 0.0)
arm.set_joint_pos("left_jaw", 0.4)
arm.set_joint_pos("right_jaw", 0.4)
expect("a ghost senses", lambda: ghost.get_all_sensed_obj_names() == ["/ambf/env/BODY Needle"])
assert ghost.get_num_sensed_obj() in (0, 1) and len(ghost.get_pose()) == 6
actuator = handles["psm1/Actuator0"]
actuator.actuate("/ambf/env/BODY Needle")
expect("an actuator holds", actuator.is_actuated)
actuator.deactuate()
expect("and lets go", lambda: not actuator.is_actuated())
proximity, holder = handles["gripper/proximity"], handles["gripper/holder"]
expect("a sensor sees", lambda: proximity.is_triggered(0) and proximity.get_sensed_object(0))
assert proximity.get_count() == 1 and proximity.get_measurement(0) > 0 and proximity.get_range() > 0
holder.actuate_from_sensor_data("SENSOR proximity")
expect("an actuator holds what a sensor sees", holder.is_actuated)
holder.deactuate()

# lights, cameras, vehicles, soft bodies
for name in ("key_light", "main_camera"):
    handles[name].set_pos(0.5, 0.25, 2.0)
    expect(f"{name} moves", lambda handle=handles[name]: abs(handle.get_pos().x - 0.5) < 1e-6)
car = handles["car/car"]
assert car.get_wheel_count() == 4 and car.set_powered_wheel_indices([0, 1]) and car.set_steered_wheel_indices([0, 1])
parked = car.get_pose()[0]
car.set_vehicle_power(10)
car.set_vehicle_steering(0.1)
expect("a vehicle drives", lambda: abs(car.get_pose()[0] - parked) > 0.2)
car.initialize_wheel_cmds()
client.get_obj_handle(cloth.get_name())
assert cloth.get_num_nodes() > 3 and len(cloth.get_nodes()[0]) == 3


def blown():
    """Pushes the cloth aside."""
    cloth.set_force(0, 3, 0)
    return max(y for _, y, _ in cloth.get_nodes()) > still


still = max(y for _, y, _ in cloth.get_nodes()) + 0.05
expect("a soft body is pushed", blown)

# --- the world ----------------------------------------------------------------------------------------------------------------------

world.reset()
# Before it has arrived nothing may hold the physics: a reset at rest shows the state that the next step shows.
expect("a reset brings the vehicle back", lambda: abs(car.get_pose()[0] - parked) < 0.1)
step = world.step(0, patience=60).sim_step
for count in (1, 10):
    result = world.step(count, commands=[arm, actuator], observe=[arm, ghost, scale, proximity, actuator], patience=60)
    step += count
    steps = [result.sim_step, *(handle.get_sim_step() for handle in (arm, scale, ghost))]
    assert steps == [step] * 4, f"after {count}: steps {steps}, not {step}"
assert set(result.states) == {handle.get_name() for handle in (arm, ghost, scale, proximity, actuator)}
world.step(0, patience=0.01)
world.enable_throttling(True)
world.set_num_step_skips(5)
world.set_active()


def held():
    """Whether the physics waits; an edge before it does may be lost."""
    world.update()
    before = needle.get_sim_step()
    time.sleep(0.1)
    return needle.get_sim_step() - before <= 5


expect("the physics waits", held)
at = needle.get_sim_step()
for count in range(1, 11):
    world.update()
    needle.wait_for_step(at + 5 * count, PATIENCE_S)
world.enable_throttling(False)
world.update()
world.reset_bodies()
assert world.get_sim_time() > 0 and world.get_sim_step() > at and world.get_num_devices() == 0

added = world.add_model(sys.argv[1])
assert added.success and added.model in world.list_models().models, added
link = client.wait_for_object("/ambf/env/Link", PATIENCE_S)
assert isinstance(link, RigidBody)
assert world.remove_model(added.model).success and added.model not in world.list_models().models
light = handles["key_light"].get_name()
layer.set_parameter(f"{light}/cutoff_angle", 0.5)
expect("a parameter is set", lambda: abs(layer.get_parameter(f"{light}/cutoff_angle") - 0.5) < 1e-6)
expect_error(KeyError, layer.get_parameter, "/ambf/env/nobody/nothing")

# --- the end ------------------------------------------------------------------------------------------------------------------------

states = []
other = layer.subscriber(f"{cup.get_name()}/State", RigidBodyState, states.append)
client.refresh()
assert client.get_obj_handle("cup") is not cup
client.clean_up()
assert client.get_obj_names() == [] and not client.is_shutdown()
expect("the layer outlives the client", lambda: len(states) > 3)
ended = threading.Event()
layer.on_shutdown(ended.set)
layer.shutdown()
assert client.is_shutdown() and layer.is_shutdown() and ended.wait(PATIENCE_S)
print("everything obeyed", flush=True)

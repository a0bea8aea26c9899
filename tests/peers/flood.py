"""flood.py KIND: sends without any pause until it is killed, and prints how much it has sent.

KIND is a topic that a node of ours hears, or `services`: then it calls services of both nodes,
parameters among them, and has always a few calls open.
"""

import sys

import rclpy
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from ros import TOPICS, rest, trajectory

# Messages or calls between two lines.
SAYS = 500
# Calls that wait for an answer.
OPEN = 20


def message(topic: str) -> WrenchStamped | JointState | Float64MultiArray | JointTrajectory:
    """One that has to be judged, whether it is taken or refused."""
    if topic.endswith("setpoint") or topic.endswith("joint_trajectory"):
        return trajectory([rest(0.1 * (1 + k), 1e-4) for k in range(50)])
    if topic.endswith("joint_commands"):
        return JointState(name=["stage"], effort=[1.0])
    if topic.endswith("commands"):
        return Float64MultiArray(data=[1.0])
    return WrenchStamped()


def publish(node: rclpy.node.Node, topic: str) -> None:
    sent = message(topic)
    publisher = node.create_publisher(TOPICS.get(topic, type(sent)), topic, QoSProfile(depth=10))
    while publisher.get_subscription_count() == 0:
        rclpy.spin_once(node, timeout_sec=0.1)
    count = 0
    while True:
        publisher.publish(sent)
        count += 1
        if count % SAYS == 0:
            print(f"sent {count}", flush=True)


def call(node: rclpy.node.Node) -> None:
    def calls(name: str):
        as_it_is = SetParameters.Request(
            parameters=[
                Parameter(
                    name="use_sim_time",
                    value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=False),
                )
            ]
        )
        return (
            (
                node.create_client(GetParameters, f"{name}/get_parameters"),
                GetParameters.Request(names=["cpu"]),
            ),
            (node.create_client(SetParameters, f"{name}/set_parameters"), as_it_is),
            (node.create_client(SetBool, f"{name}/enable"), SetBool.Request(data=True)),
        )

    clients = [*calls("/stage"), *calls("/controller")]
    for client, _ in clients:
        while not client.service_is_ready():
            rclpy.spin_once(node, timeout_sec=0.1)
    # What a node that has ended leaves open is no reason to stop calling the other one.
    asked = {client: [] for client, _ in clients}
    count = 0
    while True:
        for client, request in clients:
            waiting = [future for future in asked[client] if not future.done()]
            count += len(asked[client]) - len(waiting)
            asked[client] = waiting + [
                client.call_async(request) for _ in range(OPEN - len(waiting))
            ]
        rclpy.spin_once(node, timeout_sec=0.01)
        print(f"sent {count}", flush=True)


rclpy.init()
node = rclpy.create_node(f"flood_{sys.argv[1].strip('/').replace('/', '_')}")
if sys.argv[1] == "services":
    call(node)
else:
    publish(node, sys.argv[1])

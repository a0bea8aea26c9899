"""caller.py: an rclpy program with one service client and one action client, both of the
controller. It asks again and again, prints a line for each answer and each result, and gives up on
a question after a while, since what was sent while this process was stopped may be lost."""

import time

import rclpy
from control_msgs.action import FollowJointTrajectory
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient

from ros import rest, trajectory

# Longest wait for an answer, s.
GIVES_UP = 5.0

rclpy.init()
node = rclpy.create_node("caller")
service = node.create_client(GetParameters, "/controller/get_parameters")
action = ActionClient(node, FollowJointTrajectory, "/controller/follow_joint_trajectory")


def result(future):
    """What the future brings, or None."""
    rclpy.spin_until_future_complete(node, future, timeout_sec=GIVES_UP)
    return future.result() if future.done() else None


while rclpy.ok():
    if answer := result(service.call_async(GetParameters.Request(names=["rate"]))):
        print("answer", answer.values[0].double_value, flush=True)
    goal = FollowJointTrajectory.Goal(trajectory=trajectory([rest(0.05, 0.0)]))
    if (handle := result(action.send_goal_async(goal))) and handle.accepted:
        if end := result(handle.get_result_async()):
            print("result", end.result.error_code, flush=True)
    began = time.monotonic()
    while time.monotonic() - began < 0.1:
        rclpy.spin_once(node, timeout_sec=0.05)

#!/usr/bin/env python3
"""Plays a trajectory file to a running stage, with nothing but rclpy:

    play_trajectory.py next_experiment.yaml [TOPIC]

The same as:

    ros2 topic pub --once -w 2 /stage/setpoint trajectory_msgs/msg/JointTrajectory \\
        "$(cat next_experiment.yaml)"
"""

import sys
import time

import rclpy
import yaml
from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# Longest wait for stage and controller, s.
PATIENCE = 20.0


def trajectory_of(text: str) -> JointTrajectory:
    """The message that a YAML text says, field by field; an unknown field or a value of another
    type is an error."""
    given = yaml.safe_load(text)
    points = [
        JointTrajectoryPoint(**{**point, "time_from_start": Duration(**point["time_from_start"])})
        for point in given.pop("points")
    ]
    return JointTrajectory(points=points, **given)


def main(path: str, topic: str = "/stage/setpoint") -> None:
    with open(path) as file:
        trajectory = trajectory_of(file.read())
    rclpy.init()
    node = rclpy.create_node("play_trajectory")
    publisher = node.create_publisher(JointTrajectory, topic, 10)
    # The controller follows it, and the stage hears it for its recording. Without a stamp it starts
    # when it is heard.
    deadline = time.monotonic() + PATIENCE
    while publisher.get_subscription_count() < 2:
        if time.monotonic() > deadline:
            sys.exit(f"no stage and controller listen on {topic} within {PATIENCE} s")
        rclpy.spin_once(node, timeout_sec=0.1)
    publisher.publish(trajectory)
    publisher.wait_for_all_acked()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])

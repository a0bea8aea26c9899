"""Plays a trajectory file to the stage, with nothing but rclpy: python play_trajectory.py next_experiment.yaml"""

import sys

import rclpy
import yaml
from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


def trajectory_of(text: str) -> JointTrajectory:
    """The message that a YAML text says, field by field, as `ros2 topic pub` reads it; an unknown field is an error."""
    given = yaml.safe_load(text)
    points = [
        JointTrajectoryPoint(**{**point, "time_from_start": Duration(**point["time_from_start"])})
        for point in given.pop("points")
    ]
    return JointTrajectory(points=points, **given)


def scaled(trajectory: JointTrajectory, factor: float) -> JointTrajectory:
    """The same way in `factor` times the time."""
    points = []
    for point in trajectory.points:
        at = round((point.time_from_start.sec * 10**9 + point.time_from_start.nanosec) * factor)
        points.append(
            JointTrajectoryPoint(
                positions=point.positions,
                velocities=[velocity / factor for velocity in point.velocities],
                accelerations=[acceleration / factor**2 for acceleration in point.accelerations],
                time_from_start=Duration(sec=at // 10**9, nanosec=at % 10**9),
            )
        )
    return JointTrajectory(joint_names=trajectory.joint_names, points=points)


def main(path: str, topic: str = "/stage/setpoint") -> None:
    with open(path) as file:
        trajectory = trajectory_of(file.read())
    with rclpy.init():
        node = rclpy.create_node("play_trajectory")
        publisher = node.create_publisher(JointTrajectory, topic, 10)
        # The stage hears setpoints too, for its recording.
        while publisher.get_subscription_count() < 2:
            rclpy.spin_once(node, timeout_sec=0.1)
        publisher.publish(trajectory)
        publisher.wait_for_all_acked()


if __name__ == "__main__":
    main(*sys.argv[1:])

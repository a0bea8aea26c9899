"""What `tune` writes for ros2_control is what the parameter parser of ROS gives its controllers."""

import json
import subprocess
from pathlib import Path

import rclpy
from conftest import BINARIES
from rclpy.context import Context
from rclpy.node import Node


def test_ros2_control_reads_the_gains(domain: int, tmp_path: Path) -> None:
    out = tmp_path / "tuning"
    run = subprocess.run(
        [
            BINARIES / "friction-stage",
            "tune",
            "guide_1",
            "--variants",
            "20",
            "--out",
            out,
            "--json",
        ],
        capture_output=True,
        text=True,
    )
    assert run.returncode in (0, 3), run.stderr
    gains = json.loads(run.stdout)["tunings"][1]["gains"]
    for name in ("pid_controller", "joint_trajectory_controller"):
        context = Context()
        rclpy.init(context=context)
        node = Node(
            name,
            context=context,
            cli_args=["--ros-args", "--params-file", str(out / "ros2_control.yaml")],
            automatically_declare_parameters_from_overrides=True,
        )
        try:
            for gain in ("p", "i", "d"):
                assert node.get_parameter(f"gains.stage.{gain}").value == gains[gain]
            assert node.get_parameter("gains.stage.u_clamp_max").value == 2000.0
            assert node.get_parameter("gains.stage.antiwindup_strategy").value == (
                "conditional_integration"
            )
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)

"""two_machines.py BINARIES DIRECTORY MODE RATE DELAY LOSS RELIABILITY: a stage on this machine (a
network namespace) and its controller on another, over a link with this delay (s) and loss (share)
in each direction, make a move of 10 mm within 1 s. RELIABILITY is that of encoder and force,
`reliable` or `best_effort`. Prints as JSON what came of it.

To be run in a network namespace of its own (`unshare --net`, with `--map-root-user` where one is
not root).
"""

import json
import os
import sys
import time
from pathlib import Path

from link import Link
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

DOMAIN = 1
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)


def main() -> None:
    binaries, directory, mode = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    rate, delay, loss = map(float, sys.argv[4:7])
    reliability = {
        f"qos_overrides./stage/{topic}.{role}.reliability": sys.argv[7]
        for topic in ("encoder", "force")
        for role in ("publisher", "subscription")
    }
    # These read the environment.
    from diagnostics import Diagnostics, number
    from ros import Ros, nanoseconds, rest  # isort: skip
    from friction_stage_testing import Process, ros_arguments

    def node(name: str, inside: list[str], **parameters: object) -> Process:
        command = [*inside, str(binaries / name), *ros_arguments({**parameters, **reliability})]
        process = Process(command, directory / f"{name}.log")
        processes.append(process)
        return process

    processes: list[Process] = []
    with Link(delay, loss) as link:
        try:
            # In lockstep time begins with the first answer, and waits for one that is sent again.
            lockstep = {"wait_for_command": True, "answer_timeout": 10.0}
            settings = lockstep if mode == "lockstep" else {}
            stage = node(
                "stage_node", [], mode=mode, control_rate=rate, record=directory / "bag", **settings
            )
            node("controller_node", link.there, rate=rate, bandwidth=20.0)
            with Ros(DOMAIN, processes) as ros:
                states = ros.collect("/controller/state", depth=1000)
                began = time.monotonic()
                start = ros.follow([rest(0.0, 0.0), rest(1.0, 0.01)])
                encoder: list[JointState] = []
                # Hears reliable publishers and others.
                profile = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
                ros.node.create_subscription(JointState, "/stage/encoder", encoder.append, profile)
                end = start + 3_000_000_000
                ros.until(
                    lambda: encoder and nanoseconds(encoder[-1].header.stamp) > end,
                    "the end",
                    120.0,
                )
                took = time.monotonic() - began
                status = Diagnostics(ros).newest()
                stamps = [nanoseconds(message.header.stamp) for message in encoder]
                report = {
                    "start": start,
                    "seconds": took,
                    "simulated": (stamps[-1] - stamps[0]) * 1e-9,
                    "samples": number(status, "sample"),
                    "refused_commands": number(status, "refused_commands"),
                    "stale_commands": number(status, "stale_commands"),
                    "missing_answers": number(status, "missing_answers"),
                    "message": status.message,
                    "largest_error": max(abs(state.error) for state in states),
                    "last_position": encoder[-1].position[0],
                }
            stage.stop()
        finally:
            for process in reversed(processes):
                if not process.stopped:
                    process.stop(expected=(0, 1))
    print(json.dumps(report))


main()

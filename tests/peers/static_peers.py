"""static_peers.py BINARIES DIRECTORY: who finds whom on two machines whose link carries no
multicast. Prints as JSON how many samples of a stage on this machine (a network namespace) came to
a peer on the other, by who names whom (`ROS_STATIC_PEERS`), and whether a controller there closes
the loop.

To be run in a network namespace of its own (`unshare --net`, with `--map-root-user` where one is
not root).
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from link import HERE, THERE, Link

DOMAIN = 1
WANTED = 100
# Until the link is given up, s: a participant announces itself every 10 s or more often.
PATIENCE, SHORT_PATIENCE = 30.0, 12.0
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)


def hear(patience: float) -> int:
    """Samples of the stage that came within this time, at most WANTED."""
    from ros import Ros

    with Ros(DOMAIN, []) as ros:
        samples = ros.collect("/stage/encoder")
        end = time.monotonic() + patience
        while len(samples) < WANTED and time.monotonic() < end:
            ros.spin(0.05)
        return min(len(samples), WANTED)


def main() -> None:
    binaries, directory = Path(sys.argv[1]), Path(sys.argv[2])
    from diagnostics import Diagnostics
    from friction_stage_testing import Process, ros_arguments
    from ros import Ros

    def naming(machine: str | None) -> list[str]:
        return ["env", f"ROS_STATIC_PEERS={machine or ''}"]

    def node(
        name: str, log: str, inside: list[str], names: str | None, **parameters: object
    ) -> Process:
        command = [*naming(names), *inside, str(binaries / name), *ros_arguments(parameters)]
        return Process(command, directory / log)

    def peer(names: str | None, patience: float = PATIENCE) -> int:
        command = [*naming(names), *link.there, sys.executable, __file__, "hear", str(patience)]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        return int(run.stdout.split()[-1])

    came = {}
    with Link(0.0, 0.0, multicast=False) as link:
        stage = node("stage_node", "stage.log", [], None, mode="realtime", control_rate=1000.0)
        try:
            came["nobody"] = peer(None, SHORT_PATIENCE)
            came["rclpy names the stage's machine"] = peer(HERE)
            controller = node("controller_node", "controller.log", link.there, HERE, rate=1000.0)
            try:
                with Ros(DOMAIN, [stage, controller]) as ros:
                    Diagnostics(ros).until(
                        lambda status: status.message == "running", "its commands", PATIENCE
                    )
            finally:
                controller.stop()
        finally:
            stage.stop()
        # Both machines, as one list for all of them.
        stage = node(
            "stage_node", "naming.log", [], f"{HERE};{THERE}", mode="realtime", control_rate=1000.0
        )
        try:
            came["the stage names rclpy's machine"] = peer(None)
        finally:
            stage.stop()
    print(json.dumps(came))


if sys.argv[1] == "hear":
    print(hear(float(sys.argv[2])))
else:
    main()

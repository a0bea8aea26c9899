"""other_machine.py STAGE_NODE DIRECTORY: how far a stage of this network namespace moves when
another namespace, or this one, commands it by hand-made datagrams. Prints metres as JSON, by
discovery range and sender.

To be run in a network namespace of its own (`unshare --net`, with `--map-root-user` where one is
not root).
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

DOMAIN = 1
HERE, THERE = "10.77.0.1", "10.77.0.2"


def run(*command: str) -> None:
    subprocess.run(command, check=True)


def command_stage(process: str, address: str, own_address: str) -> None:
    """Pushes the stage with 200 N for three seconds."""
    from rtps import Stranger

    stranger = Stranger(int(process), address, own_address)
    for sequence in range(1, 301):
        if sequence % 10 == 1:
            stranger.send(stranger.announcement())
            stranger.send(
                stranger.publication("rt/stage/force", "geometry_msgs::msg::dds_::WrenchStamped_")
            )
        stranger.send(stranger.force(sequence, 200.0))
        time.sleep(0.01)


def moved(stage_node: str, log: Path, discovery_range: str, sender: list[str]) -> float:
    """Largest distance from 0 that a new stage reports after the sender has tried, m."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = discovery_range
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    from ros import Ros, nanoseconds

    parameters = ["mode:=realtime", "control_rate:=100.0", "physics_rate:=10000.0", "noise:=false"]
    arguments = [part for parameter in parameters for part in ("-p", parameter)]
    with log.open("wb") as out:
        stage = subprocess.Popen([stage_node, "--ros-args", *arguments], stdout=out, stderr=out)
    try:
        with Ros(DOMAIN, []) as ros:
            encoder = ros.collect("/stage/encoder")
            ros.until(lambda: encoder, "a sample")
            attack = subprocess.Popen(
                [
                    *sender,
                    sys.executable,
                    __file__,
                    "send",
                    str(stage.pid),
                    *sender_addresses(sender),
                ]
            )
            ros.until(lambda: attack.poll() is not None, "the end of the sender")
            assert attack.returncode == 0
            # In real time stamps are system time: everything until now has been heard.
            end = time.time_ns()
            ros.until(
                lambda: nanoseconds(encoder[-1].header.stamp) > end, "the samples until the end"
            )
            return max(abs(message.position[0]) for message in encoder)
    finally:
        stage.terminate()
        stage.wait(15)


def sender_addresses(sender: list[str]) -> tuple[str, str]:
    return (HERE, THERE) if sender else ("127.0.0.1", "127.0.0.1")


def main() -> None:
    stage_node, directory = sys.argv[1], Path(sys.argv[2])
    run("ip", "link", "set", "lo", "up")
    beside = subprocess.Popen(["unshare", "-n", "sleep", "300"])
    try:
        inside = ["nsenter", "-t", str(beside.pid), "-n"]
        # Until it has left this namespace.
        mine = os.readlink("/proc/self/ns/net")
        while os.readlink(f"/proc/{beside.pid}/ns/net") == mine:
            time.sleep(0.01)
        run(
            "ip",
            "link",
            "add",
            "here",
            "type",
            "veth",
            "peer",
            "name",
            "there",
            "netns",
            str(beside.pid),
        )
        run("ip", "addr", "add", f"{HERE}/24", "dev", "here")
        run("ip", "link", "set", "here", "up")
        run(*inside, "ip", "addr", "add", f"{THERE}/24", "dev", "there")
        run(*inside, "ip", "link", "set", "there", "up")
        run(*inside, "ip", "link", "set", "lo", "up")
        result: dict[str, dict[str, float]] = {}
        for discovery_range, sender in [
            ("LOCALHOST", inside),
            ("LOCALHOST", []),
            ("SUBNET", inside),
        ]:
            name = "other machine" if sender else "here"
            log = directory / f"{discovery_range}_{len(sender)}.log"
            result.setdefault(discovery_range, {})[name] = moved(
                stage_node, log, discovery_range, sender
            )
        print(json.dumps(result))
    finally:
        beside.kill()
        beside.wait()


if sys.argv[1] == "send":
    command_stage(*sys.argv[2:])
else:
    main()

"""What a recording loses when its stage is killed: SIGKILL at random moments under load, as a
table.

    python tests/soak/kills.py --kills 200 --busy 4 --out /tmp/kills
    python tests/soak/kills.py --mode lockstep --sync interval --split 0.5

Needs built programs (FRICTION_STAGE_BIN, default target/release) and any Python from 3.9 on, in
lockstep that of the peers' tests (tests/peers/environment prints it). Each time a stage records, is
killed, and its bag recovered; in lockstep it has a controller.

Lost is the time from when the last sample of the recovered bag was taken to the kill. What is
documented is FLUSH seconds, and what had not yet reached the recorder: in real time since it last
ran, on a busy machine without a real-time priority as long as the system keeps it waiting; in
lockstep 512 samples. In lockstep stamps are no time of the system: the time of a sample is when its
clock was heard, and the table has the lost samples as well. With `--sync interval` time waits for
the disk there, and that wait counts in the lost seconds. Ends with 1 if a bag is not recovered,
lost more than FLUSH + LATE seconds, or has a hole in lockstep.
"""

import argparse
import ctypes
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BINARIES = Path(os.environ.get("FRICTION_STAGE_BIN", ROOT / "target/release"))
# Longest time that a sample stays in memory only, s.
FLUSH = 0.5
# What the recorder may have waited for a processor, s: assumed for a few busy loops per processor.
LATE = 1.0

# Ends with the process that started it, also where that is killed.
LOOP = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""

# Loaded here: between fork and exec it may not be.
LIBC = ctypes.CDLL(None)
PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """A node ends with this script, also where that is killed."""
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def recovered(bag: Path, out: Path) -> dict:
    """The report of `recover`."""
    command = [str(BINARIES / "friction-stage"), "recover", str(bag), "--out", str(out), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode in (0, 3), run.stderr
    return json.loads(run.stdout)


def holes(bag: Path) -> int:
    """Gaps of the encoder in a recovered bag."""
    command = [str(BINARIES / "friction-stage"), "check", str(bag), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode in (0, 3), run.stderr
    report = json.loads(run.stdout)
    assert report["complete"] and not report["damage"], run.stdout
    return next(topic for topic in report["topics"] if topic["name"] == "/stage/encoder")["gaps"]


@dataclass
class Kill:
    lost: float
    """Between what the bag holds and the kill, s."""
    recorded: float
    """Time of the samples in the bag, s."""
    messages: int
    holes: int
    samples: int
    """Samples that are lost, in lockstep: of those that were heard."""


class Clock:
    """When each sample was heard, in lockstep, as far as this process keeps up."""

    def __init__(self, domain: int) -> None:
        sys.path[:0] = [str(ROOT / "tests/peers"), str(ROOT / "testing")]
        from ros import TOPICS, Ros, nanoseconds

        # By stamp, ns; s.
        self.heard: dict[int, float] = {}
        self.ros = Ros(domain, [])
        self.ros.node.create_subscription(
            TOPICS["/clock"],
            "/clock",
            lambda clock: self.heard.setdefault(nanoseconds(clock.clock), time.monotonic()),
            1,
        )

    def spin(self, seconds: float) -> None:
        self.ros.spin(seconds)

    def close(self) -> None:
        self.ros.__exit__()

    def lost(self, last: int, killed: float) -> float:
        """From the last of these that was heard at or before the stamp to the kill, s."""
        heard = [at for stamp, at in self.heard.items() if stamp <= last]
        assert heard, "no sample of the bag was heard"
        return killed - max(heard)


def size(bag: Path) -> int:
    return sum(file.stat().st_size for file in bag.glob("*.mcap"))


def kill_once(number: int, arguments: argparse.Namespace, home: Path, chaos: random.Random) -> Kill:
    bag = home / f"bag_{number}"
    environment = dict(
        os.environ,
        ROS_DOMAIN_ID=str(arguments.domain),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
    )
    nodes: list[subprocess.Popen] = []

    def start(name: str, **parameters: object) -> Path:
        command = [str(BINARIES / name), "--ros-args"]
        command += [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
        log = home / f"{name}_{number}.log"
        with log.open("w") as output:
            nodes.append(
                subprocess.Popen(
                    command,
                    env=environment,
                    stdout=output,
                    stderr=output,
                    preexec_fn=end_with_parent,
                )
            )
        return log

    settings = {
        "record": bag,
        "record_sync": arguments.sync,
        "record_split_duration": arguments.split,
    }
    lockstep = arguments.mode == "lockstep"
    clock = Clock(arguments.domain) if lockstep else None
    pause = clock.spin if clock else time.sleep
    try:
        log = start("stage_node", mode=arguments.mode, control_rate=arguments.rate, **settings)
        stage = nodes[0]
        if lockstep:
            start("controller_node", rate=arguments.rate)
        began = time.monotonic()

        def wait_for(is_so: Callable[[], bool]) -> None:
            while not is_so():
                assert stage.poll() is None and time.monotonic() < began + 60, log.read_text()
                pause(0.01)

        wait_for(lambda: bag.exists() and size(bag) > 20_000)
        if clock:
            wait_for(lambda: clock.heard)
            # What was heard first is in the file, too.
            known = size(bag)
            wait_for(lambda: size(bag) > known)
        pause(chaos.uniform(0.0, 3.0))
        killed, killed_at = time.time_ns(), time.monotonic()
        stage.send_signal(signal.SIGKILL)
        stage.wait()
    finally:
        for node in nodes:
            node.kill()
            node.wait()
        if clock:
            clock.close()
    report = recovered(bag, home / f"recovered_{number}")
    first, last = report["time_range"]
    newest = max(clock.heard) if clock else last
    return Kill(
        lost=clock.lost(last, killed_at) if clock else (killed - last) * 1e-9,
        recorded=(last - first) * 1e-9,
        messages=report["messages"],
        holes=holes(home / f"recovered_{number}"),
        samples=max(0, round((newest - last) * 1e-9 * arguments.rate)),
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--mode", choices=["realtime", "lockstep"], default="realtime")
    parser.add_argument("--rate", type=float, default=1000.0, help="samples per second")
    parser.add_argument("--busy", type=int, default=2 * (os.cpu_count() or 1), help="busy loops")
    parser.add_argument("--sync", choices=["never", "end", "interval"], default="end")
    parser.add_argument(
        "--split", type=float, default=0.0, help="time of a file of the recording, s; 0: one file"
    )
    parser.add_argument("--domain", type=int, default=87, help="a ROS domain that is free")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", help="directory of logs and bags of kills that lost too much")
    arguments = parser.parse_args()
    home = Path(arguments.out or tempfile.mkdtemp(prefix="kills_"))
    home.mkdir(parents=True, exist_ok=True)
    chaos = random.Random(arguments.seed)
    loops = [subprocess.Popen([sys.executable, "-c", LOOP]) for _ in range(arguments.busy)]
    kills: list[Kill] = []
    faults: list[str] = []
    print(
        f"{'kill':>5} {'recorded s':>11} {'messages':>9} {'lost s':>8} {'samples':>8} "
        f"{'holes':>6}  load",
        flush=True,
    )
    try:
        for number in range(arguments.kills):
            try:
                kill = kill_once(number, arguments, home, chaos)
            except AssertionError as error:
                faults.append(f"kill {number}: {error}")
                continue
            kills.append(kill)
            print(
                f"{number:>5} {kill.recorded:>11.3f} {kill.messages:>9} {kill.lost:>8.3f} "
                f"{kill.samples:>8} {kill.holes:>6}  {os.getloadavg()[0]:.1f}",
                flush=True,
            )
            if kill.lost > FLUSH + LATE:
                faults.append(f"kill {number} lost {kill.lost:.3f} s")
            # In real time holes are the machine's.
            if kill.holes and arguments.mode == "lockstep":
                faults.append(f"the bag of kill {number} has {kill.holes} holes")
            if not faults or not faults[-1].startswith(
                (f"kill {number} ", f"the bag of kill {number} ")
            ):
                for name in (f"bag_{number}", f"recovered_{number}"):
                    shutil.rmtree(home / name)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    if kills:
        lost = sorted(kill.lost for kill in kills)
        how = f"{arguments.mode}, {arguments.busy} busy loops, record_sync {arguments.sync}"
        print(f"\n{len(kills)} kills, {how}, record_split_duration {arguments.split}")
        for share in (0.5, 0.9, 0.99):
            most = lost[min(len(lost) - 1, int(share * len(lost)))]
            print(f"{share:>5.0%} lost at most {most:.3f} s")
        print(f"  all lost at most {lost[-1]:.3f} s; mean {statistics.mean(lost):.3f} s")
        print(f"more than {FLUSH} s: {sum(seconds > FLUSH for seconds in lost)}")
        if arguments.mode == "lockstep":
            print(f"  all lost at most {max(kill.samples for kill in kills)} samples")
    for fault in faults:
        print(f"FAULT: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

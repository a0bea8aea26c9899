"""What a recording loses when its stage is killed: SIGKILL at random moments under load, as a table.

    python tests/soak/kills.py --kills 200 --busy 4 --out /tmp/kills

Needs built programs (FRICTION_STAGE_BIN, default target/release) and any Python from 3.9 on. Each
time a stage in real time records, is killed, and its bag recovered. Lost is the time from the last
sample in the recovered bag to the kill. What is documented is FLUSH seconds, and what had not yet
reached the recorder since it last ran: on a busy machine without a real-time priority, as long as
the system keeps it waiting. Ends with 1 if a bag is not recovered or
lost more than FLUSH + LATE seconds.
"""

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BINARIES = Path(os.environ.get("FRICTION_STAGE_BIN", ROOT / "target/release"))
# Longest time that a sample stays in memory only, s.
FLUSH = 0.5
# What the recorder may have waited for a processor, s: assumed for a few busy loops per processor.
LATE = 1.0


def recovered(bag: Path, out: Path) -> dict:
    """The report of `recover`."""
    command = [str(BINARIES / "friction-stage"), "recover", str(bag), "--out", str(out), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode in (0, 3), run.stderr
    return json.loads(run.stdout)


def kill_once(number: int, arguments: argparse.Namespace, home: Path, chaos: random.Random) -> tuple[float, float, int]:
    """Time lost, time recorded, s, and messages kept."""
    bag, log = home / f"bag_{number}", home / f"stage_{number}.log"
    command = [str(BINARIES / "stage_node"), "--ros-args", "-p", f"control_rate:={arguments.rate}"]
    command += ["-p", f"record:={bag}", "-p", f"record_sync:={arguments.sync}"]
    environment = dict(
        os.environ,
        ROS_DOMAIN_ID=str(arguments.domain),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
    )
    with log.open("w") as output:
        stage = subprocess.Popen(command, env=environment, stdout=output, stderr=output)
    try:
        file, began = bag / f"{bag.name}_0.mcap", time.monotonic()
        while not file.exists() or file.stat().st_size < 20_000:
            assert stage.poll() is None and time.monotonic() < began + 60, log.read_text()
            time.sleep(0.01)
        time.sleep(chaos.uniform(0.0, 3.0))
        killed = time.time_ns()
        stage.send_signal(signal.SIGKILL)
        stage.wait()
    finally:
        stage.kill()
        stage.wait()
    report = recovered(bag, home / f"recovered_{number}")
    first, last = report["time_range"]
    return (killed - last) * 1e-9, (last - first) * 1e-9, report["messages"]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--rate", type=float, default=1000.0, help="samples per second")
    parser.add_argument("--busy", type=int, default=2 * (os.cpu_count() or 1), help="busy loops")
    parser.add_argument("--sync", choices=["never", "end", "interval"], default="end")
    parser.add_argument("--domain", type=int, default=87, help="a ROS domain that is free")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", help="directory of logs and bags of kills that lost too much")
    arguments = parser.parse_args()
    home = Path(arguments.out or tempfile.mkdtemp(prefix="kills_"))
    home.mkdir(parents=True, exist_ok=True)
    chaos = random.Random(arguments.seed)
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(arguments.busy)
    ]
    lost, faults = [], []
    print(f"{'kill':>5} {'recorded s':>11} {'messages':>9} {'lost s':>8}  load", flush=True)
    try:
        for number in range(arguments.kills):
            try:
                seconds, recorded, messages = kill_once(number, arguments, home, chaos)
            except AssertionError as error:
                faults.append(f"kill {number}: {error}")
                continue
            lost.append(seconds)
            load = f"{os.getloadavg()[0]:.1f}"
            print(f"{number:>5} {recorded:>11.3f} {messages:>9} {seconds:>8.3f}  {load}", flush=True)
            if seconds > FLUSH + LATE:
                faults.append(f"kill {number} lost {seconds:.3f} s")
                continue
            for name in (f"bag_{number}", f"recovered_{number}"):
                subprocess.run(["rm", "-r", str(home / name)], check=True)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    lost.sort()
    if lost:
        print(f"\n{len(lost)} kills, {arguments.busy} busy loops, record_sync {arguments.sync}")
        for share in (0.5, 0.9, 0.99):
            print(f"{share:>5.0%} lost at most {lost[min(len(lost) - 1, int(share * len(lost)))]:.3f} s")
        print(f"  all lost at most {lost[-1]:.3f} s; mean {statistics.mean(lost):.3f} s")
        print(f"more than {FLUSH} s: {sum(seconds > FLUSH for seconds in lost)}")
    for fault in faults:
        print(f"FAULT: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

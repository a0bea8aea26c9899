"""Endurance: stage and controller for a long time beside busy loops, as a table.

    python tests/soak/soak.py --mode realtime --minutes 60 --busy 4 --out /tmp/soak

Needs the Python of the peers' tests (tests/peers/environment prints it) and built programs
(FRICTION_STAGE_BIN, default target/release). Every interval a row: memory, descriptors and threads
of both nodes, lateness, and what is missing; and a subscriber of all samples comes, while the one
before it ends: in good order and by SIGKILL in turn. Ends with 1 if a process grew in the second
half, if a sample is missing from the bag or was not published, or if a peer hears nothing at the
end. In less than ten minutes what writers hold for a killed subscriber counts as growth. A node in
real time that lacks the right to a real-time priority may lack samples on a busy machine: the table
says so.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/peers"), str(ROOT / "testing")]

from conftest import BINARIES, free_domain  # noqa: E402
from diagnostics import Diagnostics, value  # noqa: E402
from friction_stage_testing import Process  # noqa: E402
from ros import Ros, nanoseconds  # noqa: E402

# What the subscribers that come and leave hear.
JOINED = ["/stage/encoder", "/stage/state", "/stage/force", "/controller/state"]
# Memory that a process may gain in the second half, kB: buffers of the allocator. What a killed
# subscriber makes it hold until the end of its lease differs with the speed of the samples.
GROWTH = 20_000
# Ends with the process that started it, also where that is killed.
LOOP = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""
COLUMNS = (
    "minutes",
    "samples",
    "stage kB",
    "fds",
    "threads",
    "controller kB",
    "fds",
    "threads",
    "p99 us",
    "max us",
    "unpublished",
    "not recorded",
)


def usage(process: Process) -> tuple[int, int, int]:
    """Resident memory, kB, descriptors and threads."""
    proc = Path(f"/proc/{process.popen.pid}")
    resident = next(
        int(line.split()[1])
        for line in (proc / "status").read_text().splitlines()
        if line.startswith("VmRSS")
    )
    return resident, len(list((proc / "fd").iterdir())), len(list((proc / "task").iterdir()))


def row(
    minutes: float, diagnostics: Diagnostics, stage: Process, controller: Process
) -> list[float]:
    status = diagnostics.newest()
    get = {pair.key: pair.value for pair in status.values}
    return [
        round(minutes, 1),
        int(get["sample"]),
        *usage(stage),
        *usage(controller),
        float(get.get("lateness_p99_us", "nan")),
        float(get.get("lateness_max_us", "nan")),
        int(get["unpublished_samples"]),
        int(get["recording_dropped_samples"]),
    ]


def join(number: int, ros: Ros, processes: list[Process], out: Path) -> Process:
    """A subscriber that has heard everything it subscribes to."""
    program = str(ROOT / "tests/peers/subscriber.py")
    joined = Process([sys.executable, program, *JOINED], out / f"subscriber_{number % 2}.log")
    processes.append(joined)
    # Python imports rclpy for half a minute where others want the processors, too.
    ros.until(lambda: "heard all" in joined.log(), f"subscriber {number}", timeout=180.0)
    return joined


def leave(number: int, joined: Process, processes: list[Process]) -> None:
    """Ends it: those with an even number in good order."""
    # Python ends with 1 when its context is shut down.
    how, expected = (
        (signal.SIGINT, (0, 1, -signal.SIGINT))
        if number % 2 == 0
        else (signal.SIGKILL, (-signal.SIGKILL,))
    )
    joined.stop(how, expected=expected)
    processes.remove(joined)


def run(arguments: argparse.Namespace) -> list[str]:
    """Prints the table; what is wrong."""
    out = Path(arguments.out or tempfile.mkdtemp(prefix="soak_"))
    out.mkdir(parents=True, exist_ok=True)
    bag = out / f"{arguments.mode}_bag"
    rate = f"{arguments.rate}"
    parameters = ["-p", f"control_rate:={rate}", "-p", f"mode:={arguments.mode}"]
    split = ["-p", "record_split_duration:=600.0", "-p", f"record:={bag}"]
    loops = [subprocess.Popen([sys.executable, "-c", LOOP]) for _ in range(arguments.busy)]
    faults: list[str] = []
    processes: list[Process] = []
    try:
        with free_domain() as domain:
            stage = Process(
                [str(BINARIES / "stage_node"), "--ros-args", *parameters, *split], out / "stage.log"
            )
            controller = Process(
                [str(BINARIES / "controller_node"), "--ros-args", "-p", f"rate:={rate}"],
                out / "controller.log",
            )
            processes += [stage, controller]
            with Ros(domain, processes) as ros:
                rows: list[list[float]] = []
                # One for all: each has a subscription.
                diagnostics = Diagnostics(ros)
                print("  ".join(f"{name:>13}" for name in COLUMNS), flush=True)
                began = time.monotonic()
                number, joined = 0, join(0, ros, processes, out)
                while (minutes := (time.monotonic() - began) / 60) < arguments.minutes:
                    rows.append(row(minutes, diagnostics, stage, controller))
                    print("  ".join(f"{cell:>13}" for cell in rows[-1]), flush=True)
                    ros.spin(min(60.0, 6.0 * arguments.minutes))
                    leave(number, joined, processes)
                    number += 1
                    joined = join(number, ros, processes, out)
                leave(number, joined, processes)
                rows.append(row(arguments.minutes, diagnostics, stage, controller))
                print("  ".join(f"{cell:>13}" for cell in rows[-1]), flush=True)
                for name, column in (("stage", 2), ("controller", 5)):
                    half = rows[: len(rows) // 2 + 1]
                    most = [max(row[column + k] for row in half) for k in range(3)]
                    # A writer that is being replaced has descriptors, too.
                    allowed = (most[0] + GROWTH, most[1], most[2])
                    for k, what in enumerate(("memory, kB,", "descriptors", "threads")):
                        if rows[-1][column + k] > allowed[k]:
                            last = rows[-1][column + k]
                            faults.append(f"{what} of the {name}: {most[k]} to {last}")
                if rows[-1][-2] or rows[-1][-1]:
                    faults.append(
                        f"{rows[-1][-2]} samples not published, {rows[-1][-1]} not recorded"
                    )
                encoder = ros.collect("/stage/encoder")
                ros.until(lambda: len(encoder) > 100, "100 samples at the end")
                last = nanoseconds(encoder[-1].header.stamp)
                last_status = int(value(diagnostics.newest(), "stamp_ns"))
                print(f"a new peer hears the sample of {last} ns (the stage is at {last_status})")
            for process in reversed(processes):
                process.stop(expected=(0, 3))
    finally:
        for process in processes:
            process.popen.kill()
            process.popen.wait()
        for loop in loops:
            loop.kill()
            loop.wait()
    check = subprocess.run(
        [str(BINARIES / "friction-stage"), "check", str(bag)], capture_output=True, text=True
    )
    print(check.stdout)
    if check.returncode != 0:
        faults.append(f"check ends with {check.returncode}")
    return faults


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mode", choices=["realtime", "lockstep"], default="realtime")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="samples per second")
    parser.add_argument("--busy", type=int, default=os.cpu_count() or 1, help="busy loops")
    parser.add_argument("--out", help="directory of logs and bag")
    # Its nodes end with it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    faults = run(parser.parse_args())
    for fault in faults:
        print(f"FAULT: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

"""Ctrl-C in long work: the exception comes at once, and the work stops."""

import signal
import subprocess
import sys

import pytest

SCRIPT = """
import os, sys, time
import friction_stage as fs

def worked():
    # CPU time of all threads but this one, in ticks.
    ticks = 0
    for thread in os.listdir("/proc/self/task"):
        try:
            with open(f"/proc/self/task/{thread}/stat") as stat:
                fields = stat.read().rsplit(")", 1)[1].split()
        except FileNotFoundError:
            continue
        if int(thread) != os.getpid():
            ticks += int(fields[11]) + int(fields[12])
    return ticks

def working():
    before = worked()
    time.sleep(0.2)
    return worked() > before

def progress(what, share):
    if progress.first:
        progress.first = False
        print("running", flush=True)
progress.first = True

try:
    WORK
except KeyboardInterrupt:
    print("interrupted", flush=True)
    # Not all of the work: for that this would take minutes.
    while working():
        pass
    print("stopped", flush=True)
    # And the package can be used on.
    print(fs.simulate(fs.Model.guide("guide_1"), fs.Motion.fast_move(0.1)).rows, flush=True)
else:
    print("it ended", flush=True)
"""

LONG_WORK = {
    "simulate": """fs.simulate(
        fs.Model.guide("guide_1"), fs.Motion.of_moves([(1e-3, 0.1, 1800.0)] * 8), progress=progress
    )""",
    "experiment": "fs.experiment('paper', progress=progress)",
    "select": """fs.select(
        '{APPLICATION}', variants=10_000_000, progress=progress
    )""",
    "identify": """
        model = fs.Model.guide("guide_2")
        effects = [{"cogging": {"amplitude": 6.0, "period": 0.024, "phase": 0.3}},
                   {"cable_chain": {"stiffness": 40.0}}]
        real = fs.Model.from_dict(model.to_dict() | {"effects": effects})
        moves = [(0.1, 1.0, 0.2), (-0.1, 0.8, 0.2), (1e-5, 0.1, 0.2), (-1e-5, 0.1, 0.2)] * 40
        train = fs.simulate(real, fs.Motion.of_moves(moves))
        check = fs.simulate(real, fs.Motion.of_moves([(-0.08, 0.9, 0.3), (0.05, 0.5, 0.1)] * 20))
        fs.identify(model, train, check, progress=progress)
""",
}


@pytest.mark.parametrize("name", LONG_WORK)
def test_ctrl_c_ends_long_work(name: str) -> None:
    from conftest import LAUNCH_CONFIG

    application = LAUNCH_CONFIG / "application_fine_step_clean.yaml"
    work = LONG_WORK[name].replace("{APPLICATION}", str(application))
    script = SCRIPT.replace("WORK", work)
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line == "running\n", process.communicate()[1]
        process.send_signal(signal.SIGINT)
        out, error = process.communicate()
    finally:
        process.kill()
        process.wait()
    assert out.split() == ["interrupted", "stopped", "9000"], (out, error)
    assert process.returncode == 0, error

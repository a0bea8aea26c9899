"""SIGINT, SIGTERM, SIGSTOP and SIGCONT: from the first moment on, under a flood of messages, and
at unexpected moments."""

import contextlib
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import BINARIES
from diagnostics import Diagnostics, number
from friction_stage_testing import PATIENCE, Process
from rcl_interfaces.srv import GetParameters
from test_crashes import (
    MOTION,
    assert_no_holes,
    assert_python_reads,
    friction_stage,
    running,
    state_of,
)

HERE = Path(__file__).parent
# Before the handlers of a program are there, its signals are the system's: it ends, as any program
# while it is loaded. From then on these many ms.
MOMENTS = [0, 1, 2, 5, 10, 20, 50, 100]
SIGNALS = [signal.SIGINT, signal.SIGTERM]
names = pytest.mark.parametrize("how", SIGNALS, ids=lambda how: how.name)


def handles(process: Process, how: signal.Signals) -> bool:
    """Whether the program, and not the one that it is started from, has a handler for the
    signal."""
    status = Path(f"/proc/{process.popen.pid}/status").read_text()
    return bool(int(re.search(r"SigCgt:\s*(\w+)", status)[1], 16) >> (how - 1) & 1)


def wait_for(condition: Callable[[], object], what: str, process: Process) -> None:
    """Waits without a pause: what follows is a matter of milliseconds."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert process.popen.poll() is None, (
            f"{process.outcome()} before {what}:\n{process.excerpt()}"
        )
        assert time.monotonic() < deadline, (
            f"{PATIENCE} s went by without {what}:\n{process.excerpt()}"
        )


def signalled(process: Process, how: signal.Signals, moment: float, expected: int) -> str:
    """Ends the program so many ms from now; its log."""
    time.sleep(moment * 1e-3)
    process.stop(how, expected=expected)
    assert "panicked" not in process.log(), process.excerpt()
    return process.log()


def wait_for_handlers(process: Process) -> None:
    wait_for(lambda: all(handles(process, each) for each in SIGNALS), "its handlers", process)


def wait_for_nodes(process: Process) -> None:
    """Until a command has started both of its nodes."""
    children = Path(f"/proc/{process.popen.pid}/task/{process.popen.pid}/children")
    wait_for(lambda: len(children.read_text().split()) == 2, "its nodes", process)


@names
@pytest.mark.parametrize("program", ["stage_node", "controller_node"])
def test_a_node_ends_in_order_from_its_first_moment_on(start, tmp_path, program, how):
    for moment in MOMENTS:
        bag = tmp_path / f"bag_{moment}"
        process = start(program, **({"record": bag} if program == "stage_node" else {}))
        wait_for_handlers(process)
        log = signalled(process, how, moment, expected=0)
        assert " ERROR " not in log and "error:" not in log, process.excerpt()
        # There is none, or a whole one.
        if bag.exists():
            assert friction_stage("check", bag, code=0)["complete"], process.excerpt()


@names
@pytest.mark.parametrize("command", ["demo", "play"])
@pytest.mark.parametrize(
    "begin",
    [
        pytest.param(wait_for_handlers, id="its handlers"),
        pytest.param(wait_for_nodes, id="its nodes"),
    ],
)
def test_a_command_and_its_nodes_end_in_order(domain, processes, tmp_path, command, how, begin):
    for moment in MOMENTS:
        home = tmp_path / f"after_{moment}"
        home.mkdir()
        out = home / "out"
        arguments = {
            "demo": ["demo", "--guides", "guide_2", "--out", str(out)],
            "play": ["play", str(MOTION), "--record", str(out)],
        }[command]
        process = Process([str(BINARIES / "friction-stage"), *arguments], home / "log")
        processes.append(process)
        begin(process)
        log = signalled(process, how, moment, expected=130)
        assert "error: interrupted; " in log, log
        assert not running(home), f"nodes of {log} run on"
        # Nothing is there that is empty; what was written is named, and a bag that was begun is
        # whole.
        assert all(any(path.iterdir()) for path in home.rglob("*") if path.is_dir()), log
        assert "nothing was written" not in log or list(home.iterdir()) == [home / "log"], log
        for file in home.rglob("*.mcap"):
            assert friction_stage("check", file.parent, code=0)["complete"], log


def traces() -> bool:
    strace = shutil.which("strace")
    return (
        bool(strace)
        and subprocess.run([strace, "-o", "/dev/null", "true"], capture_output=True).returncode == 0
    )


TRACED = pytest.mark.skipif(
    not traces(),
    reason="needs the package strace and a system that lets processes be traced (README, second "
    "command): it shows which system calls come before the handlers",
)


@names
def test_a_command_that_is_interrupted_before_its_nodes_are_there_does_nothing_more(
    domain, processes, disk, tmp_path, how
):
    """The removal of its empty directory takes long here: what went on meanwhile would show."""
    out = tmp_path / "out"
    disk.touch()
    demo = [str(BINARIES / "friction-stage"), "demo", "--guides", "guide_2", "--out", str(out)]
    process = Process(demo, tmp_path / "log")
    processes.append(process)
    wait_for(out.is_dir, "its directory", process)
    process.popen.send_signal(how)
    wait_for(lambda: not out.exists(), "the removal of its directory", process)
    # The time in which it would start its nodes.
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.popen.wait(2.0)
    disk.unlink()
    code = process.wait()
    process.stopped = True
    assert code == 130 and "error: interrupted; " in process.log(), f"{code}: {process.excerpt()}"
    assert not running(out) and not out.exists(), process.excerpt()


@TRACED
@pytest.mark.parametrize(
    "command",
    [["stage_node", "--help"], ["controller_node", "--help"], ["friction-stage", "guides"]],
)
def test_a_program_takes_over_its_signals_before_anything_else(tmp_path, command):
    calls = tmp_path / "calls"
    program = [str(BINARIES / command[0]), *command[1:]]
    trace = [
        "strace",
        "-f",
        "-o",
        str(calls),
        "-e",
        "trace=rt_sigaction,openat,socket,clone,clone3",
    ]
    subprocess.run([*trace, *program], check=True, capture_output=True, timeout=60)
    lines = calls.read_text().splitlines()
    # The last of what Rust does before main.
    begin = max(
        k
        for k, line in enumerate(lines)
        if re.search(r"rt_sigaction\(SIGBUS, \{sa_handler=0x", line)
    )
    taken = [
        k
        for k, line in enumerate(lines)
        if re.search(r"rt_sigaction\(SIG(INT|TERM), \{sa_handler=0x", line)
    ]
    assert len(taken) == 2, lines
    before = [line for line in lines[begin + 1 : max(taken)] if "rt_sigaction" not in line]
    assert not before, before


# --- SIGSTOP and SIGCONT


MODES = pytest.mark.parametrize("mode", ["realtime", "lockstep"])
RATE = 200.0


def pair(start: Callable[..., Process], mode: str, bag: Path) -> tuple[Process, Process]:
    # How long nothing comes from a node that is stopped is not what is looked at here.
    stage = start("stage_node", mode=mode, control_rate=RATE, record=bag, answer_timeout=60.0)
    return stage, start("controller_node", rate=RATE, bandwidth=10.0)


@MODES
def test_to_be_continued_without_a_stop_disturbs_no_node(ros, start, tmp_path, mode):
    nodes = pair(start, mode, tmp_path / "bag")
    states = ros.collect("/controller/state")
    ros.until(lambda: len(states) > 50, "50 states")
    for _ in range(20):
        for node in nodes:
            node.popen.send_signal(signal.SIGCONT)
        count = len(states)
        ros.until(lambda count=count: len(states) > count + 2, "the next states")
    status = Diagnostics(ros).newest()
    assert number(status, "unpublished_samples") == number(status, "missing_answers") == 0, status
    for node in nodes:
        node.stop()
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]
    assert_no_holes(assert_python_reads(tmp_path / "bag")["/stage/encoder"], round(1e9 / RATE))


@MODES
@pytest.mark.parametrize("which", ["stage", "controller"])
def test_a_node_that_is_stopped_and_continued_goes_on_and_so_does_the_other(
    ros, start, tmp_path, mode, which
):
    stage, controller = nodes = pair(start, mode, tmp_path / "bag")
    stopped = {"stage": stage, "controller": controller}[which]
    states = ros.collect("/controller/state")
    ros.until(lambda: len(states) > 50, "50 states")
    for seconds in (0.05, 0.5, 2.0):
        stopped.popen.send_signal(signal.SIGSTOP)
        ros.until(lambda: state_of(stopped) == "T", "the stop")
        ros.spin(seconds)
        stopped.popen.send_signal(signal.SIGCONT)
        count = len(states)
        ros.until(lambda count=count: len(states) > count + 50, "50 states more")
    # It is asked as before.
    asked = ros.call(GetParameters, f"/{which}/get_parameters", names=["use_sim_time"])
    assert len(asked.values) == 1
    for node in nodes:
        node.stop()
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]
    messages = assert_python_reads(tmp_path / "bag")
    assert_no_holes(messages["/stage/encoder"], round(1e9 / RATE))


@MODES
@names
def test_a_node_that_was_stopped_ends_when_it_is_continued(ros, start, tmp_path, mode, how):
    """A signal that comes while it is stopped, as of a service manager, is kept."""
    nodes = pair(start, mode, tmp_path / "bag")
    states = ros.collect("/controller/state")
    ros.until(lambda: len(states) > 50, "50 states")
    for node in nodes:
        node.popen.send_signal(signal.SIGSTOP)
        ros.until(lambda node=node: state_of(node) == "T", "the stop")
        node.popen.send_signal(how)
        node.popen.send_signal(signal.SIGCONT)
        node.ended(expected=0)
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]


# --- under a flood

FLOODS = ["/stage/force", "/stage/joint_commands", "/stage/commands", "/stage/setpoint", "services"]


@pytest.mark.timeout(300)
@MODES
@names
def test_a_node_ends_in_order_while_peers_send_without_any_pause(
    ros, start, processes, tmp_path, mode, how
):
    stage = start(
        "stage_node", mode=mode, control_rate=1000.0, record=tmp_path / "bag", answer_timeout=60.0
    )
    # Whether the loop holds meanwhile is not what is looked at here.
    controller = start("controller_node", rate=1000.0, supervision__enabled=False)
    diagnostics = Diagnostics(ros)
    diagnostics.until(lambda status: number(status, "sample") > 500, "500 samples")
    floods = []
    for kind in FLOODS:
        flood = Process(
            [sys.executable, str(HERE / "flood.py"), kind], tmp_path / f"flood-{len(floods)}.log"
        )
        processes.append(flood)
        floods.append(flood)

    def sent(flood: Process) -> int:
        # The last line may not be whole yet.
        return max(
            (
                int(line.split()[1])
                for line in flood.log().split("\n")[:-1]
                if line.startswith("sent ")
            ),
            default=0,
        )

    try:
        ros.until(
            lambda: all(sent(flood) >= 2000 for flood in floods),
            "2000 messages of each peer",
            timeout=120.0,
        )
        began = [sent(flood) for flood in floods]
        refused = diagnostics.until(
            lambda status: number(status, "refused_commands") > 1000,
            "refused commands",
            timeout=60.0,
        )
        assert refused
        for node in (stage, controller):
            code = (0, 3) if mode == "realtime" and node is stage else 0
            node.stop(how, expected=code)
            assert "panicked" not in node.log()
        # It lasted until the end.
        assert all(sent(flood) >= before for flood, before in zip(floods, began))
        assert all(flood.popen.poll() is None for flood in floods)
    finally:
        for flood in floods:
            flood.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    if stage.popen.returncode == 3:
        assert "samples are missing" in stage.log(), stage.excerpt()
    report = friction_stage("check", tmp_path / "bag", code=0)
    assert report["complete"] and not report["damage"], report
    if mode == "lockstep":
        assert_no_holes(assert_python_reads(tmp_path / "bag")["/stage/encoder"], 1_000_000)

"""Signals, kills, full disks and frozen peers: the stage goes on or ends in good order, and
recordings survive."""

import json
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import bags
import pytest
from conftest import BINARIES
from diagnostics import ERROR, OK, Diagnostics, number, value
from friction_stage_testing import Process
from mcap.reader import make_reader
from rcl_interfaces.srv import GetParameters
from ros import nanoseconds
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

HERE = Path(__file__).parent
CONTROLLER = {"rate": 1000.0, "bandwidth": 30.0}


def friction_stage(*arguments: object, code: int) -> dict:
    """The JSON that the command prints, which ends with the code."""
    command = [str(BINARIES / "friction-stage"), *map(str, arguments), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    # A warning is no failure: in lockstep the first sample may be answered twice.
    assert run.returncode in (code, 3), (
        f"{shlex.join(command)} ended with {run.returncode}:\n{run.stdout}\n{run.stderr}"
    )
    return json.loads(run.stdout)


def stamps(messages: list) -> list[int]:
    return [nanoseconds(message.header.stamp) for message in messages]


def assert_no_holes(messages: list, period: int) -> None:
    """Samples come one period (ns) after the other."""
    times = stamps(messages)
    holes = [(a, b) for a, b in zip(times, times[1:]) if b - a != period]
    assert not holes, (
        f"{len(holes)} holes or repetitions among {len(times)}, the first from {holes[0][0]} to "
        f"{holes[0][1]} ns"
    )


def assert_python_reads(bag: Path) -> dict[str, list]:
    """Both Python readers open it and find the same; the messages by topic."""
    messages, theirs = bags.with_rosbags(bag), bags.with_mcap_ros2_support(bag)
    assert {topic: len(found) for topic, found in messages.items()} == {
        topic: len(found) for topic, found in theirs.items()
    }
    return messages


# --- signals


@pytest.mark.parametrize("how, mode", [(signal.SIGINT, "lockstep"), (signal.SIGTERM, "realtime")])
def test_a_signal_while_recording_at_full_speed_closes_the_bag(ros, start, tmp_path, how, mode):
    process = start("stage_node", mode=mode, record=tmp_path / "bag")
    start("controller_node")
    status = Diagnostics(ros).until(lambda status: number(status, "sample") > 4000, "4000 samples")
    assert value(status, "recording") == "true"
    process.stop(how)
    report = friction_stage("check", tmp_path / "bag", code=0)
    assert report["complete"] and not report["damage"] and report["has_provenance"]
    messages = assert_python_reads(tmp_path / "bag")
    assert_no_holes(messages["/stage/encoder"], 250_000)
    assert stamps(messages["/stage/encoder"])[-1] >= number(status, "stamp_ns")
    assert messages["/stage/force"] and messages["/controller/state"]


def test_nodes_that_were_stopped_go_on(ros, stage, controller, subscriber, tmp_path):
    """As with Ctrl-Z and fg, or in a debugger."""
    rate = 200.0
    staged = stage(mode="realtime", control_rate=rate, record=tmp_path / "bag")
    nodes = staged, controller(rate=rate, bandwidth=10.0)
    # A few times: what the nodes wait for while they are stopped is a matter of chance.
    for seconds in (0.2, 0.5, 1.0):
        for node in nodes:
            node.popen.send_signal(signal.SIGSTOP)
        ros.until(lambda: all(state_of(node) == "T" for node in nodes), "the stop")
        ros.spin(seconds)
        for node in nodes:
            node.popen.send_signal(signal.SIGCONT)
        # They still send, and hear each other.
        controlled = ros.collect("/controller/state", depth=10)
        ros.until(lambda controlled=controlled: len(controlled) > 10, "states of the controller")
    # They find others.
    subscriber("/stage/encoder", "/stage/state", "/controller/state")
    for node in ("/stage", "/controller"):
        client = ros.node.create_client(GetParameters, f"{node}/get_parameters")
        ros.until(client.service_is_ready, f"the service of {node}")
        question = client.call_async(GetParameters.Request(names=["use_sim_time"]))
        ros.result(question, f"an answer of {node}")
    staged.stop(signal.SIGTERM)
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]
    assert_no_holes(assert_python_reads(tmp_path / "bag")["/stage/encoder"], round(1e9 / rate))


def state_of(process: Process) -> str:
    """The kernel's letter for the state of the process: T is stopped."""
    return Path(f"/proc/{process.popen.pid}/stat").read_text().rpartition(")")[2].split()[0]


# --- a killed recorder, a full disk


# A process that is killed leaves what it has handed to the system, synced or not.
@pytest.mark.parametrize("sync", ["never", "end", "interval"])
@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_killed_recording_loses_less_than_a_second(ros, start, tmp_path, mode, sync):
    process = start(
        "stage_node", mode=mode, record=tmp_path / "bag", record_sync=sync, publish_clock=True
    )
    start("controller_node")
    # When the clock of each sample was heard, as far as this process keeps up; s.
    heard: dict[int, float] = {}
    ros.node.create_subscription(
        Clock,
        "/clock",
        lambda message: heard.setdefault(nanoseconds(message.clock), time.monotonic()),
        1,
    )
    ros.until(lambda: heard, "the first sample")
    began = time.monotonic()
    # Several times what is brought to the file at once.
    ros.until(lambda: time.monotonic() - began > 1.6, "1.6 s of recording")
    killed = time.monotonic()
    process.stop(signal.SIGKILL, expected=-signal.SIGKILL)

    recovered = tmp_path / "recovered"
    report = friction_stage("recover", tmp_path / "bag", "--out", recovered, code=3)
    messages = assert_python_reads(recovered)
    kept = stamps(messages["/stage/encoder"])
    lost = killed - max(at for sample, at in heard.items() if sample <= kept[-1])
    assert lost < 1.0, f"{lost} s are lost"
    assert_no_holes(messages["/stage/encoder"], 250_000)
    # It says what it kept and what is lost.
    assert {
        topic["name"]: topic["messages"] for topic in report["topics"] if topic["messages"]
    } == {topic: len(found) for topic, found in messages.items()}
    assert lost < report["lost_at_end_s"] + 0.3 < 1.0
    assert friction_stage("check", recovered, code=0)["complete"]
    # A second look at the damaged one, for a person.
    text = subprocess.run(
        [BINARIES / "friction-stage", "recover", tmp_path / "bag", "--out", tmp_path / "again"],
        capture_output=True,
        text=True,
    ).stdout
    assert (
        "at most 0.5 s before it are missing" in text
        and f"{report['messages']} messages kept" in text
    )


@pytest.mark.parametrize("sync", ["never", "end", "interval"])
def test_files_that_were_closed_before_the_kill_are_whole(ros, start, tmp_path, sync):
    bag = tmp_path / "bag"
    process = start("stage_node", record=bag, record_sync=sync, record_split_duration=0.5)
    start("controller_node")
    open_file = bag / "bag_3.mcap"
    ros.until(open_file.exists, "the fourth file")
    process.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    before = []
    for number in range(3):
        # One that was not closed has no summary, which mcap needs to count messages.
        with (bag / f"bag_{number}.mcap").open("rb") as file:
            summary = make_reader(file).get_summary()
        topics = {id: channel.topic for id, channel in summary.channels.items()}
        counts = {topics[id]: n for id, n in summary.statistics.channel_message_counts.items()}
        assert counts["/stage/encoder"] > 0, counts
        before.append(counts["/stage/encoder"])
    report = friction_stage("recover", bag, "--out", tmp_path / "recovered", code=3)
    kept = {topic["name"]: topic["messages"] for topic in report["topics"]}["/stage/encoder"]
    assert kept >= sum(before)
    assert_no_holes(bags.with_rosbags(tmp_path / "recovered")["/stage/encoder"], 250_000)


def limited(kind: str, directory: Path) -> list[str]:
    """What runs a program so that it can write no more than 256 KiB into the directory."""
    if kind == "file size limit":
        return ["bash", "-c", 'ulimit -f 256 && exec "$@"', "bash"]
    if (
        subprocess.run(
            ["unshare", "--map-root-user", "--mount", "true"], capture_output=True
        ).returncode
        != 0
    ):
        pytest.skip("this machine lets no user mount a file system of their own")
    mount = f'mount -t tmpfs -o size=256k none {shlex.quote(str(directory))} && exec "$@"'
    return ["unshare", "--map-root-user", "--mount", "bash", "-c", mount, "bash"]


@pytest.mark.parametrize("kind", ["full disk", "file size limit"])
def test_a_disk_that_runs_full_ends_the_recording_and_not_the_stage(ros, processes, tmp_path, kind):
    small, large = tmp_path / "small", tmp_path / "large"
    small.mkdir()
    arguments = [
        "-p",
        f"record:={small}/bag",
        "-p",
        f"record_into:={large}",
        "-p",
        "control_rate:=2000.0",
    ]
    command = [*limited(kind, small), str(BINARIES / "stage_node"), "--ros-args", *arguments]
    process = Process(command, tmp_path / "stage.log")
    processes.append(process)
    encoder = ros.collect("/stage/encoder")
    diagnostics = Diagnostics(ros)
    status = diagnostics.until(lambda status: status.level == ERROR, "the error")
    told = next(
        nanoseconds(array.header.stamp) for array in diagnostics.arrays if status in array.status
    )
    reason = "File too large" if kind == "file size limit" else "No space left on device"
    for word in [
        "recording: no space left for",
        f"{small}/bag/bag_0.mcap",
        reason,
        "bytes are written",
        "recover",
    ]:
        assert word in status.message
    assert value(status, "recording") == "false"
    assert "recording ends: no space left" in process.log()
    # The stage goes on, and with it everybody who listens.
    count = len(encoder)
    ros.until(lambda: len(encoder) > count + 1000, "1000 samples more")
    assert_no_holes(encoder, 500_000)

    # As the program sees it: the file system may be its own.
    bag = Path(f"/proc/{process.popen.pid}/root") / small.relative_to("/") / "bag"
    report = friction_stage("recover", bag, "--out", tmp_path / "recovered", code=3)
    messages = assert_python_reads(tmp_path / "recovered")
    assert_no_holes(messages["/stage/encoder"], 500_000)
    # What did not fit any more is what had come since the last time that messages were brought to
    # the file.
    assert report["messages"] > 1000
    assert 0 < told - stamps(messages["/stage/encoder"])[-1] < 1.2e9
    if kind == "full disk":
        # There is room elsewhere.
        response = ros.call(SetBool, "/stage/record", data=True)
        assert response.success, response.message
        assert diagnostics.newest().level == OK
        response = ros.call(SetBool, "/stage/record", data=False)
        assert response.success, response.message
        (metadata,) = large.glob("*/metadata.yaml")
        assert friction_stage("check", metadata.parent, code=0)["complete"]
    # A recording after it does not make it whole.
    process.stop(expected=1)


# --- commands that start nodes

MOTION = HERE.parents[1] / "examples/closing_the_loop/slow_moves_to_check.yaml"


def test_a_command_says_that_its_recording_is_not_whole(domain, tmp_path):
    command = [
        *limited("file size limit", tmp_path),
        str(BINARIES / "friction-stage"),
        "play",
        str(MOTION),
    ]
    run = subprocess.run(
        [*command, "--record", str(tmp_path / "bag")], capture_output=True, text=True, timeout=60
    )
    assert run.returncode == 1 and "a recording is not whole: no space left" in run.stderr, (
        run.stderr
    )


def test_the_nodes_of_a_command_end_with_it_however_it_ends(domain, processes, tmp_path):
    command = [
        str(BINARIES / "friction-stage"),
        "play",
        str(MOTION),
        "--record",
        str(tmp_path / "bag"),
    ]
    play = Process(command, tmp_path / "play.log")
    processes.append(play)
    nodes = Path(f"/proc/{play.popen.pid}/task/{play.popen.pid}/children")

    def wait_for(what: str, is_so) -> None:
        deadline = time.monotonic() + 20.0
        while not is_so():
            assert time.monotonic() < deadline and (
                what == "the end of the nodes" or play.popen.poll() is None
            ), f"no {what}: {play.excerpt()}"
            time.sleep(0.01)

    bag = tmp_path / "bag" / "bag_0.mcap"
    wait_for("recording", lambda: bag.is_file() and bag.stat().st_size > 50_000)
    pids = nodes.read_text().split()
    assert len(pids) == 2
    play.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    wait_for("the end of the nodes", lambda: not any(alive(pid) for pid in pids))
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]


def alive(pid: str) -> bool:
    """Whether a process of another parent runs: one that has ended, and whose parent has not waited
    for it, counts as none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def running(directory: Path) -> list[str]:
    """Command lines of processes that name something in the directory."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except (FileNotFoundError, ProcessLookupError):
            continue
    return [line for line in lines if str(directory) in line]


# --- peers that freeze or die


@pytest.fixture
def subscriber(ros, processes, tmp_path):
    """subscriber(*topics): an rclpy program that has heard each of them."""

    def subscriber(*topics: str) -> Process:
        command = [sys.executable, str(HERE / "subscriber.py"), *topics]
        process = Process(command, tmp_path / f"subscriber-{len(processes)}.log")
        processes.append(process)
        ros.until(lambda: "heard all" in process.log(), f"a subscriber of {topics}")
        return process

    started = len(processes)
    yield subscriber
    # A frozen one answers no other signal.
    for process in processes[started:]:
        if process.name == Path(sys.executable).name:
            process.stop(signal.SIGKILL, expected=-signal.SIGKILL)


# Once to the end of their leases, which takes 20 s. A busy machine hears what was sampled in 5 s in
# minutes.
@pytest.mark.timeout(400)
@pytest.mark.parametrize("mode, seconds", [("realtime", 25.0), ("lockstep", 5.0)])
def test_a_frozen_and_a_killed_subscriber_neither_stall_the_stage_nor_starve_a_healthy_one(
    ros, start, subscriber, mode, seconds
):
    # More samples than a writer holds by default (8192), and fewer than a busy Python can hear.
    rate = 500.0
    topics = ["/stage/encoder", "/stage/state", "/stage/force", "/controller/state"]
    start("stage_node", mode=mode, control_rate=rate, command_timeout=1.0, answer_timeout=10.0)
    # Whether the loop holds on a busy machine is not what is looked at here.
    unsupervised = {"supervision__enabled": False, "supervision__delay": 3600.0}
    start("controller_node", rate=rate, bandwidth=30.0, **unsupervised)
    period = round(1e9 / rate)
    encoder = ros.collect("/stage/encoder")
    frozen, killed = subscriber(*topics), subscriber(*topics)
    diagnostics = Diagnostics(ros)
    ros.until(lambda: len(encoder) > 100, "100 samples")

    frozen.popen.send_signal(signal.SIGSTOP)
    killed.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    began = last = time.monotonic()
    longest = 0.0
    while last - began < seconds:
        count = len(encoder)
        ros.until(lambda: len(encoder) > count, "a sample", timeout=5.0)
        longest, last = max(longest, time.monotonic() - last), time.monotonic()
    assert longest < 1.0, f"no sample for {longest} s"
    assert_no_holes(encoder, period)
    status = diagnostics.newest()
    assert number(status, "unpublished_samples") == number(status, "missing_answers") == 0
    # The controller's commands came through as well, as those of one source.
    assert number(status, "refused_commands") == number(status, "stale_commands") == 0
    assert number(status, "refused_by_dds") == 0
    # Whatever the machine can do, the healthy one hears all that the stage has sampled.
    newest = number(status, "stamp_ns")
    ros.until(lambda: stamps(encoder[-1:])[0] >= newest, "the newest sample", timeout=300.0)
    assert_no_holes(encoder, period)


def test_a_subscriber_that_was_frozen_longer_than_its_lease_hears_the_stage_again(
    ros, stage, subscriber, domain, processes, tmp_path
):
    stage(mode="realtime", control_rate=200.0)
    # The lease of Fast DDS is 20 s, that of Cyclone DDS 10 s.
    fast = subscriber("/stage/encoder")
    command = [sys.executable, str(HERE / "cyclone_reader.py"), str(domain), "1000000"]
    cyclone = Process(command, tmp_path / "cyclone.log")
    processes.append(cyclone)
    ros.until(lambda: cyclone.log().count("\n") > 100, "a subscriber of Cyclone DDS")
    for process in (fast, cyclone):
        process.popen.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    ros.until(
        lambda: ros.node.count_subscribers("/stage/encoder") == 0, "the end of their leases", 60.0
    )
    # The stage grants them a little more.
    ros.spin(max(0.0, 30.0 - (time.monotonic() - began)))
    now = nanoseconds(ros.first("/stage/encoder").header.stamp)
    heard = fast.log().count("heard all")
    for process in (fast, cyclone):
        process.popen.send_signal(signal.SIGCONT)
    # Some of what was heard before may still wait to be taken.
    ros.until(lambda: fast.log().count("heard all") > heard + 5, "samples in Fast DDS", 60.0)

    def newest() -> int:
        # The last line may not be whole yet.
        return json.loads(cyclone.log().splitlines()[-2])[0]

    ros.until(lambda: newest() > now, "samples in Cyclone DDS", 60.0)


def test_a_client_that_was_frozen_longer_than_its_lease_is_answered_again(
    ros, stage, controller, processes, tmp_path
):
    stage(mode="realtime", control_rate=200.0)
    controller(rate=200.0, bandwidth=10.0)
    caller = Process([sys.executable, str(HERE / "caller.py")], tmp_path / "caller.log")
    processes.append(caller)
    # One that is there all the time is answered once for each question.
    healthy = ros.node.create_client(GetParameters, "/controller/get_parameters")
    ros.until(healthy.service_is_ready, "the service")

    def ask() -> None:
        question = healthy.call_async(GetParameters.Request(names=["rate"]))
        assert ros.result(question, "an answer").values[0].double_value == 200.0

    def answered(what: str) -> int:
        return caller.log().count(what)

    ros.until(lambda: answered("answer 200.0") > 1 and answered("result 0") > 1, "two of each")
    caller.popen.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    ros.until(
        lambda: ("caller", "/") not in ros.node.get_node_names_and_namespaces(),
        "the end of its lease",
        60.0,
    )
    # The controller grants it a little more.
    ros.spin(max(0.0, 30.0 - (time.monotonic() - began)))
    answers, results = answered("answer"), answered("result")
    caller.popen.send_signal(signal.SIGCONT)
    while answered("answer") < answers + 3 or answered("result 0") < results + 3:
        assert time.monotonic() - began < 100.0, caller.log()
        ask()
    caller.stop(signal.SIGKILL, expected=-signal.SIGKILL)


def test_a_killed_controller_is_missed_and_another_takes_its_place(ros, stage, controller, start):
    stage(mode="lockstep", control_rate=1000.0, answer_timeout=0.3, noise=False)
    first = controller(**CONTROLLER)
    diagnostics = Diagnostics(ros)
    encoder = ros.collect("/stage/encoder")
    ros.until(lambda: len(encoder) > 100, "100 samples")
    first.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    status = diagnostics.until(lambda status: status.level == ERROR, "the error")
    assert "the answer to the last sample is missing" in status.message
    start("controller_node", **CONTROLLER)
    waiting = number(status, "stamp_ns")
    ros.until(
        lambda: nanoseconds(encoder[-1].header.stamp) > waiting + 500_000_000,
        "half a second of simulated time",
    )
    assert diagnostics.newest().level != ERROR
    sent = sorted(set(stamps(encoder)))
    assert sent == list(range(sent[0], sent[-1] + 1, 1_000_000))
    assert all(abs(sample.position[0]) < 1e-6 for sample in encoder)


def test_a_killed_stage_can_be_started_again_at_once_and_its_controller_goes_on(
    ros, stage, controller
):
    first = stage(mode="lockstep", control_rate=1000.0)
    controller(**CONTROLLER)
    first.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    stage(mode="lockstep", control_rate=1000.0, wait_for_command=True)
    clock = ros.collect("/clock")
    ros.until(lambda: len(clock) > 500, "500 answered samples")
    assert Diagnostics(ros).newest().level == OK
    status = Diagnostics(ros, "/controller: controller").newest()
    assert number(status, "stage_restarts") == 1

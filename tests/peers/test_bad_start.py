"""Nodes that cannot start as they were told to: exit code 1 within seconds, saying what is wrong,
where, and what would be right."""

import signal
import time

import pytest
from diagnostics import ERROR, OK, Diagnostics, number
from ros import nanoseconds
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

# Joining the network and looking for a stage of the same name take half a second of it.
SECONDS = 5.0


def complaint(process) -> str:
    """The last line of a program that ends with 1 at its start."""
    began = time.monotonic()
    process.ended(expected=1)
    assert time.monotonic() - began < SECONDS
    assert "panicked" not in process.log()
    last = process.log().splitlines()[-1]
    assert last.startswith("error: "), process.log()
    return last


MODELS = {
    "cut off in a list": ("mass: 40\nguides: [guide_1, gui", ["line 2", "unclosed bracket"]),
    "cut off in a key": ("mass: 40\nmotor:\n  force_limit", ["line 3"]),
    "cut off before a value": (
        "mass: 40\nmotor:\n  force_limit:",
        ["line 3", "a number is expected"],
    ),
    "cut off to nothing": ("", ["is empty"]),
    "not YAML": ("{{{", ["line 1"]),
    "not text": ("\0\1\2", ["line 1", "unexpected character"]),
    "a list": ("- mass: 40\n", ["line 1"]),
    "mistyped key": ("mas: 40\n", ["line 1", "mas", "did you mean `mass`?"]),
    "not a number": ("mass: heavy\n", ["line 1", "a number is expected"]),
    "given twice": ("mass: 40\nmass: 41\n", ["line 2", "mass"]),
    "negative mass": ("mass: -40\n", ["mass is -40", "must be greater than 0"]),
    "mass that is none": ("mass: .nan\n", ["mass is NaN", "must be finite"]),
    "unknown guide": (
        "guides: [guide_1, guid_2]\n",
        ["guides[1]", "`guid_2`", "did you mean `guide_2`?"],
    ),
    "too many guides": (
        "guides: [guide_1, guide_1, guide_1, guide_1, guide_1]\n",
        ["1 to 4 guides", "5"],
    ),
    "unknown effect": (
        "effects:\n- coging: {amplitude: 5, period: 0.024}\n",
        ["`coging`", "did you mean `cogging`?", "cable_chain"],
    ),
    "unknown effect parameter": (
        "effects:\n- cogging: {amplitud: 5, period: 0.024}\n",
        ["effects.cogging", "`amplitud`", "did you mean `amplitude`?", "period"],
    ),
    "missing effect parameter": (
        "effects:\n- cogging: {amplitude: 5}\n",
        ["effects.cogging", "`period`", "missing"],
    ),
    "impossible effect parameter": (
        "effects:\n- cogging: {amplitude: -5, period: 0.024}\n",
        ["effects.cogging.amplitude is -5", "between 0 and 1000 N"],
    ),
}


@pytest.mark.parametrize("case", MODELS)
def test_a_model_file_that_is_none_is_refused_with_its_name(start, tmp_path, case):
    text, words = MODELS[case]
    (tmp_path / "model.yaml").write_text(text)
    said = complaint(start("stage_node", model=tmp_path / "model.yaml"))
    for word in ["parameter model", "model.yaml", *words]:
        assert word in said
    # Each thing once.
    assert said.count(words[0]) == 1


@pytest.mark.parametrize(
    "model, words",
    [
        (
            "guide_7",
            ["guide_7", "did you mean `guide_", "the catalogue has guide_1, guide_2, guide_3"],
        ),
        ("rig:guide_7", ["rig:guide_7", "did you mean `guide_"]),
        ("nowhere.yaml", ["cannot read the model file nowhere.yaml", "No such file"]),
    ],
)
def test_a_model_that_is_not_there_is_refused(start, model, words):
    said = complaint(start("stage_node", model=model))
    for word in words:
        assert word in said


@pytest.mark.parametrize(
    "program, parameters, words",
    [
        (
            "stage_node",
            {"physics_rate": 39999.0},
            ["physics_rate 39999 Hz", "control_rate 4000 Hz", "36000 or 40000 Hz"],
        ),
        (
            "stage_node",
            {"physics_rate": 2000.0},
            ["physics_rate 2000 Hz", "control_rate 4000 Hz", "4000"],
        ),
        (
            "stage_node",
            {"drive": "servo", "mode": "lockstep"},
            ["drive: servo", "mode: lockstep", "use mode: realtime"],
        ),
        ("stage_node", {"cpu": 1000}, ["parameter cpu is 1000", "must be below"]),
        ("controller_node", {"cpu": 1000}, ["parameter cpu is 1000", "must be below"]),
        ("controller_node", {"rate": 100.0}, ["lowpass.frequency", "360", "50"]),
        ("controller_node", {"gains__stage__p": 5.0}, ["gains.stage.p", "tuning"]),
    ],
)
def test_parameters_that_do_not_fit_together_are_refused(start, program, parameters, words):
    said = complaint(start(program, **parameters))
    for word in words:
        assert word in said


def test_a_bag_directory_that_cannot_be_is_refused(start, tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "file").touch()
    for directory, words in [
        (tmp_path / "bag", [f"{tmp_path}/bag exists", "never overwrites", "choose another name"]),
        (tmp_path / "file", [f"{tmp_path}/file exists"]),
        (
            tmp_path / "file" / "bag",
            [f"cannot create {tmp_path}/file/bag", f"{tmp_path}/file is a file, not a directory"],
        ),
        # No user may make a directory there, not even root.
        ("/proc/bag", ["cannot create /proc/bag"]),
    ]:
        said = complaint(start("stage_node", record=directory))
        for word in ["parameter record", *words]:
            assert word in said
    assert not any((tmp_path / "bag").iterdir()), (
        "something was written into a directory that was there"
    )


def test_the_record_service_says_why_there_is_no_bag(ros, stage, tmp_path):
    (tmp_path / "file").touch()
    process = stage(mode="realtime", control_rate=1000.0, record_into=tmp_path / "file")
    response = ros.call(SetBool, "/stage/record", data=True)
    assert not response.success
    assert f"{tmp_path}/file is a file, not a directory" in response.message
    response = ros.call(SetBool, "/stage/record", data=False)
    assert response.success and "was not recording" in response.message
    assert ros.first("/stage/encoder") and process.popen.poll() is None


def test_a_second_recording_at_once_is_refused_and_the_first_goes_on(ros, stage, tmp_path):
    stage(mode="realtime", control_rate=1000.0, record=tmp_path / "first", record_into=tmp_path)
    response = ros.call(SetBool, "/stage/record", data=True)
    assert not response.success and f"already recording to {tmp_path}/first" in response.message
    response = ros.call(SetBool, "/stage/record", data=False)
    assert response.success and str(tmp_path / "first") in response.message
    assert [metadata.parent for metadata in tmp_path.glob("*/metadata.yaml")] == [
        tmp_path / "first"
    ]


# --- one name, two stages


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_second_stage_of_the_same_name_does_not_start_and_the_first_is_unharmed(
    ros, start, stage, tmp_path, mode
):
    stage(mode=mode, control_rate=500.0)
    diagnostics = Diagnostics(ros)
    encoder = ros.collect("/stage/encoder")
    ros.until(lambda: encoder, "a sample")
    second = start("stage_node", mode=mode, record=tmp_path / "bag")
    said = ros.until(
        lambda: second.popen.poll() is not None and complaint(second), "the end of the second"
    )
    assert "another node publishes /stage/encoder already" in said
    assert "__node:=NAME" in said
    assert not (tmp_path / "bag").exists()
    count = len(encoder)
    ros.until(lambda: len(encoder) > count + 50, "50 samples more")
    stamps = [nanoseconds(sample.header.stamp) for sample in encoder]
    assert all(b - a == 2_000_000 for a, b in zip(stamps, stamps[1:]))
    assert diagnostics.newest().level == OK


def test_a_second_stage_of_another_name_runs_beside_the_first(ros, start, stage):
    stage(mode="realtime", control_rate=500.0)
    start("stage_node", "--ros-args", "-r", "__node:=other", mode="realtime", control_rate=500.0)
    samples = []
    ros.node.create_subscription(JointState, "/other/encoder", samples.append, 10)
    ros.until(lambda: samples, "a sample of the other stage")
    assert Diagnostics(ros).newest().level == OK
    assert Diagnostics(ros, "/other: stage").newest().level == OK


def test_a_controller_that_hears_two_stages_says_so_and_ends(ros, start, stage):
    stage(mode="realtime", control_rate=500.0)
    process = start("controller_node", rate=500.0, bandwidth=30.0)
    encoder, states = ros.collect("/stage/encoder"), ros.collect("/controller/state")
    ros.until(lambda: encoder and states, "a controlled stage")
    publisher = ros.node.create_publisher(JointState, "/stage/encoder", 10)

    def ended() -> bool:
        publisher.publish(encoder[-1])
        return process.popen.poll() is not None

    ros.until(ended, "the end of the controller")
    process.ended(expected=1)
    assert "the samples come from two stages at once" in complaint(process)
    assert "__node:=NAME" in complaint(process)


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_second_controller_says_so_and_ends_and_the_first_goes_on(
    ros, start, stage, controller, mode
):
    stage(mode=mode, control_rate=500.0)
    first = controller(rate=500.0, bandwidth=30.0)
    second = start("controller_node", rate=500.0, bandwidth=30.0)
    ros.until(lambda: second.popen.poll() is not None, "the end of the second controller")
    second.ended(expected=1)
    assert "another source commands /stage and this controller is refused" in complaint(second)
    encoder = ros.collect("/stage/encoder")
    ros.until(lambda: len(encoder) > 500, "a second of samples")
    assert first.popen.poll() is None
    # On a busy machine samples may come late, which is a warning.
    assert Diagnostics(ros, "/controller: controller").newest().level != ERROR


def test_a_controller_that_takes_the_place_of_a_killed_one_is_no_second_one(
    ros, start, stage, controller
):
    stage(mode="realtime", control_rate=500.0, command_timeout=3.0)
    first = controller(rate=500.0, bandwidth=30.0)
    first.stop(signal.SIGKILL, expected=-signal.SIGKILL)
    second = start("controller_node", rate=500.0, bandwidth=30.0)
    of_stage = Diagnostics(ros)
    # It is refused as long as the stage waits for the first one, and then commands.
    refused = number(
        of_stage.until(lambda s: number(s, "refused_commands") > 0, "a refusal"), "refused_commands"
    )
    of_stage.until(
        lambda s: number(s, "refused_commands") > refused and s.message == "running",
        "a stage that runs",
    )
    assert second.popen.poll() is None


def test_somebody_else_who_publishes_the_samples_is_reported(ros, start, stage):
    process = stage(mode="realtime", control_rate=500.0)
    diagnostics = Diagnostics(ros)
    assert diagnostics.newest().level == OK
    publisher = ros.node.create_publisher(JointState, "/stage/encoder", 10)
    status = diagnostics.until(lambda status: status.level == ERROR, "the error")
    for said in (status.message, process.log()):
        assert (
            "another node publishes /stage/encoder as well: two stages must not share a name"
            in said
        )
    ros.node.destroy_publisher(publisher)
    diagnostics.until(lambda status: status.level == OK, "that it is over")

"""Recordings written by the Rust library open in readers that are not ours, every topic decoded."""

import json
import subprocess

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

import read_bag
from conftest import BINARIES

SAMPLES = 3000


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    directory = tmp_path_factory.mktemp("bags") / "example"
    subprocess.run([BINARIES / "examples" / "write_bag", directory, str(SAMPLES)], check=True)
    return directory


def test_both_readers_decode_every_topic_alike(bag):
    with_rosbags = read_bag.read_with_rosbags(bag)
    assert with_rosbags == read_bag.read_with_mcap(bag)
    assert {topic: entry["count"] for topic, entry in with_rosbags.items()} == {
        "/stage/encoder": SAMPLES,
        "/stage/force_cell": SAMPLES,
        "/stage/commands": SAMPLES,
        "/stage/setpoint": SAMPLES,
        "/stage/state": SAMPLES,
        "/controller/state": SAMPLES,
        "/clock": SAMPLES,
        "/diagnostics": SAMPLES // 1000,
    }
    assert with_rosbags["/stage/state"]["type"] == "friction_stage_msgs/msg/StageState"
    assert with_rosbags["/stage/encoder"]["last"] == (SAMPLES - 1) * 250_000


def test_type_hashes_belong_to_the_definitions(bag):
    assert len(read_bag.check_type_hashes(bag)) == 8


def test_provenance_is_inside(bag):
    stored = read_bag.provenance(bag)
    assert stored["seed"] == "1"
    assert stored["model_yaml"] == "mass: 40.0\n"


def test_metadata_counts_as_the_file_does(bag):
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 5
    counted = read_bag.read_with_mcap(bag)
    assert {
        t["topic_metadata"]["name"]: t["message_count"]
        for t in information["topics_with_message_count"]
    } == {topic: entry["count"] for topic, entry in counted.items()}
    profiles = yaml.safe_load(
        information["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]
    )
    assert profiles[0]["depth"] == 100


def test_a_file_without_its_end_opens_after_recovery(bag, tmp_path):
    cut = tmp_path / "cut"
    cut.mkdir()
    whole = read_bag.mcap_files(bag)[0].read_bytes()
    (cut / "cut_0.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    run = subprocess.run(
        [BINARIES / "friction-stage", "recover", cut, "--json"],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 3, run.stderr
    report = json.loads(run.stdout)
    topics = read_bag.read_with_rosbags(report["output"])
    assert topics == read_bag.read_with_mcap(report["output"])
    assert {t["name"]: t["messages"] for t in report["topics"]} == {
        n: e["count"] for n, e in topics.items()
    }
    assert 0 < report["messages"] < 7 * SAMPLES


DAMAGES = {
    "no bracket": (b"float64[] position", b"float64] position"),
    "control character": (b"position", b"posit\x01on"),
    "not UTF-8": (b"velocity", b"velo\xffity"),
    "other name": (b"nanosec", b"nanosed"),
    "no part": (b"MSG: std_msgs/Header", b"MSG: std_msgs/Hxader"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_file_with_a_damaged_definition_opens_after_recovery(bag, tmp_path, damage):
    damaged = tmp_path / "damaged.mcap"
    original, replaced = DAMAGES[damage]
    with read_bag.mcap_files(bag)[0].open("rb") as source, damaged.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                text = schema.data.replace(original, replaced)
                schema_id = writer.register_schema(schema.name, schema.encoding, text)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, channel.metadata
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()
    command = [BINARIES / "friction-stage", "recover", damaged, "--out", tmp_path / "recovered"]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode in (0, 3), run.stderr
    whole = read_bag.read_with_mcap(bag)
    assert read_bag.read_with_rosbags(tmp_path / "recovered") == whole
    assert read_bag.read_with_mcap(tmp_path / "recovered") == whole

"""Opens a recording with two readers that are not ours and decodes every message of every topic.

    python tests/peers/read_bag.py BAG      # prints {"rosbags": {topic: {...}}, "mcap": {topic:
      {...}}}

Per topic: type, count, and the first and last log time in ns. `rosbags` reads the directory with
its metadata.yaml, `mcap` with `mcap_ros2` the file inside. A message that does not decode, or a
type hash that does not belong to its definition, raises.
"""

import json
import pathlib
import sys

import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def _note(entry, time):
    entry["count"] += 1
    entry["first"] = time if entry["first"] is None else min(entry["first"], time)
    entry["last"] = time if entry["last"] is None else max(entry["last"], time)


def mcap_files(bag):
    """Files of a rosbag2 directory, as its metadata.yaml lists them; or the file itself."""
    bag = pathlib.Path(bag)
    if bag.is_file():
        return [bag]
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return [bag / name for name in information["relative_file_paths"]]


def read_with_rosbags(bag):
    """Decodes everything with rosbags; checks the hash of each type against the definition in the
    bag."""
    topics = {}
    with AnyReader([pathlib.Path(bag)]) as reader:
        for connection in reader.connections:
            topics[connection.topic] = {
                "type": connection.msgtype,
                "count": 0,
                "first": None,
                "last": None,
            }
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert type(message).__name__.endswith(connection.msgtype.rsplit("/", 1)[1]), connection
            _note(topics[connection.topic], time)
        assert sum(t["count"] for t in topics.values()) == reader.message_count
    return topics


def read_with_mcap(bag):
    """Decodes everything with mcap and mcap_ros2, through the index of the file."""
    topics = {}
    for path in mcap_files(bag):
        with path.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            for channel in summary.channels.values():
                kind = summary.schemas[channel.schema_id].name
                topics[channel.topic] = {"type": kind, "count": 0, "first": None, "last": None}
            count = 0
            for _schema, channel, message, _decoded in reader.iter_decoded_messages():
                _note(topics[channel.topic], message.log_time)
                count += 1
            assert count == summary.statistics.message_count
    return topics


def provenance(bag):
    """What made the recording: the metadata record of friction_stage and the text of model.yaml;
    None if absent."""
    with mcap_files(bag)[0].open("rb") as stream:
        reader = make_reader(stream)
        records = [m for m in reader.iter_metadata() if m.name == "friction_stage"]
        models = [a for a in reader.iter_attachments() if a.name == "model.yaml"]
    if not records:
        return None
    return {**records[0].metadata, "model_yaml": models[0].data.decode() if models else ""}


def check_type_hashes(bag):
    """Topic -> type hash; raises if one is not the RIHS01 hash of the definition that stands beside
    it."""
    hashes = {}
    with mcap_files(bag)[0].open("rb") as stream:
        summary = make_reader(stream).get_summary()
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        expected = store.hash_rihs01(schema.name)
        assert channel.metadata["topic_type_hash"] == expected, (channel.topic, expected)
        hashes[channel.topic] = expected
    return hashes


if __name__ == "__main__":
    json.dump(
        {"rosbags": read_with_rosbags(sys.argv[1]), "mcap": read_with_mcap(sys.argv[1])},
        sys.stdout,
        indent=2,
    )
    print()

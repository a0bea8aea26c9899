"""Recorded bags, through the Python readers that ROS 2 users have."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from ros import nanoseconds


def with_rosbags(bag: Path) -> dict[str, list]:
    """All messages by topic, in the order of the bag, decoded with the definitions inside the
    bag."""
    messages = defaultdict(list)
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            messages[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return dict(messages)


def with_mcap_ros2_support(bag: Path) -> dict[str, list]:
    """The same through mcap-ros2-support."""
    messages = defaultdict(list)
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages():
                messages[channel.topic].append(message)
    return dict(messages)


def by_stamp(messages: list) -> dict[int, Any]:
    """By stamp in ns; of several messages with one stamp the first."""
    return {nanoseconds(message.header.stamp): message for message in reversed(messages)}

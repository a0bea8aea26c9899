"""Reads /stage/encoder with Cyclone DDS, which shares no code with the nodes or with rclpy.

usage: cyclone_reader.py DOMAIN COUNT. Prints stamp (ns), name, position, velocity, effort of COUNT
samples as JSON.
"""

import json
import os
import sys
from dataclasses import dataclass

# Loopback has no multicast: look for participants at their unicast ports.
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.types import float64, int32, sequence, uint32  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


domain, count = int(sys.argv[1]), int(sys.argv[2])
participant = DomainParticipant(domain)
qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)
reader = DataReader(participant, Topic(participant, "rt/stage/encoder", JointState), qos)
# What tells that a publisher was lost is no sample.
samples = (s for s in reader.take_iter(timeout=duration(seconds=90)) if isinstance(s, JointState))
for _, sample in zip(range(count), samples):
    stamp = sample.header.stamp.sec * 10**9 + sample.header.stamp.nanosec
    print(
        json.dumps([stamp, sample.name, sample.position, sample.velocity, sample.effort]),
        flush=True,
    )

"""RTPS datagrams made by hand, little endian (DDSI-RTPS 2.5, chapter 9), as a stranger on the
network may send them."""

import os
import socket
import struct
from pathlib import Path

HEARTBEAT, GAP, NACK_FRAG, ACKNACK, DATA, DATA_FRAG = 0x07, 0x08, 0x12, 0x06, 0x15, 0x16
PARTICIPANTS = bytes.fromhex("000100c7 000100c2")
PUBLICATIONS = bytes.fromhex("000003c7 000003c2")
SUBSCRIPTIONS = bytes.fromhex("000004c7 000004c2")
ANY_READER = bytes(4)
WRITER = bytes.fromhex("00000103")
END_OF_PARAMETERS = struct.pack("<HH", 1, 0)


def submessage(kind: int, body: bytes, flags: int = 0) -> bytes:
    return struct.pack("<BBH", kind, flags | 1, len(body)) + body


def number(value: int) -> bytes:
    """A sequence number."""
    return struct.pack("<II", value >> 32 & 0xFFFFFFFF, value & 0xFFFFFFFF)


def parameter(kind: int, value: bytes) -> bytes:
    value += bytes(-len(value) % 4)
    return struct.pack("<HH", kind, len(value)) + value


def string(text: str) -> bytes:
    return struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def locator(address: str, port: int) -> bytes:
    return struct.pack("<iI", 1, port) + bytes(12) + socket.inet_aton(address)


def data(entities: bytes, sequence: int, payload: bytes) -> bytes:
    return submessage(
        DATA, struct.pack("<HH", 0, 16) + entities + number(sequence) + payload, flags=4
    )


def fragment(entities: bytes, sequence: int, sample_size: int, fragment_size: int = 1400) -> bytes:
    head = struct.pack("<HH", 0, 28) + entities + number(sequence)
    return submessage(
        DATA_FRAG, head + struct.pack("<IHHI", 1, 1, fragment_size, sample_size) + bytes(64)
    )


def heartbeat(entities: bytes, first: int, last: int, count: int = 1) -> bytes:
    return submessage(HEARTBEAT, entities + number(first) + number(last) + struct.pack("<i", count))


def gap(entities: bytes, first: int, end: int) -> bytes:
    return submessage(GAP, entities + number(first) + number(end) + struct.pack("<I", 0))


def acknack(entities: bytes, base: int, count: int) -> bytes:
    return submessage(ACKNACK, entities + number(base) + struct.pack("<IIi", 32, 0xFFFFFFFF, count))


def fragment_request(entities: bytes, sequence: int, first: int, count: int = 1) -> bytes:
    return submessage(
        NACK_FRAG, entities + number(sequence) + struct.pack("<IIIi", first, 32, 0xFFFFFFFF, count)
    )


def unicast_ports(process: int) -> list[int]:
    """The ports at which a participant of this process hears what is sent to it alone (DDSI-RTPS
    2.5, 9.6.2.3)."""
    links = [os.readlink(link.path) for link in os.scandir(f"/proc/{process}/fd")]
    lines = [line.split() for line in Path(f"/proc/{process}/net/udp").read_text().splitlines()[1:]]
    ports = sorted(
        {int(line[1].partition(":")[2], 16) for line in lines if f"socket:[{line[9]}]" in links}
    )
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    return [port for port in ports if first + 10 <= port < first + 250]


class Stranger:
    """A participant of its own that only sends, to all ports of one process."""

    def __init__(
        self, process: int, address: str = "127.0.0.1", own_address: str = "127.0.0.1"
    ) -> None:
        self.prefix = bytes([1, 15]) + os.urandom(10)
        self.own_address = own_address
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((own_address, 0))
        self.targets = [(address, port) for port in unicast_ports(process)]

    def message(self, *submessages: bytes, prefix: bytes | None = None) -> bytes:
        return b"RTPS\2\3\1\x0f" + (prefix or self.prefix) + b"".join(submessages)

    def send(self, datagram: bytes) -> None:
        for target in self.targets:
            self.socket.sendto(datagram, target)

    def announcement(self) -> bytes:
        """Its participant, with a lease of 100 s and the usual built-in endpoints."""
        port = self.socket.getsockname()[1]
        parameters = [
            parameter(0x15, b"\2\3"),
            parameter(0x16, b"\1\x0f"),
            parameter(0x50, self.prefix + b"\0\0\1\xc1"),
            parameter(0x32, locator(self.own_address, port)),
            parameter(0x31, locator(self.own_address, port)),
            parameter(0x02, struct.pack("<iI", 100, 0)),
            parameter(0x58, struct.pack("<I", 0xC3F)),
        ]
        return self.message(
            data(PARTICIPANTS, 1, b"\0\3\0\0" + b"".join(parameters) + END_OF_PARAMETERS)
        )

    def publication(self, topic: str, type_name: str) -> bytes:
        """A reliable writer on a topic."""
        parameters = [
            parameter(0x5A, self.prefix + WRITER),
            parameter(0x05, string(topic)),
            parameter(0x07, string(type_name)),
            parameter(0x1A, struct.pack("<IiI", 2, 0, 0x19999999)),
        ]
        return self.message(
            data(PUBLICATIONS, 1, b"\0\3\0\0" + b"".join(parameters) + END_OF_PARAMETERS)
        )

    def force(self, sequence: int, newton: float) -> bytes:
        """A `geometry_msgs/WrenchStamped` without a stamp, from that writer."""
        payload = b"\0\1\0\0" + struct.pack("<iI", 0, 0) + string("") + bytes(3)
        # CDR aligns doubles to 8 bytes after the encapsulation header.
        payload += bytes(-(len(payload) - 4) % 8) + struct.pack("<6d", newton, 0, 0, 0, 0, 0)
        # Whoever has missed those before does not wait for them.
        entities = ANY_READER + WRITER
        return self.message(
            heartbeat(entities, sequence, sequence, sequence), data(entities, sequence, payload)
        )

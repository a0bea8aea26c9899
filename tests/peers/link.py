"""A network link between two machines that delays and loses packets.

The second machine is a network namespace, each end of the link a TAP device (Linux,
`Documentation/networking/tuntap`), and a program of its own carries the packets from one to the
other: what `tc netem` does, on kernels that lack it.

To be used in a network namespace of one's own (`unshare --net`, with `--map-root-user` where one is
not root).
"""

import fcntl
import os
import random
import select
import signal
import struct
import subprocess
import sys
import time
from collections import deque

HERE, THERE = "10.77.0.1", "10.77.0.2"
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
LARGEST_FRAME = 65_536
# What the Ethernet address of a multicast of IPv4 begins with (RFC 1112, 6.4).
MULTICAST = bytes([0x01, 0x00, 0x5E])


def run(*command: str) -> None:
    subprocess.run(command, check=True)


def tap(name: str) -> int:
    """A new TAP device; what is read from the descriptor is what was sent to it."""
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TAP | IFF_NO_PI))
    return descriptor


class Link:
    """Joins this namespace, with the address HERE, to a new one with the address THERE.

    `delay` in seconds and `loss` as a share, in each direction. Without `multicast` it carries
    none, as many clouds, tunnels and wireless networks.
    """

    def __init__(self, delay: float, loss: float, multicast: bool = True) -> None:
        run("ip", "link", "set", "lo", "up")
        self.machine = subprocess.Popen(["unshare", "--net", "sleep", "600"])
        # Until it has left this namespace.
        mine = os.readlink("/proc/self/ns/net")
        while os.readlink(f"/proc/{self.machine.pid}/ns/net") == mine:
            time.sleep(0.01)
        # What runs a command on the second machine.
        self.there = ["nsenter", "--target", str(self.machine.pid), "--net"]
        ends = tap("here"), tap("there")
        run("ip", "link", "set", "there", "netns", str(self.machine.pid))
        for inside, name, address in (([], "here", HERE), (self.there, "there", THERE)):
            run(*inside, "ip", "addr", "add", f"{address}/24", "dev", name)
            run(*inside, "ip", "link", "set", name, "up")
            run(*inside, "ip", "route", "add", "224.0.0.0/4", "dev", name)
            run(*inside, "ip", "link", "set", "lo", "up")
        command = [sys.executable, __file__, *map(str, (*ends, delay, loss, int(multicast)))]
        self.carrier = subprocess.Popen(command, pass_fds=ends)
        for end in ends:
            os.close(end)

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, *_: object) -> None:
        for process in (self.carrier, self.machine):
            process.send_signal(signal.SIGKILL)
            process.wait()


def carry(ends: tuple[int, int], delay: float, loss: float, multicast: bool) -> None:
    """Carries packets until it is killed."""
    # The same packets in each run as far as these are the same.
    chance = random.Random(1)
    waiting: dict[int, deque[tuple[float, bytes]]] = {end: deque() for end in ends}
    other = dict(zip(ends, reversed(ends)))
    poll = select.poll()
    for end in ends:
        poll.register(end, select.POLLIN)
    while True:
        due = min((queue[0][0] for queue in waiting.values() if queue), default=None)
        left = None if due is None else max(0.0, due - time.monotonic()) * 1e3
        for end, _ in poll.poll(left):
            now = time.monotonic()
            try:
                while frame := os.read(end, LARGEST_FRAME):
                    carried = multicast or not frame.startswith(MULTICAST)
                    if carried and chance.random() >= loss:
                        waiting[other[end]].append((now + delay, frame))
            except BlockingIOError:
                pass
        now = time.monotonic()
        for end, queue in waiting.items():
            while queue and queue[0][0] <= now:
                os.write(end, queue.popleft()[1])


if __name__ == "__main__":
    here, there, delay, loss, multicast = sys.argv[1:]
    carry((int(here), int(there)), float(delay), float(loss), multicast == "1")

"""subscriber.py TOPIC...: an rclpy program that subscribes with the defaults, and says whenever it
has heard each topic since it said so last, twice a second at most."""

import sys

import rclpy

from ros import TOPICS

rclpy.init()
node = rclpy.create_node("subscriber")
silent = set(sys.argv[1:])


def hear(topic: str) -> None:
    silent.discard(topic)


def tell() -> None:
    if not silent:
        print("heard all", flush=True)
        silent.update(sys.argv[1:])


for name in sys.argv[1:]:
    node.create_subscription(TOPICS[name], name, lambda _, topic=name: hear(topic), 10)
node.create_timer(0.5, tell)
rclpy.spin(node)

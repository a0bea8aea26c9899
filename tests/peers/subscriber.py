"""subscriber.py TOPIC...: an rclpy program that subscribes with the defaults, says when it has heard each topic, and goes on."""

import sys

import rclpy

from ros import TOPICS

rclpy.init()
node = rclpy.create_node("subscriber")
silent = set(sys.argv[1:])


def hear(topic: str) -> None:
    silent.discard(topic)
    if not silent:
        print("heard all", flush=True)
        silent.add("")


for name in sys.argv[1:]:
    node.create_subscription(TOPICS[name], name, lambda _, topic=name: hear(topic), 10)
rclpy.spin(node)

"""Stands in for rclpy where ROS is not installed: timers run, what is published is printed as JSON lines, one cmd_vel arrives."""

import json
import time

NODES = []
LIMIT_S = 20.0


def init(args=None):
    assert args == [], f"arguments meant for the node itself reached ROS: {args}"


def plain(value):
    if isinstance(value, (bytes, bytearray)):
        import array

        values = array.array("f", value)
        return {"len": len(values), "max": max(values), "at": values.index(max(values))}
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "__dict__"):
        return {key: plain(item) for key, item in vars(value).items()}
    return value


def spin(node):
    """Until three messages of every publisher were seen, one of the diagnostics."""
    begun, due = time.monotonic(), [time.monotonic()] * len(node.timers)
    while time.monotonic() - begun < LIMIT_S:
        for index, (period_s, call) in enumerate(node.timers):
            if time.monotonic() >= due[index]:
                due[index] += period_s
                call()
        for topic, call in node.subscriptions.items():
            call(node.next_twist())
        if all(publisher.count >= (1 if publisher.topic == "/diagnostics" else 3) for publisher in node.publishers):
            return
        time.sleep(0.01)
    raise SystemExit(f"not seen in {LIMIT_S} s: {[(p.topic, p.count) for p in node.publishers]}")


class Publisher:
    def __init__(self, kind, topic):
        self.kind, self.topic, self.count = kind, topic, 0

    def publish(self, message):
        assert isinstance(message, self.kind)
        self.count += 1
        print(json.dumps({"topic": self.topic, "message": plain(message)}), flush=True)

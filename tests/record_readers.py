"""Reads a recording with the two Python packages that ROS users without ROS have, and compares it with what was recorded.

Arguments: recording, folder with expected.json and the images as raw float32. Prints one JSON object: messages by topic and reader.
"""

import json
import math
import struct
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore


def same(a, b):
    return a == b or (math.isnan(a) and math.isnan(b))


class Judge:
    def __init__(self, folder):
        self.folder = Path(folder)
        self.expected = json.loads((self.folder / "expected.json").read_text())
        self.counts = {}
        self.scans = self.images = self.commands = 0

    def look(self, topic, message):
        self.counts[topic] = self.counts.get(topic, 0) + 1
        if topic.endswith("/scan"):
            self.scan(topic.split("/")[3], message)
        elif topic.endswith("/energyscape"):
            self.image(topic.split("/")[3], message)
        elif topic == "/noctule/cmd_vel":
            linear, angular = self.expected["commands"][self.commands]
            assert message.twist.linear.x == linear and message.twist.angular.z == angular, self.commands
            assert message.header.frame_id == "base_link"
            self.commands += 1
        elif topic == "/tf_static":
            for transform in message.transforms:
                x, y, yaw = self.expected["mounts"][transform.child_frame_id]
                assert transform.header.frame_id == "base_link"
                assert abs(transform.transform.translation.x - x) < 1e-12
                assert abs(transform.transform.translation.y - y) < 1e-12
                turned = 2.0 * math.atan2(transform.transform.rotation.z, transform.transform.rotation.w)
                assert abs(math.remainder(turned - yaw, math.tau)) < 1e-12
        elif topic == "/diagnostics":
            assert any(value.key == "state" for value in message.status[0].values)

    def key(self, sensor, header):
        return f"{sensor}_{header.stamp.sec}_{header.stamp.nanosec}"

    def scan(self, sensor, message):
        expected = self.expected["scans"][self.key(sensor, message.header)]
        ranges = [struct.unpack("<f", bytes.fromhex(text))[0] for text in expected]
        assert len(message.ranges) == len(ranges) and message.angle_increment > 0.0
        assert all(same(float(a), b) for a, b in zip(message.ranges, ranges)), sensor
        assert message.header.frame_id == f"sonar_{sensor}"
        last = message.angle_min + (len(ranges) - 1) * message.angle_increment
        assert abs(last - message.angle_max) < 1e-4
        finite = [value for value in ranges if math.isfinite(value)]
        assert all(message.range_min <= value <= message.range_max for value in finite)
        self.scans += 1

    def image(self, sensor, message):
        assert message.encoding == "32FC1" and message.is_bigendian == 0 and message.step == 4 * message.width
        values = np.frombuffer(bytes(message.data), dtype="<f4").reshape(message.height, message.width)
        expected = np.fromfile(self.folder / f"{self.key(sensor, message.header)}.f32", dtype="<f4")
        assert np.array_equal(values.ravel(), expected), sensor
        self.images += 1

    def report(self):
        return {"topics": self.counts, "scans": self.scans, "images": self.images, "commands": self.commands}


def with_mcap_ros2(path, folder):
    judge = Judge(folder)
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        attached = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        assert b"config_version" in attached["noctule.toml"]
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            judge.look(channel.topic, message)
    return judge.report()


def with_rosbags(path, folder):
    judge = Judge(folder)
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, raw in reader.messages():
            judge.look(connection.topic, reader.deserialize(raw, connection.msgtype))
    return judge.report()


if __name__ == "__main__":
    readers = {"mcap_ros2": with_mcap_ros2, "rosbags": with_rosbags}
    print(json.dumps({name: read(*sys.argv[1:3]) for name, read in readers.items()}))

#!/usr/bin/env python3
"""noctule as a ROS 2 node, without linking ROS into noctule: shared memory on one side, rclpy on the other.

    source /opt/ros/jazzy/setup.bash
    pip install 'iceoryx2==0.10.0' numpy
    python3 ros2_node.py [--config robot.toml] [--noctule PATH]

Publishes   sonar_<name>/energyscape  sensor_msgs/Image 32FC1, row = direction from right to left, column = range
            noctule/command           geometry_msgs/TwistStamped, what the daemon decided
            noctule/platform          geometry_msgs/TwistStamped, what the base is really told
            /diagnostics              diagnostic_msgs/DiagnosticArray, states, reasons, counts; once a second
Subscribes  cmd_vel                   geometry_msgs/Twist, the wanted velocity: noctule decides what becomes of it

The base listens to noctule-controller itself (examples/base_driver.rs), never to this node: a crash here moves nothing.
"""

import argparse
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist, TwistStamped
from noctule_client import BOOTTIME, Energyscapes, Failure, Inputs, Reports, ask_topics
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image

LOOK_S = 0.02
STALE_NS = 300_000_000  # As the controller: what is older says nothing of the robot.


class Noctule(Node):
    def __init__(self, topics):
        super().__init__("noctule")
        sensors = [name.split("/")[2] for name in topics[2] if name.endswith("/energyscape")]
        self.images = [(Energyscapes(topics, name), self.sensor_publisher(name)) for name in sensors]
        self.velocities = [
            (Reports(topics, name), self.create_publisher(TwistStamped, name, 10))
            for name in ("noctule/command", "noctule/platform")
        ]
        self.health = Reports(topics, "noctule/health")
        self.inputs = Inputs(topics)
        self.newest = {"noctule/command": None, "noctule/platform": None, "noctule/health": None}
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(Twist, "cmd_vel", self.on_cmd_vel, 1)
        self.create_timer(LOOK_S, self.look)
        self.create_timer(1.0, self.diagnose)

    def sensor_publisher(self, name):
        return self.create_publisher(Image, f"sonar_{name}/energyscape", qos_profile_sensor_data)

    def on_cmd_vel(self, twist):
        self.inputs.send(twist.linear.x, twist.angular.z)

    def look(self):
        for energyscapes, publisher in self.images:
            if (ping := energyscapes.newest()) is not None:
                publisher.publish(self.image(energyscapes.sensor, ping))
        for reports, publisher in self.velocities:
            if (report := reports.newest()) is not None:
                self.newest[reports.name] = report
                message = TwistStamped()
                self.stamp(message.header, report.t_wall_ns, "base_link")
                message.twist.linear.x, message.twist.angular.z = report.linear_m_s, report.angular_rad_s
                publisher.publish(message)
        self.newest["noctule/health"] = self.health.newest() or self.newest["noctule/health"]

    @staticmethod
    def stamp(header, t_wall_ns, frame_id):
        header.stamp.sec, header.stamp.nanosec = divmod(t_wall_ns, 1_000_000_000)
        header.frame_id = frame_id

    def image(self, sensor, ping):
        message = Image()
        self.stamp(message.header, ping.header.t_wall_ns, f"sonar_{sensor}")
        message.height, message.width = ping.image.shape
        message.encoding, message.is_bigendian, message.step = "32FC1", sys.byteorder == "big", 4 * message.width
        message.data = ping.image.tobytes()
        return message

    def diagnose(self):
        array = DiagnosticArray()
        self.stamp(array.header, time.time_ns(), "")
        command, health = self.newest["noctule/command"], self.newest["noctule/health"]
        status = DiagnosticStatus(name="noctule: daemon", hardware_id="noctule")
        if command is None or time.clock_gettime_ns(BOOTTIME) - command.t_published_ns > STALE_NS:
            status.level, status.message = DiagnosticStatus.STALE, "no command for 300 ms"
        else:
            words = {field: self.velocities[0][0].word(command, field) for field in ("state", "reason", "layer")}
            well = words["state"] in ("READY", "ACTIVE")
            status.level = DiagnosticStatus.OK if well else DiagnosticStatus.WARN
            if words["state"] == "FAULT":
                status.level = DiagnosticStatus.ERROR
            status.message = f"{words['state']}: {words['reason']}"
            status.values = [KeyValue(key=key, value=word) for key, word in words.items()]
        if health is not None:
            counts = ("ping_set_count", "dropped_count", "late_count", "gpu_loss_count", "stop_count", "latency_p99_ms")
            status.values += [KeyValue(key=key, value=str(getattr(health, key))) for key in counts]
        array.status = [status]
        self.diagnostics.publish(array)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--config", help="the configuration that noctule runs with")
    parser.add_argument("--noctule", default="noctule", help="the program to ask for the layout")
    arguments, ros_arguments = parser.parse_known_args()
    try:
        topics = ask_topics(arguments.noctule, arguments.config)
        rclpy.init(args=ros_arguments)
        rclpy.spin(Noctule(topics))
    except Failure as failure:
        print(failure, file=sys.stderr)
        return failure.code
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())

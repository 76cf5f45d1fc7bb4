from geometry_msgs.msg import Twist

from . import Publisher


class Node:
    def __init__(self, name):
        self.name, self.publishers, self.timers, self.subscriptions = name, [], [], {}

    def create_publisher(self, kind, topic, qos):
        self.publishers.append(Publisher(kind, topic))
        return self.publishers[-1]

    def create_subscription(self, kind, topic, call, qos):
        assert kind is Twist
        self.subscriptions[topic] = call

    def create_timer(self, period_s, call):
        self.timers.append((period_s, call))

    def next_twist(self):
        twist = Twist()
        twist.linear.x, twist.angular.z = 0.125, -0.5
        return twist

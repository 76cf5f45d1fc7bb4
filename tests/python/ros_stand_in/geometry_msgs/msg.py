class Vector3:
    def __init__(self):
        self.x = self.y = self.z = 0.0


class Twist:
    def __init__(self):
        self.linear, self.angular = Vector3(), Vector3()


class Time:

    def __setattr__(self, name, value):
        # rclpy refuses what does not fit its fields.
        assert isinstance(value, int) and 0 <= value < (1 << 31), f"{name} = {value!r}"
        super().__setattr__(name, value)


class Header:
    def __init__(self):
        self.stamp, self.frame_id = Time(), ""


class TwistStamped:
    def __init__(self):
        self.header, self.twist = Header(), Twist()

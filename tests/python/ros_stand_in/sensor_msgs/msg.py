from geometry_msgs.msg import Header


class Image:
    def __init__(self):
        self.header = Header()
        self.height = self.width = self.step = 0
        self.encoding, self.is_bigendian, self.data = "", 0, b""

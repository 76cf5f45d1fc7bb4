from geometry_msgs.msg import Header


class KeyValue:
    def __init__(self, *, key, value):
        assert isinstance(key, str) and isinstance(value, str)
        self.key, self.value = key, value


class DiagnosticStatus:
    OK, WARN, ERROR, STALE = 0, 1, 2, 3

    def __init__(self, *, name="", hardware_id=""):
        self.level, self.name, self.message, self.hardware_id, self.values = 0, name, "", hardware_id, []


class DiagnosticArray:
    def __init__(self):
        self.header, self.status = Header(), []

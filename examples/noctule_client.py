"""Reads noctule's energyscapes from shared memory. Put this file beside your own program:

    from noctule_client import Energyscapes, ask_topics
    energyscapes = Energyscapes(ask_topics())
    while True:
        ping = energyscapes.next()
        print(ping.header.sequence, ping.image.shape, ping.peak())

`noctule topics --json` tells where the shared memory is, which services there are and the byte layout of their types,
so no layout is repeated here. Never publishes, makes no service, waits for nothing without a limit.
"""

import contextlib
import ctypes
import dataclasses
import faulthandler
import fcntl
import importlib.metadata
import json
import os
import subprocess
import time

WHEEL = "0.10.0"  # noctule's version of iceoryx2. No other one connects, not even another patch version.
INSTALL = f"install with: pip install 'iceoryx2=={WHEEL}' numpy matplotlib"
SETUP_LIMIT_S = 3.0
BOOTTIME = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # The clock of all stamps `t_..._ns`; Linux has it.
EQUAL_DIRECTIONS = 1  # Bit of the header's flags: first direction and step tell all directions.
C_TYPES = {
    **{"u8": ctypes.c_uint8, "u32": ctypes.c_uint32, "u64": ctypes.c_uint64},
    **{"i16": ctypes.c_int16, "f32": ctypes.c_float, "f64": ctypes.c_double},
}


class Failure(Exception):
    """One line for the user, and an exit code: 65 data that do not fit, 69 nothing there, 74 unreadable file."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


try:
    FOUND = importlib.metadata.version("iceoryx2")
    import iceoryx2 as iox2
    import numpy as np
except ImportError as error:
    raise ImportError(f"{error}; {INSTALL}") from error
if FOUND != WHEEL:
    # Another version sees no service, or calls a sound one broken: better said here than guessed there.
    raise ImportError(f"iceoryx2 {FOUND} is here, but noctule speaks {WHEEL} and no other version; {INSTALL}")
iox2.set_log_level(iox2.LogLevel.Fatal)  # Errors come as exceptions; its own lines would say them twice.


def ask_topics(noctule="noctule", config=None, timeout_s=10.0):
    """What `noctule topics --json` answers. `config` is the file that the daemon runs with, if it does with one."""
    command = [noctule, "topics", "--json", *(["--config", config] if config else [])]
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, timeout=timeout_s)
    except OSError as error:
        raise Failure(69, f"cannot run {noctule}: {error.strerror}; --noctule PATH tells where it is") from error
    except subprocess.TimeoutExpired as error:
        raise Failure(69, f"`{' '.join(command)}` gave no answer in {timeout_s:g} s") from error
    if done.returncode != 0:  # Its own explanation is on stderr already.
        raise Failure(done.returncode, f"`{' '.join(command)}` ended with {done.returncode}")
    return parse_topics(done.stdout, noctule)


def load_topics(path):
    """The same answer, saved in a file."""
    try:
        with open(path, "rb") as file:
            return parse_topics(file.read(), path)
    except OSError as error:
        raise Failure(74, f"cannot read {path}: {error.strerror}") from error


def parse_topics(text, origin):
    try:
        topics = json.loads(text)
        return topics["root"], topics["prefix"], {service["name"]: service for service in topics["services"]}
    except (ValueError, KeyError, TypeError) as error:
        raise Failure(65, f"{origin}: not what `noctule topics --json` writes: {error!r}") from error


def structure(described):
    """A ctypes structure from its description. iceoryx2 compares type name, size and alignment when we connect."""
    name, fields = described["type_name"], described["fields"]
    members = [(f["name"], C_TYPES[f["type"]] * f["count"] if f["count"] > 1 else C_TYPES[f["type"]]) for f in fields]
    made = type("Header", (ctypes.Structure,), {"_fields_": members, "type_name": staticmethod(lambda: name)})
    for field in fields:
        offset = getattr(made, field["name"]).offset
        if offset != field["offset"]:
            raise Failure(65, f"{name}: {field['name']} is at byte {offset} here, at byte {field['offset']} in noctule")
    if ctypes.sizeof(made) != described["size"]:
        raise Failure(65, f"{name} has {ctypes.sizeof(made)} bytes here, {described['size']} in noctule")
    # Types of one name and size may still differ in the order of their fields; the hash of the layout tells them apart.
    made.schema_hash_here = described["schema_hash"]
    made.words = {f["name"]: {int(number): word for number, word in f.get("values", {}).items()} for f in fields}
    return made


@contextlib.contextmanager
def setup_lock(root, deadline):
    """One process at a time connects, noctule's own included: under this lock they repair what crashes left behind."""
    directory = os.open(root, os.O_RDONLY | os.O_CLOEXEC)
    try:
        while True:
            try:
                fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:
                if time.monotonic() >= deadline:
                    raise Failure(69, f"another process has held the lock of {root} all the time") from error
                time.sleep(0.002)
        # Native code can wait for ever for shared memory that a killed process left half made, and no Python runs
        # meanwhile. This ends the process from outside the interpreter: with a traceback and exit code 1.
        faulthandler.dump_traceback_later(SETUP_LIMIT_S, exit=True)
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        os.close(directory)


@dataclasses.dataclass
class Ping:
    """One energyscape, copied: ours to keep."""

    header: ctypes.Structure  # fields as in `noctule topics`
    image: "np.ndarray"  # [direction][range], linear amplitude, 1 is full scale
    lost: int = 0  # pings that were sent since the one before, and not seen

    def peak(self):
        """Range in m, bearing in degrees (left positive) and value of the strongest cell."""
        direction, column = np.unravel_index(np.argmax(self.image), self.image.shape)
        bearing_rad = self.header.direction_first_rad + direction * self.header.direction_step_rad
        range_m = self.header.range_first_m + column * self.header.range_step_m
        return range_m, float(np.degrees(bearing_rad)), float(self.image[direction, column])

    def age_ms(self):
        """Time since the emission."""
        return (time.clock_gettime_ns(BOOTTIME) - self.header.t_monotonic_ns) / 1e6


class Connection:
    """A port of one topic. Node and service are kept, since the connection ends with them."""

    def __init__(self, topics, name, timeout_s):
        self.root, self.prefix, self.services = topics
        self.name = name
        deadline = time.monotonic() + timeout_s
        config = iox2.config.default()  # Explicit: otherwise an iceoryx2.toml lying around could lead us elsewhere.
        config.global_cfg.root_path = iox2.Path.new(self.root)
        config.global_cfg.prefix = iox2.FileName.new(self.prefix)
        trouble = f"{self.root} does not exist"
        while True:
            if os.path.isdir(self.root):  # Never made here: noctule makes it, private to one user.
                with setup_lock(self.root, deadline):
                    try:
                        node = iox2.NodeBuilder.new().config(config)
                        self.node = node.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(
                            iox2.ServiceType.Ipc
                        )
                        # open(), not open_or_create(): a guest makes no services.
                        self.service = self.typed(self.node.service_builder(iox2.ServiceName.new(self.name))).open()
                        self.port = self.make_port()
                        return
                    except (
                        iox2.NodeCreationFailure,
                        iox2.PublishSubscribeOpenError,
                        iox2.SubscriberCreateError,
                        iox2.PublisherCreateError,
                    ) as error:
                        trouble = str(error)
            if trouble == "IncompatibleTypes":
                raise Failure(65, f"{self.name} carries other types than `noctule topics --json` says")
            if time.monotonic() >= deadline:
                raise Failure(
                    69, f"{self.name} is not published ({trouble}); is noctule running with this configuration?"
                )
            time.sleep(0.05)

    def described(self, part):
        """The type of a topic's header or payload as `noctule topics --json` describes it."""
        try:
            return self.services[self.name][part]
        except (KeyError, TypeError) as error:
            raise Failure(65, f"{self.name}: unexpected description: {error!r}") from error

    def make_port(self):
        return self.service.subscriber_builder().create()

    def samples(self):
        """What waits, oldest first; each is given back when the next one is asked for."""
        for _ in range(64):  # More than any buffer holds; a limit, so that a fast sender cannot keep us here.
            try:
                sample = self.port.receive()
            except iox2.ReceiveError as error:
                raise Failure(69, f"{self.name}: cannot receive ({error})") from error
            if sample is None:
                return
            try:
                yield sample
            finally:
                sample.delete()


class Reports(Connection):
    """A subscription to a topic of single samples: noctule/command, /platform, /cues, /health."""

    def __init__(self, topics, name, timeout_s=5.0):
        self.services, self.name = topics[2], name
        self.type = structure(self.described("payload"))
        super().__init__(topics, name, timeout_s)

    def typed(self, builder):
        return builder.publish_subscribe(self.type)

    def word(self, report, field):
        """The name of a number: of a state, a reason, a layer."""
        number = getattr(report, field)
        return self.type.words[field].get(number, str(number))

    def newest(self):
        """A copy of the newest sample since the last call, or None. Judge it by its stamp, never by its arrival."""
        newest = None
        for sample in self.samples():
            report = self.type.from_buffer_copy(sample.payload().contents)
            if report.schema_hash == self.type.schema_hash_here:
                newest = report
        return newest


class Inputs(Connection):
    """Asks for velocities on noctule/input. noctule decides: what is near, stale or unseen still stops the robot."""

    def __init__(self, topics, timeout_s=5.0):
        self.services, self.name, self.sequence = topics[2], "noctule/input", 0
        self.type = structure(self.described("payload"))
        super().__init__(topics, self.name, timeout_s)

    def typed(self, builder):
        return builder.publish_subscribe(self.type)

    def make_port(self):
        return self.service.publisher_builder().create()

    def send(self, linear_m_s, angular_rad_s):
        """Valid for half a second: to be called at least twice a second."""
        self.sequence += 1
        wanted = self.type(
            schema_hash=self.type.schema_hash_here,
            sequence=self.sequence,
            t_monotonic_ns=time.clock_gettime_ns(BOOTTIME),
            t_wall_ns=time.time_ns(),
            linear_m_s=linear_m_s,
            angular_rad_s=angular_rad_s,
        )
        self.port.send_copy(wanted)


class Energyscapes(Connection):
    """A subscription to the energyscapes of one sensor, by default of the first."""

    def __init__(self, topics, sensor=None, timeout_s=5.0):
        names = [
            name.split("/")[2]
            for name in topics[2]
            if name.startswith("noctule/sonar/") and name.endswith("/energyscape")
        ]
        self.sensor = sensor or (names[0] if names else None)
        if self.sensor not in names:
            raise Failure(2, f"no energyscape of sensor {self.sensor!r}; sensors are: {', '.join(names) or 'none'}")
        self.services, self.name = topics[2], f"noctule/sonar/{self.sensor}/energyscape"
        self.header_type = structure(self.described("header"))
        self.cell_type = C_TYPES[self.described("payload")["type_name"]]
        self.sequence = None
        super().__init__(topics, self.name, timeout_s)

    def typed(self, builder):
        return builder.publish_subscribe(iox2.Slice[self.cell_type]).user_header(self.header_type)

    def copy(self, sample):
        """The ping in a sample. A copy, because noctule writes later pings where this one lies."""
        header = self.header_type.from_buffer_copy(sample.user_header().contents)
        if header.schema_hash != self.header_type.schema_hash_here:
            raise Failure(65, f"{self.name}: the writer has another header layout than `noctule topics --json` says")
        if not header.flags & EQUAL_DIRECTIONS:
            raise Failure(65, f"{self.name}: the directions are a list, not equal steps in the horizontal plane")
        shape, payload = (header.direction_count, header.range_count), sample.payload()
        # A trap of the binding: len() of a slice is in bytes, and as_memory_view() reaches beyond the end.
        if shape[0] * shape[1] * ctypes.sizeof(self.cell_type) != payload.len() or payload.len() == 0:
            raise Failure(
                65, f"{self.name}: {payload.len()} bytes are no image of {shape[0]} directions x {shape[1]} ranges"
            )
        cells = ctypes.cast(payload.as_ptr(), ctypes.POINTER(self.cell_type))
        return Ping(header, np.ctypeslib.as_array(cells, shape).copy())

    def newest(self):
        """The newest ping, or None when none came since the last call. Older ones are let go."""
        best = None
        for sample in self.samples():
            ping = self.copy(sample)
            # By time of emission: what a publisher left behind when it died can come after newer pings.
            if best is None or ping.header.t_monotonic_ns > best.header.t_monotonic_ns:
                best = ping
        if best is not None:
            if self.sequence is not None:  # A number that goes backwards is a restarted sensor, not a loss.
                best.lost = max(0, best.header.sequence - self.sequence - 1)
            self.sequence = best.header.sequence
        return best

    def next(self, timeout_s=5.0, idle=lambda: time.sleep(0.002)):
        """Waits for a ping newer than the last one. Calls `idle` meanwhile."""
        deadline = time.monotonic() + timeout_s
        while (ping := self.newest()) is None:
            if time.monotonic() >= deadline:
                raise Failure(69, f"{self.name}: no ping for {timeout_s:g} s")
            idle()
        return ping

"""The nodes and clients of `uwserver bench ros`, in a process of their own: ``python -m uwserver_bench.ros.ros_load``."""

from __future__ import annotations

import contextlib
import re
import selectors
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any
from urllib.parse import urlsplit

from uwserver.simulation.clock import SystemTime
from uwserver_bench.net.traced import TICKS, open_trace
from uwserver_bench.processes import carry_out
from uwserver_bench.report import quantile
from uwserver_bench.websocket import WebSocket

IMU = "sensor_msgs/msg/Imu"
MATCH_S = 20.0
"""Wall time within which the first message must arrive."""
SETTLE_S = 0.5
_STAMP = re.compile(rb'"stamp":\{"sec":(\d+),"nanosec":(\d+)\}')
_CDR_STAMP = slice(4, 12)
_clock = SystemTime()

Task = Mapping[str, Any]
Take = Callable[[int, int, int], None]
"""Takes the number of a client, and the stamp of its message: seconds and nanoseconds."""


class _Count:
    """Counts messages for each client, and measures their delays from the end of their tick."""

    def __init__(self, task: Task, clients: int = 1) -> None:
        self._ends, self._rate_hz, self._epoch_s = open_trace(task["trace"]), task["rate_hz"], task["epoch_s"]
        self.counts, self.late = [0] * clients, list[float]()
        self._begin_ns = 0

    def begin(self) -> None:
        """Begin to count."""
        self.counts, self.late, self._begin_ns = [0] * len(self.counts), [], _clock.now_ns()

    def take(self, client: int, sec: int, nanosec: int) -> None:
        """Count one message."""
        self.counts[client] += 1
        tick = round(((sec - self._epoch_s) + nanosec * 1e-9) * self._rate_hz)
        self.late.append((_clock.now_ns() - int(self._ends[tick % TICKS])) * 1e-9)

    def result(self) -> dict[str, object]:
        """Return the latency, and the rate of the slowest client."""
        seconds = (_clock.now_ns() - self._begin_ns) * 1e-9
        if not self.late:
            raise ValueError("no message came")
        return {"p50_s": quantile(self.late, 0.5), "per_s": min(self.counts) / seconds}


def bridge(task: Task) -> dict[str, object]:
    """Let `clients` of rosbridge receive `topics` for `seconds`."""
    count = _Count(task, task["clients"])
    with contextlib.ExitStack() as stack, selectors.DefaultSelector() as selector:
        streams = [stack.enter_context(_opened(task["address"])) for _ in range(task["clients"])]
        for client, stream in enumerate(streams):
            for topic in task["topics"]:
                stream.send(f'{{"op":"subscribe","topic":"{topic}"}}')
            selector.register(stream, selectors.EVENT_READ, client)
        return _hear(selector, streams, count, task["seconds"])


@contextlib.contextmanager
def _opened(address: str) -> Iterator[WebSocket]:
    place = urlsplit(address)
    with socket.create_connection((place.hostname or "", place.port or 0), timeout=MATCH_S) as stream:
        yield WebSocket(stream, place.netloc)


def _hear(selector: Any, streams: list[WebSocket], count: _Count, seconds: float) -> dict[str, object]:
    for length in (SETTLE_S, seconds):
        count.begin()
        end = _clock.now_ns() + int(length * 1e9)
        while _clock.now_ns() < end:
            for key, _ in selector.select(0.1):
                for _, message in streams[key.data].read():
                    found = _STAMP.search(message)
                    if found is not None:
                        count.take(key.data, int(found[1]), int(found[2]))
    return count.result()


def _stamp(data: bytes) -> tuple[int, int]:
    part = data[_CDR_STAMP]
    return int.from_bytes(part[:4], "little"), int.from_bytes(part[4:], "little")


def zenoh(task: Task) -> dict[str, object]:
    """Let a node on zenoh receive `topics` for `seconds`."""
    import zenoh as library
    from uwserver_adapters.ros.messages import Types
    from uwserver_adapters.ros2.graph import Names

    config = library.Config()
    for path, value in (
        ("mode", '"client"'), ("connect/endpoints", f'["{task["address"]}"]'), ("scouting/multicast/enabled", "false"),
    ):  # fmt: skip
        config.insert_json5(path, value)
    count, types = _Count(task), Types()

    def came(sample: Any) -> None:
        count.take(0, *_stamp(sample.payload.to_bytes()))

    with library.open(config) as session:
        names = Names(task["domain"], str(session.zid()), "bench")
        held = [session.declare_subscriber(names.key(topic, IMU, types.hash(IMU)), came) for topic in task["topics"]]
        result = _wait(count, task["seconds"])
        for one in held:
            one.undeclare()
    return result


def dds(task: Task) -> dict[str, object]:
    """Let a participant of CycloneDDS receive `topics` for `seconds`."""
    from cyclonedds.core import Listener
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from uwserver_adapters.ros.messages import Types
    from uwserver_adapters.ros2.idl import Classes
    from uwserver_adapters.ros2.rmw_dds import localhost, own_address

    count, kind = _Count(task), Classes(Types()).raw(IMU)

    class Came(Listener):
        """Counts the messages that are there."""

        def on_data_available(self, reader: Any) -> None:
            for one in reader.take(1000):
                count.take(0, *_stamp(one.data))

    domain = Domain(task["domain"], localhost(own_address()))
    participant = DomainParticipant(task["domain"])
    qos = Qos(
        Policy.Reliability.BestEffort,
        Policy.History.KeepLast(1000),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    listener: Any = Came()  # type: ignore[no-untyped-call]
    held = [DataReader(participant, Topic(participant, f"rt{topic}", kind), qos=qos) for topic in task["topics"]]
    for reader in held:
        reader.set_listener(listener)
    try:
        return _wait(count, task["seconds"])
    finally:
        for reader in held:
            reader.set_listener(None)  # a reader that is deleted while a listener runs never returns
        held.clear()
        del participant, domain


def _wait(count: _Count, seconds: float) -> dict[str, object]:
    """Wait while others count: for the first message, then some time, then for `seconds`."""
    end = _clock.now_ns() + int(MATCH_S * 1e9)
    while not count.late and _clock.now_ns() < end:
        time.sleep(0.01)
    time.sleep(SETTLE_S)
    count.begin()
    time.sleep(seconds)
    return count.result()


if __name__ == "__main__":
    carry_out({"bridge": bridge, "zenoh": zenoh, "dds": dds}, "ros", (OSError, ValueError, RuntimeError))

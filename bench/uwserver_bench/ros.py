"""ROS: processor time of making a message for each transport; and what peers receive (`ros_peers`)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from uwserver_adapters.ros.feed import OutgoingMessage
from uwserver_adapters.ros.messages import Facts, SensorTopic, Types
from uwserver_adapters.ros.messages.catalogue import topics_of
from uwserver_adapters.rosbridge.codec import published

from uwserver.ports import Buffer, Field, Port, Sample
from uwserver_bench.processes import BenchFailed
from uwserver_bench.ros_peers import bench_peers
from uwserver_bench.rows import Row

IMU_BAR_US, PICTURE_BAR_MS, WRITE_BAR_US = 8.0, 0.2, 5.0
HEIGHT, WIDTH = 256, 512
REPEATS, QUICK_REPEATS = 7, 2

_AXES = tuple(Field(name, "1", name, "S", (3,)) for name in ("f_S", "w_S"))
_IMU = Port("rov/imu", "sensor", "imu", _AXES, "An IMU.", rate_hz=200.0, message="Imu")
_SAMPLE = Sample("rov/imu", 0, 123_456_789, 123_456_789, True, ((0.1, 0.2, -9.81), (0.01, 0.02, 0.03)))


def bench_ros(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on ROS.

    Args:
        quick: few short repeats of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a message was not made, or a process did not work as expected.
    """
    return [*bench_messages(quick, say), *bench_peers(quick, say)]


def bench_messages(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the rows on the cost of a message. Arguments and errors are those of `bench_ros`."""
    say("ros: messages")
    repeats, times = (QUICK_REPEATS, 50) if quick else (REPEATS, 5000)
    types = Types()
    sensor_topic = topics_of(types, Facts(), _IMU)[0]
    picture = Buffer.of(np.zeros((HEIGHT, WIDTH), np.uint8))

    def message() -> object:
        return sensor_topic.make(_SAMPLE)

    def cdr() -> object:
        return OutgoingMessage(types, sensor_topic.type, _fail, _SAMPLE, sensor_topic).raw

    def long_way() -> object:
        return types.cdr(message())

    def text() -> object:
        return published(
            sensor_topic.name, OutgoingMessage(types, sensor_topic.type, _fail, _SAMPLE, sensor_topic).plain, "none"
        )

    def image() -> object:
        header = types.header(0, "rov/camera")
        made = types.make(
            "sensor_msgs/msg/Image", header=header, height=HEIGHT, width=WIDTH, data=picture.array().ravel()
        )
        return types.cdr(made)

    def copy() -> object:
        return bytearray(picture.data)

    if cdr() != long_way():
        raise BenchFailed("the short cut of Imu gives other bytes than the long way")
    pictures = [_ms(image, times // 25) - _ms(copy, times // 25) for _ in range(repeats)]
    rows = [
        _row("CDR of an Imu", "us", cdr, repeats, times, 1e3, IMU_BAR_US),
        _row("CDR of an Imu by way of a message", "us", long_way, repeats, times, 1e3, None),
        _row("rosbridge: JSON frame of an Imu", "us", text, repeats, times, 1e3, None),
        Row(
            "ros",
            f"CDR of an image of {HEIGHT} x {WIDTH}, beyond a copy",
            "ms",
            tuple(pictures),
            at_most=PICTURE_BAR_MS,
        ),
    ]
    return [*rows, _write(types, sensor_topic, repeats, times)]


def _write(types: Types, sensor_topic: SensorTopic, repeats: int, times: int) -> Row:
    """Write bytes with CycloneDDS, without a reader, on an unused domain."""
    name = "DDS: write of an Imu"
    try:
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic
    except ImportError:
        return Row("ros", name, "us", (), at_most=WRITE_BAR_US, note="cyclonedds is not installed")
    from uwserver_adapters.ros2.idl import Classes
    from uwserver_adapters.ros2.rmw_dds import LOCALHOST, endpoint_qos, write

    number = 231
    domain = Domain(number, LOCALHOST)
    participant = DomainParticipant(number)
    topic = Topic(participant, "rt/rov/imu", Classes(types).of(sensor_topic.type))
    writer = DataWriter(participant, topic, qos=endpoint_qos(types.hash(sensor_topic.type)))
    data = OutgoingMessage(types, sensor_topic.type, _fail, _SAMPLE, sensor_topic).raw
    if data is None:
        raise BenchFailed("no Imu was made")
    row = _row(name, "us", lambda: write(writer, data), repeats, times, 1e3, WRITE_BAR_US)
    del domain  # it must be deleted after what is on it
    return row


def _fail(type_name: str, error: Exception) -> None:
    raise BenchFailed(f"{type_name} was not made: {error}")


def _row(
    name: str, unit: str, work: Callable[[], object], repeats: int, times: int, factor: float, bar: float | None
) -> Row:
    return Row("ros", name, unit, tuple(factor * _ms(work, times) for _ in range(repeats)), at_most=bar)


def _ms(work: Callable[[], object], times: int) -> float:
    """Return the processor time of one call: the least of three rounds, because the others were disturbed."""
    times, best = max(times, 1), math.inf
    for _ in range(3):
        begin = time.thread_time()
        for _ in range(times):
            work()
        best = min(best, time.thread_time() - begin)
    return 1e3 * best / times

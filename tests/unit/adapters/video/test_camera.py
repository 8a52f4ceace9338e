"""A camera of MAVLink, as a ground station asks it; all bytes are read by pymavlink."""

from __future__ import annotations

import asyncio
import math
import socket
from typing import Any

import pytest
from uwserver_adapters.video.config import StreamTable
from video_rig import PATIENCE_S, camera, context, sample, serving

mavlink: Any = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega", reason="pymavlink is not installed")
from uwserver_adapters.video.camera import Camera, Command, Decoder, Facts  # noqa: E402  # it needs pymavlink

FACTS = Facts("front", "rov/camera", "5600", True, True, True, (640, 480), 25.0, 4_000_000)
RTSP = FACTS._replace(uri="rtsp://192.0.2.1:8554/front", is_rtp=False, is_h264=False, is_running=False, size=(0, 0))
STATION = (255, 190)


def read(data: bytes) -> list[Any]:
    parser = mavlink.MAVLink(None)
    return list(parser.parse_buffer(data) or ())


def long(number: int, first: float = 0.0, second: float = 0.0, target: tuple[int, int] = (1, 100)) -> bytes:
    station = mavlink.MAVLink(None, *STATION)
    return bytes(station.command_long_encode(*target, number, 0, first, second, 0, 0, 0, 0, 0).pack(station))


def asked(data: bytes, facts: Facts = FACTS, component: int = 100) -> list[Any]:
    """The answers of a camera to a datagram."""
    camera_ = Camera(1, component)
    return read(b"".join(said for command in Decoder().commands(data) for said in camera_.answer(command, facts, 1234)))


def test_a_heartbeat_is_that_of_a_camera():
    (beat,) = read(Camera(3, 101).heartbeat())
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (3, 101)
    assert (beat.type, beat.autopilot) == (mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID)


@pytest.mark.parametrize("number", [512, 521])
def test_what_a_camera_can_do(number):
    ack, told = asked(long(number, 259.0 if number == 512 else 1.0))
    assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", number, 0)
    assert (ack.target_system, ack.target_component) == STATION
    assert told.get_type() == "CAMERA_INFORMATION"
    assert told.flags == mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM == 256
    assert bytes(told.vendor_name).rstrip(b"\0") == b"uwserver"
    assert bytes(told.model_name).rstrip(b"\0") == b"rov/camera"
    assert (told.resolution_h, told.resolution_v, told.cam_definition_uri, told.time_boot_ms) == (640, 480, "", 1234)


@pytest.mark.parametrize("request_", [(512, 269.0, 0.0), (512, 269.0, 1.0), (2504, 0.0, 0.0), (2504, 1.0, 0.0)])
def test_where_the_video_is(request_):
    ack, told = asked(long(*request_))
    assert ack.result == 0
    assert told.get_type() == "VIDEO_STREAM_INFORMATION"
    assert (told.stream_id, told.count, told.type, told.flags) == (1, 1, mavlink.VIDEO_STREAM_TYPE_RTPUDP, 1)
    assert (told.uri, told.name, told.encoding) == ("5600", "front", mavlink.VIDEO_STREAM_ENCODING_H264)
    assert (told.framerate, told.resolution_h, told.resolution_v, told.bitrate) == (25.0, 640, 480, 4_000_000)
    _, told = asked(long(*request_), RTSP)
    assert (told.type, told.uri, told.encoding, told.flags) == (mavlink.VIDEO_STREAM_TYPE_RTSP, RTSP.uri, 0, 0)


@pytest.mark.parametrize("request_", [(512, 270.0), (2505, 1.0)])
def test_how_the_video_is(request_):
    _, told = asked(long(*request_))
    assert told.get_type() == "VIDEO_STREAM_STATUS"
    assert (told.stream_id, told.flags, told.framerate, told.resolution_h) == (1, 1, 25.0, 640)


def test_what_there_is_not():
    for request_, result in (
        ((512, 269.0, 2.0), 2), ((2504, 7.0), 2), ((512, 30.0), 3), ((512, math.nan), 3), ((512, 1e30), 3), ((400, 1.0), 3), ((2502, 1.0), 0),
    ):  # fmt: skip
        (ack,) = asked(long(*request_))
        assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", request_[0], result), request_


def test_others_are_meant():
    assert asked(long(512, 259.0, target=(1, 1))) == []
    assert asked(long(512, 259.0, target=(2, 100))) == []
    assert asked(long(400, 1.0, target=(1, 0))) == []
    assert len(asked(long(512, 259.0, target=(0, 0)), component=101)) == 2


def test_a_command_int_asks_too():
    station = mavlink.MAVLink(None, *STATION)
    data = bytes(station.command_int_encode(1, 100, 0, 512, 0, 0, 269.0, 0, 0, 0, 0, 0, 0).pack(station))
    assert [message.get_type() for message in asked(data)] == ["COMMAND_ACK", "VIDEO_STREAM_INFORMATION"]


def test_long_names_are_cut():
    _, told = asked(long(2504), FACTS._replace(name="x" * 100, uri="rtsp://" + "h" * 300))
    assert (told.name, told.uri) == ("x" * 31, ("rtsp://" + "h" * 300)[:159])
    _, told = asked(long(521), FACTS._replace(model="ü" * 100))
    assert bytes(told.model_name) == b"?" * 31 + b"\0"


@pytest.mark.parametrize(
    ("data", "bad"),
    [
        (b"", 0), (b"\0" * 100, 1), (b"\xfd" * 300, 1), (long(512, 259.0)[:-1], 1), (b"\xfe\x00", 1),
        (long(512, 259.0)[:-2] + b"ab", 1), (long(512, 259.0) + b"x", 1),
    ],
)  # fmt: skip
def test_datagrams_that_are_none(data, bad):
    decoder = Decoder()
    found = list(decoder.commands(data))
    assert decoder.bad == bad
    assert found == ([Command(1, 100, STATION, 512, 259.0, 0.0)] if data.endswith(b"x") else [])


def test_no_more_of_a_datagram_is_looked_at_than_there_may_be():
    assert len(list(Decoder().commands(long(512, 259.0) * 40))) == 8


class Station(asyncio.DatagramProtocol):
    """A ground station at a port."""

    def __init__(self) -> None:
        self.heard: list[Any] = []
        self.peer: Any = None

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.peer = addr
        self.heard += read(data)

    async def hears(self, kind: str) -> Any:
        while not (found := [message for message in self.heard if message.get_type() == kind]):
            await asyncio.sleep(0.01)
        self.heard.clear()
        return found[-1]


def test_a_ground_station_finds_the_cameras_of_a_world():
    async def whole() -> None:
        transport, station = await asyncio.get_running_loop().create_datagram_endpoint(
            Station, local_addr=("127.0.0.1", 0)
        )
        try:
            to = f"127.0.0.1:{transport.get_extra_info('sockname')[1]}"
            back = camera("rov/back", shape=(240, 320, 3))
            streams = {
                "front": StreamTable(port="rov/camera", rtp="127.0.0.1:5600"),
                "back": StreamTable(port="rov/back", codec="jpeg", rtp=("127.0.0.1:5604",)),
            }
            async with serving(context(camera(), back), streams=streams, mavlink=(to,)) as fake:
                await station.hears("HEARTBEAT")
                transport.sendto(long(512, 269.0), station.peer)
                told = await station.hears("VIDEO_STREAM_INFORMATION")
                assert (told.get_srcComponent(), told.uri, told.name) == (100, "5600", "front")
                transport.sendto(long(512, 269.0, target=(1, 101)), station.peer)
                told = await station.hears("VIDEO_STREAM_INFORMATION")
                assert (told.get_srcComponent(), told.type) == (101, mavlink.VIDEO_STREAM_TYPE_RTSP)
                assert told.uri == f"{fake.stats.address}back"
                assert (told.resolution_h, told.resolution_v) == (320, 240)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                    stranger.setblocking(False)
                    stranger.sendto(long(512, 269.0), station.peer)
                    with pytest.raises(asyncio.TimeoutError):
                        await asyncio.wait_for(asyncio.get_running_loop().sock_recv(stranger, 2048), 0.3)
                fake.put([sample(0)])
        finally:
            transport.abort()

    asyncio.run(asyncio.wait_for(whole(), PATIENCE_S))

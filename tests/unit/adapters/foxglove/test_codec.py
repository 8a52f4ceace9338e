"""The messages of foxglove.sdk.v1: what the server of foxglove-sdk sends, byte for byte, and what it takes."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Iterator
from typing import Any

import pytest
from uwserver_adapters.foxglove import codec
from uwserver_adapters.foxglove.codec import BadMessage, ClientData, PlaybackControl, ServiceCall
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from uwserver.ports import Argument, Field, Port, Service

PORT = Port(
    "rov/dvl",
    "sensor",
    "dvl",
    (Field("v_S", "m/s", "velocity", "S", (3,)), Field("locks", "1", "x", type="bool")),
    "A DVL.",
    message="Dvl",
)
SERVICE = Service(
    "rov/set",
    "Set.",
    (Argument("rate", "float", "a rate", "Hz"), Argument("way", "float", "x", "m", False, None, (2, 3))),
)


class Listener:
    """What the SDK's server calls."""

    def __init__(self) -> None:
        self.heard: list[Any] = []

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("on_"):
            raise AttributeError(name)
        return lambda *arguments: None

    def on_message_data(self, _client: Any, channel: int, data: bytes) -> None:
        self.heard.append(ClientData(channel, data))

    def on_playback_control_request(self, request: Any) -> Any:
        from foxglove.websocket import PlaybackState, PlaybackStatus

        self.heard.append(request)
        return PlaybackState(PlaybackStatus.Paused, 5_250_000_000, 2.0, True, request.request_id)


@pytest.fixture
def sdk() -> Iterator[tuple[Any, Any, Listener]]:
    foxglove = pytest.importorskip("foxglove")
    from foxglove.websocket import Capability

    listener = Listener()
    schema = foxglove.ServiceSchema(
        "t",
        request=foxglove.MessageSchema(
            encoding="json", schema=foxglove.Schema(name="q", encoding="jsonschema", data=b"{}")
        ),
    )
    service = foxglove.Service("x", schema=schema, handler=lambda request: request.payload)
    context = foxglove.Context()
    capabilities = [Capability.ClientPublish, Capability.Services, Capability.Time]
    server = foxglove.start_server(
        name="u", port=0, context=context, server_listener=listener, capabilities=capabilities, services=[service],
        supported_encodings=["json"], session_id="s-1", playback_time_range=(1_000_000_000, 9_500_000_000),
    )  # fmt: skip
    channel = foxglove.Channel("rov/dvl", schema={"type": "object"}, context=context)
    yield server, channel, listener
    server.stop()


def test_what_the_sdk_says_we_say_too(sdk: tuple[Any, Any, Listener]) -> None:
    server, channel, listener = sdk

    async def converse() -> None:
        protocols = [Subprotocol(codec.SUBPROTOCOLS[0])]
        async with connect(f"ws://127.0.0.1:{server.port}", subprotocols=protocols) as peer:

            async def hear() -> Any:
                return await asyncio.wait_for(peer.recv(), 60.0)

            info = json.loads(await hear())
            ours = codec.server_info(
                "u",
                ["clientPublish", "services", "time", "playbackControl"],
                "s-1",
                (1_000_000_000, 9_500_000_000),
                info["metadata"],
            )
            assert json.loads(ours) == info
            (told,) = json.loads(await hear())["channels"]
            ours_told = codec.told_channel(
                told["id"], codec.Channel("rov/dvl", "json", told["schemaName"], told["schema"], "jsonschema")
            )
            assert ours_told == told
            (service,) = json.loads(await hear())["services"]
            mine = codec.told_service(1, SERVICE)
            assert mine.keys() >= {"id", "name", "type", "request"} <= service.keys()
            assert mine["request"].keys() == service["request"].keys()  # type: ignore[union-attr]
            await peer.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": told["id"]}]}))
            await peer.send(struct.pack("<BIII", 2, 1, 99, 4) + b'json{"k":1}')
            assert await hear() == codec.response(1, 99, b'{"k":1}')  # so the subscription before it was taken, too
            channel.log({"a": 1}, log_time=77)
            assert await hear() == codec.data(7, 77, b'{"a": 1}')
            server.broadcast_time(123456)
            assert await hear() == codec.time(123456)
            await peer.send(struct.pack("<BIII", 2, 55, 98, 4) + b"json{}")
            assert json.loads(await hear()) == json.loads(codec.call_failed(55, 98, "Unknown service"))
            control = struct.pack("<BBfBQI", 3, 1, 2.0, 1, 4_000_000_000, 3) + b"abc"
            await peer.send(control)
            assert await hear() == codec.playback_state(codec.PAUSED, 5.25, 2.0, True, "abc")
            request = listener.heard[-1]
            assert codec.read_binary(control) == PlaybackControl(False, 2.0, request.seek_time, request.request_id)
            await peer.send(b"\x09")
            assert json.loads(await hear()).keys() == json.loads(codec.status(2, "x")).keys()

    asyncio.run(converse())


def test_channels_and_services_have_schemas_with_units() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(codec.port_channel(PORT).schema)
    assert schema["properties"]["value"]["properties"]["v_S"]["description"] == "velocity; unit m/s; frame S"
    message = {"seq": 1, "t_ns": 2, "t_sent_ns": 3, "valid": True, "value": {"v_S": [1.0, 2.0, 3.0], "locks": True}}
    jsonschema.validate(message, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**message, "value": {"v_S": [1.0]}}, schema)
    request = json.loads(codec.told_service(3, SERVICE)["request"]["schema"])  # type: ignore[index, call-overload, arg-type]
    jsonschema.validate({"rate": 1.0, "way": [[1, 2, 3], [4, 5, 6]]}, request)
    for wrong in ({}, {"rate": "x"}, {"rate": 1, "other": 2}, {"rate": 1, "way": [[1, 2, 3]]}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, request)


@pytest.mark.parametrize(
    ("message", "read"),
    [
        (struct.pack("<BI", 1, 9) + b"{}", ClientData(9, b"{}")),
        (struct.pack("<BIII", 2, 3, 4, 4) + b"json{}", ServiceCall(3, 4, "json", b"{}")),
        (struct.pack("<BBfBQI", 3, 0, 1.5, 0, 7, 0), PlaybackControl(True, 1.5, None, "")),
    ],
)
def test_binary_messages(message: bytes, read: object) -> None:
    assert codec.read_binary(message) == read
    for end in range(len(message) - 2):
        if end < 5:
            with pytest.raises(BadMessage):
                codec.read_binary(message[:end])


@pytest.mark.parametrize(
    "message",
    [
        b"", b"\x00", b"\x09", b"\x02" * 5, struct.pack("<BIII", 2, 1, 1, 1 << 31) + b"json", struct.pack("<BIII", 2, 1, 1, 2) + b"\xff\xfe",
        struct.pack("<BBfBQI", 3, 9, 1.0, 0, 0, 0), struct.pack("<BBfBQI", 3, 0, 1.0, 0, 0, 5) + b"x",
    ],
)  # fmt: skip
def test_what_is_no_message_is_refused(message: bytes) -> None:
    with pytest.raises(BadMessage):
        codec.read_binary(message)


@pytest.mark.parametrize("message", ["", "[]", "{", '{"op":1}', "{}", "[" * 100_000])
def test_what_is_no_text_is_refused(message: str) -> None:
    with pytest.raises(BadMessage):
        codec.read_text(message)

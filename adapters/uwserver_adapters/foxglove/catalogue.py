"""What a server offers, under the numbers by which clients ask for it."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping

from uwserver.adapter import AdapterContext
from uwserver.adapter.foxglove import SCHEMAS, shown_as
from uwserver.ports import Port, Service
from uwserver_adapters.foxglove.codec import Channel, port_channel

SCENE, FRAMES, LOG = "/scene", "/tf", "/log"


class Catalogue:
    """Numbers once given stay: a topic that comes back has its old one.

    Attributes:
        channels: by number.
        services: by number.
        numbers: of each channel that is there, by topic.
    """

    def __init__(self, context: AdapterContext, shows_poses: bool) -> None:
        self._context, self._shows_poses = context, shows_poses
        self._given: dict[str, int] = {}
        self._services_given: dict[str, int] = {}
        self.channels: dict[int, Channel] = {}
        self.services: dict[int, Service] = {}
        self.numbers: dict[str, int] = {}
        self._told: set[str] = set()
        self.follow()

    def follow(self) -> tuple[list[int], list[int], list[int], list[int]]:
        """Look at what there is now; returns numbers of channels that came and went, and of services that came and went."""
        sensors = [port for port in self._context.ports.values() if port.direction == "sensor"]
        before, services_before = self.channels, self.services
        found = {self._number(channel): channel for channel in self._all(sensors)}
        self.channels = found
        self.numbers = {channel.topic: number for number, channel in found.items()}
        self._told = {port.path for port in sensors if port.path in self.numbers or f"/{port.path}" in self.numbers}
        self.services = {
            _given(self._services_given, path): service for path, service in self._context.services.items()
        }
        return (
            [n for n, channel in found.items() if before.get(n) != channel],
            [n for n, channel in before.items() if found.get(n) != channel],
            [n for n in self.services if n not in services_before],
            [n for n in services_before if n not in self.services],
        )

    def port_of(self, topic: str) -> str | None:
        """Path of the sensor of which a topic tells; None of others."""
        path = topic.removeprefix("/")
        return path if path in self._told else None

    def _number(self, channel: Channel) -> int:
        # One whose fields are others than before is another one for clients.
        return _given(self._given, f"{channel.topic} {channel.schema}")

    def _all(self, sensors: Iterable[Port]) -> Iterable[Channel]:
        for port in sensors:
            if not _is_packed(port):
                yield port_channel(port)
            schema = shown_as(port)
            if schema is not None:
                yield _protobuf(f"/{port.path}", schema)
        yield _protobuf(LOG, "foxglove.Log")
        if self._shows_poses:
            yield _protobuf(SCENE, "foxglove.SceneUpdate")
            yield _protobuf(FRAMES, "foxglove.FrameTransforms")
            for vehicle in self._context.world.vehicles:
                yield _protobuf(f"/{vehicle.name}/pose", "foxglove.PoseInFrame")


def _given(numbers: dict[str, int], key: str) -> int:
    return numbers.setdefault(key, len(numbers) + 1)


def _protobuf(topic: str, schema: str) -> Channel:
    return Channel(topic, "protobuf", schema, base64.b64encode(SCHEMAS[schema]).decode(), "protobuf")


def _is_packed(port: Port) -> bool:
    """Pictures go by their own channel, where there is one; as JSON they would be of no use."""
    return any(field.is_packed for field in port.fields)


def parameters_of(services: Mapping[str, Service]) -> dict[str, tuple[str, str]]:
    """Settings of sensors and actuators as parameters: name -> (path of the component, name of the setting)."""
    return {
        f"{path.removesuffix('/set')}/{argument.name}": (path.removesuffix("/set"), argument.name)
        for path, service in services.items()
        if path.endswith("/set") and f"{path.removesuffix('/set')}/get" in services
        for argument in service.arguments
    }

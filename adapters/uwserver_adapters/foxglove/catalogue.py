"""The channels and services that a server offers, with the numbers by which clients name them."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping

from uwserver.adapter import AdapterContext
from uwserver.adapter.foxglove import SCHEMAS, shown_as
from uwserver.ports import Port, Service
from uwserver_adapters.foxglove.codec import Channel, port_channel

SCENE, FRAMES, LOG = "/scene", "/tf", "/log"


class Catalogue:
    """What is offered now. Numbers stay: a topic that comes back gets its old number.

    Args:
        context: the world.
        shows_poses: offer the poses of vehicles, which are ground truth.

    Attributes:
        channels: by number.
        services: by number.
        numbers: number of each channel that is offered, by topic.
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
        """Follow the world; return the numbers of new channels, of channels that have gone, of new services, and of services that have gone."""
        sensors = [port for port in self._context.ports.values() if port.direction == "sensor"]
        before, services_before = self.channels, self.services
        # A channel with other fields than before is another channel for clients.
        found = {_given(self._given, f"{each.topic} {each.schema}"): each for each in self._all(sensors)}
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
        """Return the path of the sensor that is published on a topic; None for other topics."""
        path = topic.removeprefix("/")
        return path if path in self._told else None

    def _all(self, sensors: Iterable[Port]) -> Iterable[Channel]:
        for port in sensors:
            # Pictures have a channel of their own where they can be shown; as JSON they would be of no use.
            if not any(field.is_packed for field in port.fields):
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


def parameters_of(services: Mapping[str, Service]) -> dict[str, tuple[str, str]]:
    """Return the settings of sensors and actuators as parameters: name -> (path of the component, name of the setting)."""
    return {
        f"{above}/{argument.name}": (above, argument.name)
        for above, _, verb in (path.rpartition("/") for path in services)
        if verb == "set" and f"{above}/get" in services
        for argument in services[f"{above}/set"].arguments
    }

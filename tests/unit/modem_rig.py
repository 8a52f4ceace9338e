"""Worlds in which vehicles carry modems, and what these tell."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.ports import Call, Reply, Sample
from uwserver.ports.checks import checked_args
from uwserver.ports.crossing import Posted
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import AcousticModemConfig, ModemTable
from uwserver.world import World

SOUND_MPS = 1486.5
"""About that of the water of these worlds."""


def modem(address: int, **keys: object) -> AcousticModemConfig:
    """A good modem: 10 kbit/s over 4 km, along straight lines."""
    usual = {
        "rate_hz": 1, "bits_per_s": 1e4, "max_range_m": 4000.0, "noise_level_db": 40.0, "propagation": "straight", "turn_around_s": 0.1,
    }  # fmt: skip
    return AcousticModemConfig(address=address, **(usual | keys))  # type: ignore[arg-type]


def world_of(places: dict[str, tuple[float, float, float]], seed: int = 1, **keys: object) -> World:
    """Vehicles with modems, whose addresses count from 1 in this order."""
    modems = {name: modem(k, **keys) for k, name in enumerate(places, 1)}
    return world_with(places, modems, seed)


READ: dict[str, Resolved] = {}
"""What was read before, by what it was made of: reading takes three times as long as building."""


def world_with(places: dict[str, tuple[float, float, float]], modems: dict[str, ModemTable], seed: int = 1) -> World:
    key = repr((places, modems, seed))
    if key not in READ:
        READ[key] = resolved_with(places, modems, seed)
    return build(READ[key])


def resolved_with(places: dict[str, tuple[float, float, float]], modems: dict[str, ModemTable], seed: int) -> Resolved:
    vehicles = {
        name: VehicleEntry(model="bluerov2_heavy", position_ned_m=place, sensors={"modem": modems[name]})
        for name, place in places.items()
    }
    return load(Scenario(schema=1, seed=seed, vehicles=vehicles), adapters={})


class Heard(NamedTuple):
    """What a modem told: the vehicle, the time (s) of the arrival and of the telling, and the fields."""

    by: str
    t: float
    told: float
    event: str
    source: int | None
    destination: int | None
    data: bytes
    level: float | None
    snr: float | None
    range: float | None
    bearing: float | None
    elevation: float | None
    speed: float | None


def heard(samples: list[Sample]) -> list[Heard]:
    """Those of modems among some samples."""
    found = []
    for s in samples:
        name, _, leaf = s.port.rpartition("/")
        if leaf == "received":
            event, source, destination, data, *rest = s.value
            found.append(
                Heard(name.split("/")[0], s.t_ns / 1e9, s.t_sent_ns / 1e9, event, source, destination, data.data, *rest)
            )
    return found


def asked(world: World, service: str, **args: object) -> list[Reply]:
    """Post a call, whose replies come into this list."""
    replies: list[Reply] = []
    item = Call(service, checked_args(world.services[service], args), "test")
    world.requests.posted.append(Posted(item, replies.append))  # type: ignore[arg-type]
    return replies


def listen(world: World, seconds: float) -> list[Heard]:
    """Let time pass."""
    return heard(world.step(round(seconds * float(world.rate_hz))))


def counts(world: World, vehicle: str) -> dict[str, int]:
    """What its modem has counted, where that is not nothing."""
    found = world.call(f"{vehicle}/modem/received/get")
    return {name: n for name, n in found["counts"].items() if n}  # type: ignore[index,call-overload,union-attr]

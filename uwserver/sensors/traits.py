"""What a kind of sensor declares about itself as plain data, so that no other room has to know the kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from msgspec import UNSET, Struct, UnsetType

from uwserver.frames import Vec3
from uwserver.ports import BeamView, FanView

Sigma = tuple[float, ...]
"""1-sigma of a field, in its unit: of each axis, or one number for all components."""
BYTES_OF_BIN = 32
"""About what one bin of a row of echoes takes in memory."""


class Named(NamedTuple):
    """Something that a sensor's table names, and that has to be there.

    Attributes:
        key: path of the key below the sensor's table.
        table: "thrusters" or "sensors" of its vehicle, "vehicles" or "structures" of the scenario.
        name: of the entry in that table.
    """

    key: tuple[str | int, ...]
    table: str
    name: str


class KnownBeacon(NamedTuple):
    """An acoustic beacon that a sensor asks, as its operator knows it.

    Attributes:
        name: in the sensor's table.
        p: where it is thought to be at t = 0, m: in N, or in B of the body that carries it.
        body: the vehicle that carries it; None for a beacon in N.
        delay: between question and answer, s.
        moves: it does not stay at `p`.
    """

    name: str
    p: Vec3
    body: str | None
    delay: float
    moves: bool = False


class Traits(Struct, frozen=True):
    """What others need to know of one sensor. All of it is optional.

    Attributes:
        stages: parts of the compiled code (`uwserver.world.builds.STAGES`) that are compiled before the world is built.
        beams: single beams that a picture of the world shows, in S.
        fan: the sector that an imaging sonar looks over.
        sigmas: field -> 1-sigma of its own errors: white noise, slowly changing biases and those that are drawn once a run, summed in variance.
        picture_bytes: size of the picture or the row of echoes of one reading.
        address: with which a modem begins, where its packets tell one.
        beacons: those that it asks.
        names: what its table names elsewhere.
        needs_origin: the scenario must say where N lies on the Earth.
        needs_field: it measures the Earth's magnetic field.
        needs_sight: it sees things with their colours, and lamps.
    """

    stages: tuple[str, ...] = ()
    beams: tuple[BeamView, ...] = ()
    fan: FanView | None = None
    sigmas: Mapping[str, Sigma] = {}
    picture_bytes: int = 0
    address: int | UnsetType = UNSET
    beacons: tuple[KnownBeacon, ...] = ()
    names: tuple[Named, ...] = ()
    needs_origin: bool = False
    needs_field: bool = False
    needs_sight: bool = False

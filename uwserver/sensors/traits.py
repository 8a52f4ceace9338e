"""What a kind of sensor declares about itself. It is plain data, so that no other room has to know the kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from msgspec import UNSET, Struct, UnsetType

from uwserver.frames import Vec3
from uwserver.ports import BeamView, FanView

Sigma = tuple[float, ...]
"""1-sigma of a field, in its unit: one number for each axis, or one for all components."""
BYTES_OF_BIN = 32
"""Memory that one bin of a row of echoes takes, about."""


class Named(NamedTuple):
    """An entry of another table that a sensor's table names. It has to exist.

    Attributes:
        key: path of the key that names it, below the sensor's table.
        table: "thrusters" or "sensors" of its vehicle, "vehicles" or "structures" of the scenario.
        name: name of the entry in that table.
    """

    key: tuple[str | int, ...]
    table: str
    name: str


class KnownBeacon(NamedTuple):
    """An acoustic beacon that a sensor interrogates, as its operator knows it.

    Attributes:
        name: name in the sensor's table.
        p: assumed position at t = 0, m: in N, or in B of the body that carries it.
        body: the vehicle that carries it; None for a beacon in N.
        delay: time between question and answer, s.
        moves: whether it leaves `p`.
    """

    name: str
    p: Vec3
    body: str | None
    delay: float
    moves: bool = False


class Traits(Struct, frozen=True):
    """What other rooms need to know of one sensor. Everything is optional.

    Attributes:
        stages: stages of the compiled code (`uwserver.world.builds.STAGES`) to compile before the world is built.
        beams: single beams that viewers show, in S.
        fan: the sector that an imaging sonar covers.
        sigmas: field -> 1-sigma of its own errors: white noise, slowly changing biases, and biases drawn once a run, added in variance.
        picture_bytes: size of the picture or the row of echoes of one reading.
        address: address that a modem starts with, if its packets carry one.
        beacons: the beacons that it interrogates.
        names: entries of other tables that its table names.
        needs_origin: the scenario must give the position of N on the Earth.
        needs_field: it measures the Earth's magnetic field.
        needs_sight: it sees the colours of things, and lamps.
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

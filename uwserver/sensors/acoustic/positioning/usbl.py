"""Ultra-short baseline: range from the travel time, direction from the phases at a small array of hydrophones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Value
from uwserver.sensors.acoustic.link import ray
from uwserver.sensors.acoustic.positioning.interrogation import Answer, InterrogationTable, Interrogator
from uwserver.sensors.base import Pose, Scope
from uwserver.table import Vector3

_FLAT = 1e-6
"""An array whose height is less than this part of its width counts as flat: it cannot measure the direction across it."""


class UsblConfig(InterrogationTable, tag="usbl", kw_only=True, frozen=True):
    """An interrogator with an array of hydrophones around the origin of the sensor frame.

    A flat array (all z equal) assumes that beacons are on its +z side.

    Attributes:
        hydrophones_m: positions in the sensor frame; with less than half a wavelength between neighbours phases are unambiguous.
        misalignment_rpy_deg: true attitude of the array relative to the sensor frame that the device assumes.
    """

    message = "BeaconFix"
    hydrophones_m: Annotated[tuple[Vector3, ...], Meta(min_length=3)] = (
        (0.015, 0.0, 0.0), (0.0, 0.015, 0.0), (-0.015, 0.0, 0.0), (0.0, -0.015, 0.0),
    )  # fmt: skip
    misalignment_rpy_deg: Vector3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Raise ValueError if the array cannot measure a direction."""
        places = np.array(self.hydrophones_m)
        rank = np.linalg.matrix_rank(places - places.mean(axis=0), 1e-9)
        if rank < 2:
            raise ValueError("hydrophones_m lie on one line: an array needs two directions")
        if rank < 3 and not _is_flat(places):
            raise ValueError(
                "hydrophones_m lie in one plane, which must be level in the sensor frame: give them equal z"
            )

    def build(self, mount: Pose) -> Usbl:
        return Usbl(mount, self)


class Usbl(Interrogator):
    """Gives range and direction of one beacon a reading, in turn, and its range from each hydrophone."""

    doc = (
        "Ultra-short baseline: range and direction of one acoustic beacon at a time, in turn, and its range from each hydrophone; delivered when "
        "its answer arrives. Invalid without an answer: the beacon is too far away, too weak, hidden, or out of the water."
    )

    def __init__(self, mount: Pose, config: UsblConfig) -> None:
        self._config = config
        self._places: FloatArray = np.array(config.hydrophones_m)
        about = self._places - self._places.mean(axis=0)
        self._flat = _is_flat(self._places)
        self._inverse: FloatArray = np.linalg.pinv(about[:, :2] if self._flat else about)
        self._q_SA = (Pose() if config.ideal else Pose.from_degrees(config.misalignment_rpy_deg)).q
        self.fields = (
            Field("beacon", "1", "name of the beacon", type="str"),
            Field("range", "m", "distance at the sound speed that the device believes"),
            Field("bearing", "rad", "direction from x towards y"),
            Field("elevation", "rad", "direction from the x-y plane towards z"),
            Field("p_beacon_S", "m", "position of the beacon", "S", (3,)),
            Field("travel_time", "s", "time of the sound there and back, without the beacon's turn-around time"),
            Field("hydrophone_ranges", "m", "distance of the beacon from each hydrophone", shape=(len(self._places),)),
        )
        super().__init__(mount, config)

    def values(self, scope: Scope, answer: Answer) -> list[Value]:
        """Return range, bearing, elevation, position, travel time, and the ranges from the hydrophones."""
        to_S = conjugate(answer.q_NS)
        straight_S = rotate(to_S, tuple(b - a for a, b in zip(answer.p_NS, answer.p_BN, strict=True)))
        if self._config.ideal:
            reach, u, ranges = answer.distance, _unit(straight_S), self._distances(straight_S)
        else:
            reach, u, ranges = self._heard(scope, answer)
        bearing, elevation = math.atan2(u[1], u[0]), math.atan2(u[2], math.hypot(u[0], u[1]))
        position = straight_S if self._config.ideal else (reach * u[0], reach * u[1], reach * u[2])
        return [reach, bearing, elevation, position, answer.travel_time, tuple(ranges.tolist())]

    def _heard(self, scope: Scope, answer: Answer) -> tuple[float, Vec3, FloatArray]:
        """Return range (m), direction in S and ranges from the hydrophones (n), m, as the device computes them from times and phases."""
        p, p_NS = answer.p_BN, answer.p_NS
        c = scope.water.sound_speed(p_NS[2])
        believed = self.believed(c)
        reach = 0.5 * believed * answer.travel_time
        # The sound comes along its ray, not straight from the beacon; and the array is misaligned.
        towards_N = ray(p_NS, p, answer.path.dip_a)
        towards_A = rotate(conjugate(self._q_SA), rotate(conjugate(answer.q_NS), towards_N))
        away = math.dist(p, p_NS)
        exact = self._distances((away * towards_A[0], away * towards_A[1], away * towards_A[2]))
        # A phase has an error of 1 / sqrt(2 snr) rad, so the difference of two has 1 / sqrt(snr).
        sigma = 1.0 / (2.0 * math.pi * self._config.frequency_hz * math.sqrt(2.0 * answer.snr))
        times = (exact - away) / c + sigma * self.rng.standard_normal(len(exact))
        u = -believed * (self._inverse @ (times - times.mean()))
        direction = u.tolist()
        if self._flat:
            across = float(u @ u)
            if across >= 1.0:
                direction = (u / math.sqrt(across)).tolist()
            direction.append(math.sqrt(max(0.0, 1.0 - across)))
        return reach, _unit(direction), reach + believed * times

    def _distances(self, p_S: Vec3) -> FloatArray:
        """Return the distances (n) of the hydrophones from a point, m."""
        result: FloatArray = np.linalg.norm(np.array(p_S) - self._places, axis=1)
        return result


def _is_flat(places: FloatArray) -> bool:
    return bool(np.ptp(places[:, 2]) < _FLAT * np.ptp(places))


def _unit(v: Sequence[float]) -> Vec3:
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) or 1.0
    return (v[0] / length, v[1] / length, v[2] / length)

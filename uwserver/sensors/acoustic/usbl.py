"""Ultra-short baseline: range from the travel time, direction from the phases at a small array of hydrophones."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from msgspec import Meta

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Value
from uwserver.sensors.acoustic.interrogation import Answer, InterrogationTable, Interrogator
from uwserver.sensors.base import Pose, Scope, blank
from uwserver.table import Vector3
from uwserver.units import NANOSECONDS

_FLAT = 1e-6
"""An array this thin (ratio of singular values) knows nothing of the direction across it."""


class UsblConfig(InterrogationTable, tag="usbl", kw_only=True, frozen=True):
    """An interrogator with an array of hydrophones about the origin of the sensor frame.

    A flat array (all z equal) assumes that beacons are on its +z side.

    Attributes:
        hydrophones_m: their places in the sensor frame; less than half a wavelength between neighbours is unambiguous.
        misalignment_rpy_deg: of the array against the sensor frame that it is thought to have.
    """

    message = "BeaconFix"
    hydrophones_m: Annotated[tuple[Vector3, ...], Meta(min_length=3)] = (
        (0.015, 0.0, 0.0), (0.0, 0.015, 0.0), (-0.015, 0.0, 0.0), (0.0, -0.015, 0.0),
    )  # fmt: skip
    misalignment_rpy_deg: Vector3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """ValueError where the array cannot tell a direction."""
        places = np.array(self.hydrophones_m)
        if np.linalg.matrix_rank(places - places.mean(axis=0), 1e-9) < 2:
            raise ValueError("hydrophones_m lie on one line: an array needs two directions")
        flat = np.ptp(places[:, 2]) < _FLAT * np.ptp(places)
        if not flat and np.linalg.matrix_rank(places - places.mean(axis=0), 1e-9) < 3:
            raise ValueError(
                "hydrophones_m lie in one plane, which must be level in the sensor frame: give them equal z"
            )

    def build(self, mount: Pose) -> Usbl:
        return Usbl(mount, self)


class Usbl(Interrogator):
    """Range, bearing and elevation of one beacon a reading, in turn, and the ranges of the single hydrophones."""

    doc = (
        "Ultra-short baseline: range and direction of one acoustic beacon at a time, in turn, and its range from each hydrophone; delivered when "
        "its answer arrives. Invalid without an answer: the beacon is too far away, too weak, hidden, or out of the water."
    )

    def __init__(self, mount: Pose, config: UsblConfig) -> None:
        self._config = config
        self._places: FloatArray = np.array(config.hydrophones_m)
        about = self._places - self._places.mean(axis=0)
        self._flat = bool(np.ptp(self._places[:, 2]) < _FLAT * np.ptp(self._places))
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

    def sense(self, scope: Scope) -> Measurement | None:
        """None until the exchange under way is over."""
        over = self.exchange(scope)
        if over is None:
            return None
        answer, delay_ns, since_ns = over.answer, round(over.wait * NANOSECONDS), scope.t_ns - over.asked_ns
        if answer is None:
            return Measurement([over.name, *blank(self.fields[1:])], False, delay_ns, since_ns=since_ns)
        to_S = conjugate(answer.q_NS)
        straight_S = rotate(to_S, tuple(b - a for a, b in zip(answer.p_NS, answer.p_BN, strict=True)))
        if self._config.ideal:
            reach, u, ranges = answer.distance, _unit(straight_S), self._distances(straight_S)
        else:
            reach, u, ranges = self._heard(scope, answer)
        bearing, elevation = math.atan2(u[1], u[0]), math.atan2(u[2], math.hypot(u[0], u[1]))
        position = straight_S if self._config.ideal else (reach * u[0], reach * u[1], reach * u[2])
        heard = tuple(ranges.tolist())
        values: list[Value] = [over.name, reach, bearing, elevation, position, answer.travel_time, heard]
        return Measurement(values, True, delay_ns, since_ns=since_ns)

    def _heard(self, scope: Scope, answer: Answer) -> tuple[float, Vec3, FloatArray]:
        """Range (m), direction in S and hydrophone ranges (n, m) as the device computes them from times and phases."""
        p, p_NS = answer.p_BN, answer.p_NS
        c = scope.water.sound_speed(p_NS[2])
        believed = self.believed(c)
        reach = 0.5 * believed * answer.travel_time
        # The sound comes from where its ray does, not from where the beacon is; the array is turned against its frame.
        heading = math.atan2(p[1] - p_NS[1], p[0] - p_NS[0])
        flat, dip = math.cos(answer.path.dip_a), math.sin(answer.path.dip_a)
        towards_N = (flat * math.cos(heading), flat * math.sin(heading), dip)
        towards_A = rotate(conjugate(self._q_SA), rotate(conjugate(answer.q_NS), towards_N))
        away = math.dist(p, p_NS)
        exact = self._distances((away * towards_A[0], away * towards_A[1], away * towards_A[2]))
        # A phase has an error of 1 / sqrt(2 snr) rad, so the difference of two has 1 / sqrt(snr).
        sigma = 1.0 / (2.0 * math.pi * self._config.frequency_hz * math.sqrt(2.0 * answer.snr))
        times = (exact - away) / c + sigma * self.rng.standard_normal(len(exact))
        u = -believed * (self._inverse @ (times - times.mean()))
        if self._flat:
            across = float(u @ u)
            if across >= 1.0:
                u /= math.sqrt(across)
            direction = (float(u[0]), float(u[1]), math.sqrt(max(0.0, 1.0 - across)))
        else:
            direction = (float(u[0]), float(u[1]), float(u[2]))
        return reach, _unit(direction), reach + believed * times

    def _distances(self, p_S: Vec3) -> FloatArray:
        """(n) of the hydrophones from a point, m."""
        result: FloatArray = np.linalg.norm(np.array(p_S) - self._places, axis=1)
        return result


def _unit(v: Vec3) -> Vec3:
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) or 1.0
    return (v[0] / length, v[1] / length, v[2] / length)

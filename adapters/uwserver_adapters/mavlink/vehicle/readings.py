"""The last readings of one vehicle's instruments and its autopilot. Ground truth is never used."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct, structs

from uwserver.adapter import AdapterContext
from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver.ports import Value
from uwserver_adapters.mavlink.wire.codec import finite, turns, vec3, vector, wrapped

Reading = Mapping[str, Value]
INSTRUMENTS: Mapping[str, str] = {
    "Range": "altimeter", "Attitude": "attitude", "Estimate": "autopilot", "BatteryState": "battery", "Dvl": "dvl", "NavSatFix": "gps",
    "Imu": "imu", "Leak": "leak", "MagneticField": "magnetometer", "FluidPressure": "pressure",
}  # fmt: skip
"""Standard message of a port -> the instrument whose readings are sent to ground stations."""
_ASSUMED_NS = 2_000_000_000
"""An assumed change is dropped when the autopilot's last sample is this much older than the change, ns."""


class State(Struct, frozen=True):
    """What is known of the vehicle. None stands for unknown.

    Attributes:
        has_autopilot: there is an autopilot, and it has sent a sample.
        mode, armed, failsafe: state of the autopilot.
        p_N, v_N: estimated position (m) and velocity (m/s) in N, when valid.
        sink: vertical speed, m/s down, when the depth is known.
        q_NB, w_B: attitude and angular rates (rad/s).
        depth, altitude: below the surface and above the bottom, m.
        p_ref_N, depth_ref, heading_ref: set points.
        mission_index, mission_count, reached: state of the mission.
        outputs: the autopilot's commands to the actuators, -1 to 1.
    """

    has_autopilot: bool = False
    mode: str = "manual"
    armed: bool = False
    failsafe: str = ""
    p_N: Vec3 | None = None
    v_N: Vec3 | None = None
    sink: float = 0.0
    q_NB: Quat | None = None
    w_B: Vec3 | None = None
    depth: float | None = None
    altitude: float | None = None
    p_ref_N: Vec3 | None = None
    depth_ref: float | None = None
    heading_ref: float | None = None
    mission_index: int = -1
    mission_count: int = 0
    reached: int = 0
    outputs: tuple[float, ...] = ()

    @property
    def altitude_target(self) -> float:
        """Altitude above the bottom (m) that SURFTRAK holds; 0 in other modes."""
        if self.mode != "altitude_hold" or self.depth_ref is None or self.depth is None or self.altitude is None:
            return 0.0
        return self.altitude + self.depth - self.depth_ref


class Readings:
    """The newest samples, found by the kinds of their ports. Runs on the loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle.

    Attributes:
        t_ns: simulation time.
        turns: full turns of the heading since the start, clockwise positive.
    """

    def __init__(self, context: AdapterContext, vehicle: str) -> None:
        self._context = context
        self._vehicle = vehicle
        self.t_ns = 0
        self.turns = 0.0
        self._last_yaw: float | None = None
        self._ports: dict[str, tuple[str, tuple[str, ...]]] = {}
        self._known: tuple[int, State] = (-1, State())
        self._assumed: dict[str, str | bool] = {}
        self._assumed_ns = 0
        self.open_ports()

    def open_ports(self) -> None:
        """Find the ports again. The first port of each kind counts."""
        self._ports.clear()
        self._known = (-1, State())
        for path, port in self._context.ports.items():
            if port.direction == "sensor" and path.startswith(f"{self._vehicle}/") and not port.is_truth:
                names = tuple(field.name for field in port.fields)
                found = INSTRUMENTS.get(port.message or "", "")
                if found == "pressure" and "depth" in names:
                    found = "depth"
                if found and (found != "autopilot" or path == f"{self._vehicle}/autopilot/state"):
                    self._ports.setdefault(found, (path, names))

    @property
    def subscriptions(self) -> Collection[str] | None:
        """The ports that are read. None, which means all, without any such instrument: the telemetry needs some samples to follow the time."""
        return frozenset(path for path, _ in self._ports.values()) or None

    def has(self, kind: str) -> bool:
        """Return whether the vehicle has this instrument of `INSTRUMENTS`; `depth` is a pressure sensor that gives the depth."""
        return kind in self._ports

    def last(self, kind: str) -> Reading | None:
        """Return the fields of the newest sample; None when there is none or it is not valid."""
        known = self._ports.get(kind)
        sample = self._context.last(known[0]) if known is not None else None
        if known is None or sample is None or not sample.valid:
            return None
        return dict(zip(known[1], sample.value, strict=False))

    def number(self, kind: str, field: str) -> float | None:
        """Return a number of the newest valid sample; None when it is not finite."""
        reading = self.last(kind)
        return None if reading is None else finite(reading.get(field))

    def state(self) -> State:
        """Return everything that is known at `t_ns`."""
        if self._known[0] != self.t_ns:
            self._known = (self.t_ns, self._state())
        return self._known[1]

    def forget(self) -> None:
        """Read the samples again at the next call, even at the same time."""
        self._known = (-1, State())

    def count_turns(self) -> None:
        """Count the turns of the heading. Must be called at least twice per turn."""
        q = self.state().q_NB
        if q is None:
            return
        yaw = rpy_from_quat(q)[2]
        if self._last_yaw is not None:
            self.turns += turns(wrapped(yaw - self._last_yaw))
        self._last_yaw = yaw

    def assume(self, t_ns: int, **fields: str | bool) -> None:
        """Assume that the autopilot has changed as requested, although it has not said so yet.

        It sends its state only a few times per second, and a ground station goes on as soon as it has been told that the mode has changed.

        Args:
            t_ns: simulation time of the change. The autopilot's later samples count again.
            fields: `mode` or `armed`.
        """
        self._assumed.update(fields)
        self._assumed_ns = t_ns
        self.forget()

    def _state(self) -> State:
        state = self._said()
        if self._assumed:
            sample = self._context.last(self._ports["autopilot"][0]) if "autopilot" in self._ports else None
            if sample is None or not 0 <= self._assumed_ns - sample.t_ns < _ASSUMED_NS:
                self._assumed.clear()
            else:
                state = structs.replace(state, **self._assumed)
        return state

    def _said(self) -> State:
        said = self.last("autopilot")
        if said is None:
            return self._without_autopilot()
        altitude, depth, v_N = finite(said.get("altitude")), finite(said.get("depth")), vec3(said.get("v_N"))
        return State(
            has_autopilot=True,
            mode=str(said.get("mode")),
            armed=bool(said.get("armed")),
            failsafe=str(said.get("failsafe") or ""),
            p_N=vec3(said.get("p_N")) if said.get("position_valid") else None,
            v_N=v_N if said.get("velocity_valid") else None,
            sink=v_N[2] if v_N is not None and depth is not None else 0.0,
            q_NB=_quat(said.get("q_NB")),
            w_B=vec3(said.get("w_B")),
            depth=depth,
            altitude=self._altitude() if altitude is None else altitude,
            p_ref_N=vec3(said.get("p_ref_N")),
            depth_ref=finite(said.get("depth_ref")),
            heading_ref=finite(said.get("heading_ref")),
            mission_index=_integer(said.get("mission_index"), -1),
            mission_count=_integer(said.get("mission_count"), 0),
            reached=_integer(said.get("reached"), 0),
            outputs=_row(said.get("outputs")),
        )

    def _without_autopilot(self) -> State:
        attitude, imu = self.last("attitude") or {}, self.last("imu") or {}
        return State(
            q_NB=_quat(attitude.get("q_NS")),
            w_B=vec3(imu.get("w_S")),
            depth=self.number("depth", "depth"),
            altitude=self._altitude(),
        )

    def _altitude(self) -> float | None:
        altitude = self.number("altimeter", "range")
        return self.number("dvl", "altitude") if altitude is None else altitude


def _quat(value: object) -> Quat | None:
    row = vector(value, 4)
    if row is None or not 0.5 < sum(entry * entry for entry in row) < 2.0:
        return None
    return (row[0], row[1], row[2], row[3])


def _row(value: object) -> tuple[float, ...]:
    return (vector(value, len(value)) or ()) if isinstance(value, tuple) else ()


def _integer(value: object, default: int) -> int:
    number = finite(value)
    return default if number is None else int(number)

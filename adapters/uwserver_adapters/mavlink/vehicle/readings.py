"""What the instruments of one vehicle and its autopilot last said. Truth is never asked."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct, structs

from uwserver.adapter import AdapterContext
from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver.ports import Value
from uwserver_adapters.mavlink.wire.codec import finite, turns, vec3, vector, wrapped

Reading = Mapping[str, Value]
KINDS = frozenset({
    "altimeter", "attitude", "autopilot", "battery", "depth", "dvl", "gps", "imu", "leak", "magnetometer", "pressure",
})  # fmt: skip
"""Of which something is told to ground stations."""
_ASSUMED_NS = 2_000_000_000
"""An autopilot that says nothing for so long is not believed to have done anything."""


class State(Struct, frozen=True):
    """What is known of the vehicle; None where nothing is.

    Attributes:
        has_autopilot: there is one, and it has said something.
        mode, armed, failsafe: of the autopilot.
        p_N, v_N: estimates in N, m and m/s, when valid.
        sink: vertical speed, m/s down, when the depth is known.
        q_NB, w_B: attitude and rates (rad/s).
        depth, altitude: below the surface, above the bottom, m.
        p_ref_N, depth_ref, heading_ref: set points.
        mission_index, mission_count, reached: of the mission.
        outputs: commands of the actuators that the autopilot holds, -1 to 1.
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
        """Above the bottom, m, that SURFTRAK holds; 0 in other modes."""
        if self.mode != "altitude_hold" or self.depth_ref is None or self.depth is None or self.altitude is None:
            return 0.0
        return self.altitude + self.depth - self.depth_ref


class Readings:
    """The newest samples, found by what their ports are. Loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle.

    Attributes:
        t_ns: simulation time.
        turns: whole turns of the heading since the start, clockwise positive.
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
        """Look again at which ports there are: of each kind the first counts."""
        self._ports.clear()
        self._known = (-1, State())
        for path, port in self._context.ports.items():
            if port.direction == "sensor" and path.startswith(f"{self._vehicle}/") and not port.is_truth:
                names = tuple(field.name for field in port.fields)
                kind = "depth" if port.kind == "pressure" and "depth" in names else port.kind
                if kind in KINDS and (kind != "autopilot" or path == f"{self._vehicle}/autopilot/state"):
                    self._ports.setdefault(kind, (path, names))

    @property
    def wanted(self) -> Collection[str] | None:
        """Their ports; None, which is all, where the vehicle has no such instrument: the telemetry needs some that tell the time."""
        return frozenset(path for path, _ in self._ports.values()) or None

    def has(self, kind: str) -> bool:
        """Whether the vehicle has such an instrument: a sensor's kind, or `depth` for a pressure sensor that tells it."""
        return kind in self._ports

    def last(self, kind: str) -> Reading | None:
        """Fields of the newest sample; None when there is none or it is not valid."""
        known = self._ports.get(kind)
        sample = self._context.last(known[0]) if known is not None else None
        if known is None or sample is None or not sample.valid:
            return None
        return dict(zip(known[1], sample.value, strict=False))

    def number(self, kind: str, field: str) -> float | None:
        """A finite number of the newest valid sample."""
        reading = self.last(kind)
        return None if reading is None else finite(reading.get(field))

    def state(self) -> State:
        """Everything together, at `t_ns`."""
        if self._known[0] != self.t_ns:
            self._known = (self.t_ns, self._state())
        return self._known[1]

    def forget(self) -> None:
        """Samples are new although the time is not."""
        self._known = (-1, State())

    def count_turns(self) -> None:
        """Look at the heading; to be called at least twice a turn."""
        q = self.state().q_NB
        if q is None:
            return
        yaw = rpy_from_quat(q)[2]
        if self._last_yaw is not None:
            self.turns += turns(wrapped(yaw - self._last_yaw))
        self._last_yaw = yaw

    def assume(self, t_ns: int, **fields: str | bool) -> None:
        """The autopilot has done what it was asked, and has not said so yet: it speaks some times a second only, and who was told that the mode
        is another goes on at once.

        Args:
            t_ns: simulation time of the change; what it says of later times counts again.
            fields: `mode`, `armed`.
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
            mission_index=_whole(said.get("mission_index"), -1),
            mission_count=_whole(said.get("mission_count"), 0),
            reached=_whole(said.get("reached"), 0),
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


def _whole(value: object, default: int) -> int:
    number = finite(value)
    return default if number is None else int(number)

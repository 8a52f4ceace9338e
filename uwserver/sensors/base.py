"""What a sensor is: it reads the world at one instant. Ideal ones are pure functions, whose errors come from modifiers; others have errors,
settings and timing of their own, as the physics of their errors needs what no value still shows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta, Struct, structs

from uwserver.environment.earth import Earth, turns_of_level
from uwserver.environment.materials import Sediment, lambert, sediments
from uwserver.environment.water import Water
from uwserver.frames import IDENTITY, Quat, Vec3, conjugate, multiply, quat_from_rpy, rotate, spin
from uwserver.modifiers import Measurement, ModifierConfig
from uwserver.modifiers.base import NOTHING, Draws, Memory, check_lengths
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.ports import Argument, Field, Json, Refused, Value
from uwserver.sensors.job import finished
from uwserver.sensors.latest import Latest
from uwserver.sensors.place import Joint, Outline, Place, Standing
from uwserver.sensors.sight import Sight
from uwserver.sensors.traits import Named as Named
from uwserver.sensors.traits import Traits as Traits
from uwserver.sensors.wiring import Wiring
from uwserver.sensors.writing import Writing
from uwserver.table import Name, NonNegative, Positive, Table
from uwserver.units import NANOSECONDS, rad


class StreamTable(Table, kw_only=True, frozen=True):
    """One more stream of a sensor, at ``<vehicle>/<sensor>/<stream>``: the same measurements, with their numbers and times, and errors of its own.

    Attributes:
        ideal: what the device would have read without errors of its own, at the same instants and settings.
        modifiers: errors of this stream alone; those of the sensor's table are not in it.
    """

    ideal: bool = False
    modifiers: dict[str, ModifierConfig] = msgspec.field(default_factory=dict)


class SensorTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """What the table of any sensor may hold; each has ``build(mount) -> Sensor``.

    Attributes:
        rate_hz: samples a second; divides the physics rate.
        profile: a shipped device file (``a50``) or the path of one; its values stand where this table gives none.
        mount: a mount of the vehicle file; or `position_frd_m` and `rpy_deg` of the sensor on the vehicle.
        latency_s: from the measurement to its delivery; 0 where neither the table nor its device says anything.
        enabled: False takes the sensor out.
        modifiers: errors, applied in the order of the file; each name is part of its random stream.
        streams: the same measurements once more, with other errors or none.

    A kind may also set:
        message: plain name of the standard message that its fields fit ("Imu", "Range"), which belongs to no middleware; "" for none.
        example: values of the keys that it needs and no device file has, to try a device file with.
    """

    message: ClassVar[str] = ""
    example: ClassVar[Mapping[str, Any]] = {}
    rate_hz: Positive
    profile: Name | msgspec.UnsetType = msgspec.UNSET
    mount: Name | msgspec.UnsetType = msgspec.UNSET
    position_frd_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latency_s: NonNegative | msgspec.UnsetType = msgspec.UNSET
    enabled: bool = True
    modifiers: dict[str, ModifierConfig] = msgspec.field(default_factory=dict)
    streams: dict[str, StreamTable] = msgspec.field(default_factory=dict)

    def port_of(self, vehicle: str, name: str) -> str:
        """Path of the port of a sensor that has this table under a name, on a vehicle."""
        return f"{vehicle}/{name}"

    def traits(self) -> Traits:
        """What others need to know of a sensor with this table."""
        return Traits()

    def companions(self, mount: Pose) -> Mapping[str, tuple[SensorTable, Pose]]:
        """Further sensors that come with one on this mount: table and mount of each, by the name below its own."""
        return {}


@dataclass(frozen=True, slots=True)
class Pose:
    """A place and an attitude; X_BS: where a sensor sits on its vehicle, p_BS (m, B) and q_BS."""

    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = IDENTITY

    @classmethod
    def from_degrees(cls, rpy_deg: Vec3, p: Vec3 = (0.0, 0.0, 0.0)) -> Pose:
        """Of roll, pitch and yaw (deg), as tables have them."""
        roll, pitch, yaw = (rad(angle) for angle in rpy_deg)
        return cls(p, quat_from_rpy(roll, pitch, yaw))


_OPEN_WATER = OpenWater()
_EARTH = Earth()
SEDIMENT = lambert(["sediment"])
"""Backscatter where nobody names materials."""
BOTTOM = sediments(["sediment"])
"""What reflects sound there."""


@dataclass(slots=True)
class Scope:
    """Read-only view of one body at the instant of a tick. SI; frames N and B as named.

    Attributes:
        t_ns: simulation time.
        p_NB, q_NB: pose.
        v_NB_B, w_NB_B: velocity.
        nu_dot: derivative of (v, w) in B; zeros unless a due sensor `needs_rates`.
        tau: applied force and moment about the origin in B; likewise.
        water: the environment.
        geometry: solid things, for rays.
        vehicles: all of the world, by name.
        earth: where N lies.
        wiring: thrusters and hull of this vehicle; None where a sensor stands alone.
        lambert: (n) backscatter of the solids' materials by their number, Lambert's parameter, linear.
        sediments: the same materials as a bottom that reflects sound.
        sight: what cameras may see; None where nobody says.
        row: of this body in the state of all; -1 for none.
    """

    t_ns: int
    p_NB: Vec3
    q_NB: Quat
    v_NB_B: Vec3
    w_NB_B: Vec3
    water: Water
    nu_dot: tuple[float, ...] = field(default=(0.0,) * 6)
    tau: tuple[float, ...] = field(default=(0.0,) * 6)
    geometry: Geometry = field(default=_OPEN_WATER)
    vehicles: Mapping[str, Place] = field(default_factory=dict)
    earth: Earth = field(default=_EARTH)
    wiring: Wiring | None = None
    lambert: FloatArray = field(default_factory=lambda: SEDIMENT, compare=False)
    sediments: tuple[Sediment, ...] = BOTTOM
    sight: Sight | None = None
    row: int = -1

    @property
    def t(self) -> float:
        """Simulation time, s."""
        return self.t_ns / NANOSECONDS

    def still(self, *, with_vehicles: bool = True) -> Scope:
        """This instant for a job: solids and vehicles stay where they are, though the world goes on. Without wiring, and with the same water: a job
        may ask it for what time does not change, as sound speed and waves (whose time is given), not for the current. `vehicles` by name cost some
        microseconds each; solids are there anyway."""
        still = getattr(self.geometry, "still", None)
        geometry = self.geometry if still is None else still()
        places = self.vehicles.items() if with_vehicles else ()
        vehicles = {name: Standing(place.p_NB, place.q_NB, place.nu) for name, place in places}
        return replace(self, geometry=geometry, vehicles=vehicles, wiring=None)

    def without_own_body(self) -> Scope:
        """The same without the solids of this body, as who looks out of it sees it."""
        without = getattr(self.geometry, "without", None)
        return self if without is None or self.row < 0 else replace(self, geometry=without(self.row))

    def position(self, p_BS: Vec3) -> Vec3:
        """p_NS (m) of a point fixed to the body at p_BS."""
        dx, dy, dz = rotate(self.q_NB, p_BS)
        x, y, z = self.p_NB
        return (x + dx, y + dy, z + dz)

    def submergence(self, p: Vec3) -> float:
        """How far a point of N is below the sea surface above it, m; negative in the air."""
        return p[2] + self.water.elevation(p[0], p[1], self.t)

    def attitude(self, q_BS: Quat) -> Quat:
        """q_NS of a frame fixed to the body."""
        return multiply(self.q_NB, q_BS)

    def velocity_of(self, p_BS: Vec3) -> Vec3:
        """Velocity of a point fixed to the body at p_BS, m/s in B."""
        (vx, vy, vz), (wx, wy, wz), (rx, ry, rz) = self.v_NB_B, self.w_NB_B, p_BS
        return (vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx)

    def level_turns(self) -> tuple[Vec3, Vec3]:
        """omega_ie and omega_el: how the level axes at the body turn as the Earth turns, and as it moves over the Earth; rad/s in B."""
        v = rotate(self.q_NB, self.v_NB_B)
        with_earth, transport = turns_of_level(self.earth.rate, self.earth.curvature, self.p_NB, v)
        to_B = conjugate(self.q_NB)
        return rotate(to_B, with_earth), rotate(to_B, transport)

    def specific_force(self, mount: Pose) -> Vec3:
        """What an ideal accelerometer at the mount feels, f_S (m/s2): acceleration of the mount minus gravity, in S.

        a = v_dot + w x v + w_dot x r + w x (w x r), all in B, from the equations of motion (not from differenced velocity); on a rotating
        Earth also (2 omega_ie + omega_el) x v.
        """
        wx, wy, wz = self.w_NB_B
        ax, ay, az, bx, by, bz = self.nu_dot
        (rx, ry, rz), (ux, uy, uz) = mount.p, self.velocity_of(mount.p)
        a_B = (
            ax + by * rz - bz * ry + wy * uz - wz * uy,
            ay + bz * rx - bx * rz + wz * ux - wx * uz,
            az + bx * ry - by * rx + wx * uy - wy * ux,
        )
        if self.earth.rotating:
            (ex, ey, ez), (tx, ty, tz) = self.level_turns()
            tx, ty, tz = tx + 2.0 * ex, ty + 2.0 * ey, tz + 2.0 * ez
            x, y, z = a_B
            a_B = (x + ty * uz - tz * uy, y + tz * ux - tx * uz, z + tx * uy - ty * ux)
        g = rotate(conjugate(self.q_NB), (0.0, 0.0, self.water.gravity_at(self.p_NB[2])))
        return rotate(conjugate(mount.q), (a_B[0] - g[0], a_B[1] - g[1], a_B[2] - g[2]))


def earlier(p: Vec3, q: Quat, nu: Sequence[float], ago: float) -> tuple[Vec3, Quat]:
    """Where something was a little while ago (s, about a tick): p (m, N), attitude q and velocity nu in B, taken as constant in N and B."""
    vx, vy, vz = rotate(q, (nu[0], nu[1], nu[2]))
    return (p[0] - vx * ago, p[1] - vy * ago, p[2] - vz * ago), multiply(q, spin(nu[3:6], -ago))


class Settings(Struct, frozen=True):
    """What can be changed of a sensor while it runs. SI; the names of its fields are the service's arguments.

    The limits of the types are those within which any value is harmless; the arguments' may be narrower.
    """


Gain = Annotated[float, Meta(ge=-1000, le=1000)]
"""dB, as a setting."""
Distance = Annotated[float, Meta(ge=1e-3, le=1e7)]
"""m, as a setting."""
SoundSpeed = Annotated[float, Meta(ge=0, le=1e5)]
"""m/s, as a setting: what the device believes; 0 stands for the truth."""


class Sensor(ABC):
    """What lives in a vehicle and reads. The next reading depends on the world, `settings`, `memory` and random stream, and on nothing else.

    These three are saved with the world. Subclasses set `fields`, `doc` and, where there are settings, `arguments`.

    Attributes:
        fields: what a reading holds, in order.
        doc: one or two sentences for the port.
        needs_rates: whether `Scope.nu_dot` and `Scope.tau` must be filled in.
        settings: changed by `change` alone.
        arguments: of the service ``set``, beside `rate_hz`: one for each setting, with its limits.
        memory: what it keeps from reading to reading.
        rng: random numbers of its own path, which stand at those of the present reading; from `start` on.
        joint: what tilts its mount; None where nothing does.
        outlines: boxes around the structures that its table names, by name.
        dt: time between readings, s.
        paces: its memory holds no error, but what decides when and how it reads next; an ideal twin follows it.
        listens: it waits for something that comes between two readings, as told by `wake`.
        rouses: the same, but it says so by `rouse`, set where it lives, when `wake` has become a time, so that nobody asks before.
        repeats, repeated: it reads after others, as it repeats what they have read; these, if its numbers are the age (s) of the oldest and theirs.
        takes_time: its readings are begun and computed later (`uwserver.sensors.job`).
        learns: `learn` hears what was computed.
        supplies: it decides with which voltage the thrusters run.
        writes: it has no errors, timing and memory of its own, and sees nothing of the world: `write` is its short way.
        writing: how compiled code can write in its place, until others come or go; None where it cannot.
    """

    fields: tuple[Field, ...]
    doc: str
    needs_rates = False
    settings: Settings = Settings()
    arguments: tuple[Argument, ...] = ()
    memory: Memory = NOTHING
    rng: np.random.Generator
    joint: Joint | None = None
    outlines: Mapping[str, Outline] = MappingProxyType({})
    dt = 1.0
    paces = listens = rouses = False
    rouse: Callable[[], None] = staticmethod(lambda: None)
    repeats = takes_time = learns = writes = supplies = False
    repeated: Sequence[Latest] = ()
    writing: Writing | None = None

    @property
    def needs(self) -> Collection[str]:
        """Names of sensors of its vehicle without which it does not measure as it should."""
        return ()

    def __init__(self, settings: Settings | None = None) -> None:
        """Switched on with random numbers of no path, for one who reads it alone."""
        if settings is not None:
            self.settings = settings
        self.start(0)

    def start(self, key: int) -> None:
        """Switch it on: with the random numbers of this key, of which it draws what is constant in a run."""
        self.draws = Draws(key)
        self.rng = self.draws.rng
        self.memory = self.turn_on()

    def turn_on(self) -> Memory:
        """The memory at the start of a run."""
        return NOTHING

    def begin(self, number: int) -> None:
        """The next reading has this number: its random numbers follow."""
        self.draws.seek(number)

    def join(self, others: Mapping[str, Latest]) -> None:  # noqa: B027 - only who repeats or hears others needs them
        """Get to know the other sensors of the vehicle, by name; before anything is read."""

    def wire(self, wiring: Wiring) -> None:  # noqa: B027 - only who tells of single thrusters needs it
        """Get to know the inside of the vehicle; before anything is read."""

    def load_kernels(self) -> None:  # noqa: B027 - most have none
        """Load what is compiled for the readings now, so that no tick waits for it."""

    @abstractmethod
    def sense(self, scope: Scope) -> Measurement | None:
        """The next reading, with the delay of sound and processing; None when the sensor is not ready for one."""

    def write(self, row: FloatArray) -> tuple[Value, ...]:
        """Of one that writes: the numbers of a valid reading of this instant into a row (`modifiers.columns`); returns the values that are none."""
        raise NotImplementedError

    @property
    def wake(self) -> float | None:
        """When (s) it has to be asked, whatever its rate: at the first tick that is not earlier; None while it waits for nothing."""
        return None

    def begins(self, t: float) -> bool:
        """Of one that takes time: whether a reading would begin, were it asked at this time (s)."""
        return True

    def learn(self, values: tuple[Value, ...]) -> None:  # noqa: B027 - few do
        """Of one that takes time and learns: a job's values are delivered in this tick. They may change the memory; must be quick."""

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Whether it could measure, and one value per field, without timing; missing values while it is not ready."""
        reading = self.sense(scope)
        if reading is None:
            return False, blank(self.fields)
        return reading.valid, finished(reading, self.fields).values

    def properties(self) -> dict[str, Json]:
        """The settings, by name."""
        return structs.asdict(self.settings)

    def change(self, args: Mapping[str, Json]) -> None:
        """Change settings; all or none.

        Raises:
            Refused: the settings do not go together.
        """
        settings = structs.replace(self.settings, **args)
        self.check(settings)
        self.settings = settings

    def check(self, settings: Settings) -> None:  # noqa: B027 - most have nothing to check
        """Raise Refused where single limits do not say it all."""

    def valid(self, record: Memory | Settings) -> None:
        """Raise ValueError where a record of another run, though of the right types, cannot be the memory or the settings of this sensor."""
        if isinstance(record, Memory):
            check_lengths(record, self.memory)
            return
        try:
            self.check(record)
        except Refused as refused:
            raise ValueError(str(refused)) from None


class IdealSensor(Sensor):
    """A sensor without errors, timing and memory of its own, a pure function of the world at one instant: subclasses write `measure` alone."""

    @abstractmethod
    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Whether it could measure, and one value per field."""

    def sense(self, scope: Scope) -> Measurement:
        """What it measures, at once."""
        valid, values = self.measure(scope)
        return Measurement(values, valid)


def blank(fields: tuple[Field, ...]) -> list[Value]:
    """Values of a reading that found nothing."""
    return [(None,) * field.size if field.shape else None for field in fields]


def out_of_range(name: str, text: str) -> Refused:
    """The refusal of a setting."""
    return Refused("out_of_range", text, name)

"""The contract of a sensor: it reads the world at one instant (`Scope`).

The table of a kind declares, as plain data (`Traits`), what other rooms need to know, so that none of them has to know the kind. What a sensor may
see of vehicles, other sensors, structures and lights is there as protocols and rows (`Place`, `Joint`, `Outline`, `Latest`, `Sight`).

An ideal sensor is a pure function of the world, and its errors come from modifiers. Other sensors have errors, settings and timing of their own,
because the physics of these errors needs quantities that the reading no longer contains.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, structs

from uwserver.environment.acoustics.boundaries import Sediment, lambert, sediments
from uwserver.environment.earth import Earth, turns_of_level
from uwserver.environment.light import Daylight, WaterLight
from uwserver.environment.water import Water
from uwserver.frames import IDENTITY, Quat, Vec3, conjugate, multiply, quat_from_rpy, rotate, spin
from uwserver.modifiers import Measurement, ModifierConfig
from uwserver.modifiers.base import NOTHING, Draws, Memory, check_lengths
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.ports import Argument, BeamView, FanView, Field, Json, Refused, Value
from uwserver.sensors.job import finished
from uwserver.sensors.wiring import Wiring
from uwserver.table import Name, NonNegative, Positive, Table
from uwserver.units import NANOSECONDS, rad

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


class Place(Protocol):
    """Where another vehicle is."""

    @property
    def p_NB(self) -> Vec3:
        """Position of its origin in N, m."""

    @property
    def q_NB(self) -> Quat:
        """Its attitude."""

    @property
    def nu(self) -> tuple[float, ...]:
        """Its velocity, v_NB_B (m/s) and w_NB_B (rad/s)."""


class FixedPlace(NamedTuple):
    """A `Place` at one instant."""

    p_NB: Vec3
    q_NB: Quat
    nu: tuple[float, ...]


class Joint(Protocol):
    """The actuator that tilts a mount."""

    @property
    def rate(self) -> float:
        """Largest rate of the tilt, rad/s."""

    @property
    def memory(self) -> Any:
        """The state of the actuator; its `tilt` (rad) is the last command."""


class Outline(NamedTuple):
    """The box around a structure.

    Attributes:
        p: centre of the box, m in N.
        q: attitude of the box in N.
        half: half the length of each edge, m.
    """

    p: Vec3
    q: Quat
    half: Vec3


class Latest(Protocol):
    """Another sensor of the same vehicle, for a sensor that repeats its readings or hears its sound."""

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of its port."""

    @property
    def held(self) -> tuple[bool, tuple[Value, ...]] | None:
        """Validity and values of its last reading, errors included; None before the first one."""

    @property
    def held_ns(self) -> int:
        """Time of that reading."""

    @property
    def stream_numbers(self) -> range:
        """Numbers of its streams in the world; its own stream is the first."""

    @property
    def sensor(self) -> object:
        """The sensor itself."""

    @property
    def works(self) -> bool:
        """Whether it reads: it is switched on, and no fault keeps it silent."""


class Writing(NamedTuple):
    """How compiled code writes the readings of a sensor, as it does for autopilots (`autopilot.entries.tell_one`).

    Attributes:
        row: number of the sensor there.
        texts: the values that are no numbers, by the state that the sensor reports.
    """

    row: int
    texts: Sequence[tuple[Value, ...]]


class Sight(NamedTuple):
    """What cameras may see of a world. Pictures are made elsewhere, and only if somebody reads them.

    Attributes:
        water, day: light.
        scene: returns the `uwserver.sensors.optical.camera.visible.VisibleScene` of everything that is there now.
        lamps: returns all lamps that shine now, each as a `uwserver.sensors.optical.camera.lamps.LampAt`.
        state: returns the present state (n, 13) of all bodies.
    """

    water: WaterLight
    day: Daylight
    scene: Callable[[], Any]
    lamps: Callable[[], tuple[Any, ...]]
    state: Callable[[], FloatArray]


class StreamTable(Table, kw_only=True, frozen=True):
    """A further stream of a sensor, at ``<vehicle>/<sensor>/<stream>``: the same measurements, numbers and times, with errors of its own.

    Attributes:
        ideal: the stream has what the device would read without errors of its own, at the same instants and with the same settings.
        modifiers: errors of this stream only. The modifiers of the sensor's table do not apply to it.
    """

    ideal: bool = False
    modifiers: dict[str, ModifierConfig] = msgspec.field(default_factory=dict)


class SensorTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """The keys that the table of every sensor has. Each kind also has ``build(mount) -> Sensor``.

    Attributes:
        rate_hz: samples a second. The physics rate must be a multiple of it.
        profile: name of a shipped device file (``a50``), or the path of a device file. Its values are the defaults of this table.
        mount: name of a mount of the vehicle file. Without it, `position_frd_m` and `rpy_deg` give the pose of the sensor on the vehicle.
        latency_s: time from the measurement to its delivery; 0 if neither the table nor its device file gives it.
        enabled: False removes the sensor.
        modifiers: errors, applied in the order of the file. The name of each is part of the path of its random stream.
        streams: further streams of the same measurements, with other errors or without errors.

    A kind may also set:
        message: plain name of the standard message that its fields fit ("Imu", "Range"). It belongs to no middleware. "" means none.
        example: values of required keys that no device file gives. They are used to try out a device file.
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
        """Return the path of the port of this sensor, which has the name `name` on a vehicle."""
        return f"{vehicle}/{name}"

    def traits(self) -> Traits:
        """Return what other rooms need to know of a sensor with this table."""
        return Traits()

    def companions(self, mount: Pose) -> Mapping[str, tuple[SensorTable, Pose]]:
        """Return further sensors that this one brings along: table and mount of each, by its name below the name of this sensor."""
        return {}


@dataclass(frozen=True, slots=True)
class Pose:
    """A position and an attitude. As X_BS, the pose of a sensor on its vehicle: p_BS (m, B) and q_BS."""

    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = IDENTITY

    @classmethod
    def from_degrees(cls, rpy_deg: Vec3, p: Vec3 = (0.0, 0.0, 0.0)) -> Pose:
        """Return the pose with this roll, pitch and yaw (deg), as tables give them."""
        roll, pitch, yaw = (rad(angle) for angle in rpy_deg)
        return cls(p, quat_from_rpy(roll, pitch, yaw))


_OPEN_WATER = OpenWater()
_EARTH = Earth()
SEDIMENT = lambert(["sediment"])
"""Backscatter of a world whose materials are not given."""
BOTTOM = sediments(["sediment"])
"""Sediments of such a world, which reflect sound."""


@dataclass(slots=True)
class Scope:
    """A read-only view of the world from one body, at the instant of a tick. SI units; the frames are N and B, as named.

    Attributes:
        t_ns: simulation time.
        p_NB, q_NB: pose.
        v_NB_B, w_NB_B: velocity.
        nu_dot: derivative of (v, w) in B; zeros unless a sensor that is due has `needs_rates`.
        tau: applied force and moment about the origin in B; likewise zeros.
        water: the environment.
        geometry: the solid things, for casting rays.
        vehicles: all vehicles of the world, by name.
        earth: where on the Earth N lies.
        wiring: thrusters and hull contacts of this vehicle; None if the sensor is used alone.
        lambert: (n) backscatter of the materials of solids, by number: Lambert's parameter, linear.
        sediments: the same materials, as a bottom that reflects sound.
        sight: what cameras may see; None if that is not known.
        row: row of this body in the state of all bodies; -1 for none.
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
        """Return a copy of this instant for a job: solids and vehicles stay where they are while the world goes on.

        The copy has no wiring. It shares the water: a job may ask the water for what does not change with time, such as the sound speed, and for
        waves, whose time is given. It must not ask for the current. Copying `vehicles` costs some microseconds each; solids cost nothing.
        """
        still = getattr(self.geometry, "still", None)
        geometry = self.geometry if still is None else still()
        places = self.vehicles.items() if with_vehicles else ()
        vehicles = {name: FixedPlace(place.p_NB, place.q_NB, place.nu) for name, place in places}
        return replace(self, geometry=geometry, vehicles=vehicles, wiring=None)

    def without_own_body(self) -> Scope:
        """Return the view without the solids of this body, which a sensor inside the body does not see."""
        without = getattr(self.geometry, "without", None)
        return self if without is None or self.row < 0 else replace(self, geometry=without(self.row))

    def position(self, p_BS: Vec3) -> Vec3:
        """Return p_NS (m) of a point fixed to the body at p_BS."""
        dx, dy, dz = rotate(self.q_NB, p_BS)
        x, y, z = self.p_NB
        return (x + dx, y + dy, z + dz)

    def submergence(self, p: Vec3) -> float:
        """Return how far a point of N is below the sea surface, m; negative in air."""
        return p[2] + self.water.elevation(p[0], p[1], self.t)

    def attitude(self, q_BS: Quat) -> Quat:
        """Return q_NS of a frame fixed to the body."""
        return multiply(self.q_NB, q_BS)

    def velocity_of(self, p_BS: Vec3) -> Vec3:
        """Return the velocity of a point fixed to the body at p_BS, m/s in B."""
        (vx, vy, vz), (wx, wy, wz), (rx, ry, rz) = self.v_NB_B, self.w_NB_B, p_BS
        return (vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx)

    def level_turns(self) -> tuple[Vec3, Vec3]:
        """Return omega_ie and omega_el (rad/s in B): the rate of the Earth, and the rate at which the level axes turn as the body moves over it."""
        v = rotate(self.q_NB, self.v_NB_B)
        with_earth, transport = turns_of_level(self.earth.rate, self.earth.curvature, self.p_NB, v)
        to_B = conjugate(self.q_NB)
        return rotate(to_B, with_earth), rotate(to_B, transport)

    def specific_force(self, mount: Pose) -> Vec3:
        """Return what an ideal accelerometer at the mount measures, f_S (m/s2): acceleration of the mount minus gravity, in S.

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
    """Return the pose of something `ago` s earlier (about a tick) from p (m, N), q, and nu in B. Its v is constant in N, and w in B."""
    vx, vy, vz = rotate(q, (nu[0], nu[1], nu[2]))
    return (p[0] - vx * ago, p[1] - vy * ago, p[2] - vz * ago), multiply(q, spin(nu[3:6], -ago))


class Settings(Struct, frozen=True):
    """The settings of a sensor that can change while it runs. SI units; the names of the fields are the arguments of the service.

    Any value within the limits of the types does no harm. The limits of the arguments may be narrower.
    """


Gain = Annotated[float, Meta(ge=-1000, le=1000)]
"""dB, as a setting."""
Distance = Annotated[float, Meta(ge=1e-3, le=1e7)]
"""m, as a setting."""
SoundSpeed = Annotated[float, Meta(ge=0, le=1e5)]
"""m/s, as a setting: the sound speed that the device assumes. 0 means the true one."""


class Sensor(ABC):
    """A sensor of a vehicle. Its next reading depends on the world, `settings`, `memory` and its random stream, and on nothing else.

    These three are saved with the world. Subclasses set `fields`, `doc` and, if they have settings, `arguments`.

    Attributes:
        fields: the values of a reading, in order.
        doc: one or two sentences for the port.
        needs_rates: `Scope.nu_dot` and `Scope.tau` must be filled in.
        settings: only `change` changes them.
        arguments: arguments of the service ``set`` besides `rate_hz`: one for each setting, with its limits.
        memory: state that it keeps from reading to reading.
        rng: random numbers of its own path, positioned at the present reading. It exists after `start`.
        joint: the actuator that tilts its mount; None if the mount is fixed.
        outlines: the boxes around the structures that its table names, by name.
        dt: time between readings, s.
        paces: its memory holds no errors, only what decides when and how it reads next. Its ideal twin takes over this memory.
        listens: it waits for something that comes between two readings; `wake` says when.
        rouses: likewise, but it calls `rouse`, which the world sets, when `wake` becomes a time. So the world need not ask it in every tick.
        repeats, repeated: it repeats the readings of others, so it reads after them; the others, if its numbers are the oldest age (s) and theirs.
        takes_time: it only begins its readings; they are computed later (`uwserver.sensors.job`).
        learns: `learn` gets what was computed.
        supplies: it sets the supply voltage of the thrusters.
        writes: it has no errors, timing and memory of its own and reads nothing of the world, so `write` can replace `sense`.
        writing: how compiled code can write in its place, until sensors are added or removed; None if it cannot.
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
        """Names of the sensors of its vehicle that it depends on."""
        return ()

    def __init__(self, settings: Settings | None = None) -> None:
        """Switch it on with random numbers that belong to no path. A world calls `start` again."""
        if settings is not None:
            self.settings = settings
        self.start(0)

    def start(self, key: int) -> None:
        """Switch it on with the random numbers of this key. What is constant during a run is drawn here."""
        self.draws = Draws(key)
        self.rng = self.draws.rng
        self.memory = self.turn_on()

    def turn_on(self) -> Memory:
        """Return the memory at the start of a run."""
        return NOTHING

    def begin(self, number: int) -> None:
        """Give the next reading this number, and so its random numbers."""
        self.draws.seek(number)

    def join(self, others: Mapping[str, Latest]) -> None:  # noqa: B027 - few kinds need them
        """Receive the other sensors of the vehicle, by name. Called before the first reading."""

    def wire(self, wiring: Wiring) -> None:  # noqa: B027 - few kinds need it
        """Receive the wiring of the vehicle. Called before the first reading."""

    def load_kernels(self) -> None:  # noqa: B027 - most have none
        """Load the compiled code of its readings now, so that no tick waits for it."""

    @abstractmethod
    def sense(self, scope: Scope) -> Measurement | None:
        """Return the next reading, with the delay of sound and processing; None if the sensor is not ready for one."""

    def write(self, row: FloatArray) -> tuple[Value, ...]:
        """Write the numbers of a valid reading into a row (`modifiers.columns`), and return the other values. Only if `writes` is set."""
        raise NotImplementedError

    @property
    def wake(self) -> float | None:
        """Time (s) from which on it has to read at the next tick, whatever its rate; None while it waits for nothing."""
        return None

    def begins(self, t: float) -> bool:
        """Return whether a reading would begin at this time (s). Only for a sensor that `takes_time`."""
        return True

    def learn(self, values: tuple[Value, ...]) -> None:  # noqa: B027 - few do
        """Take in the values of a job, which are delivered in this tick. They may change the memory. The call must be quick."""

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Return whether it could measure, and one value per field, without timing. Values are missing while it is not ready."""
        reading = self.sense(scope)
        if reading is None:
            return False, blank(self.fields)
        return reading.valid, finished(reading, self.fields).values

    def properties(self) -> dict[str, Json]:
        """Return the settings, by name."""
        return structs.asdict(self.settings)

    def change(self, args: Mapping[str, Json]) -> None:
        """Change settings: all of them, or none.

        Raises:
            Refused: the settings do not go together.
        """
        settings = structs.replace(self.settings, **args)
        self.check(settings)
        self.settings = settings

    def check(self, settings: Settings) -> None:  # noqa: B027 - most have nothing to check
        """Raise Refused if settings do not go together, though each is within its limits."""

    def valid(self, record: Memory | Settings) -> None:
        """Raise ValueError if a record of the right type cannot be the memory or the settings of this sensor. It comes from another run."""
        if isinstance(record, Memory):
            check_lengths(record, self.memory)
            return
        try:
            self.check(record)
        except Refused as refused:
            raise ValueError(str(refused)) from None


class IdealSensor(Sensor):
    """A sensor without errors, timing and memory of its own: a pure function of the world. Subclasses write only `measure`."""

    @abstractmethod
    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Return whether it could measure, and one value per field."""

    def sense(self, scope: Scope) -> Measurement:
        """Return what it measures, without delay."""
        valid, values = self.measure(scope)
        return Measurement(values, valid)


def blank(fields: tuple[Field, ...]) -> list[Value]:
    """Return the values of a reading that found nothing."""
    return [(None,) * field.size if field.shape else None for field in fields]


def out_of_range(name: str, text: str) -> Refused:
    """Return the error that refuses a setting."""
    return Refused("out_of_range", text, name)

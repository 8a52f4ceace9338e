"""What modems of every kind share: their table, what they remember, and the messages that they tell.

Which of a packet's signals reaches whom, and when, is worked out by the medium (`uwserver.world.modems.medium`); a kind of modem says how its
signals get across, and how well they are understood.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, NamedTuple

from msgspec import UNSET, Meta, Struct, UnsetType, structs

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.modifiers.base import Measurement, Memory, Number
from uwserver.ports import Argument, Buffer, Field, Json, Value
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings, Traits
from uwserver.sensors.messages import HIGHEST_ADDRESS, MOST_BYTES, MOST_INBOX, MOST_QUEUE, Message, ModemMemory
from uwserver.table import Name, NonNegative
from uwserver.units import NANOSECONDS, rad

_Path = Annotated[str, Meta(max_length=4096)]
_Address = Annotated[int, Meta(ge=0, le=HIGHEST_ADDRESS)]


class ModemTable(SensorTable, kw_only=True, frozen=True):
    """What every modem has. It takes messages at ``<vehicle>/<modem>/send``, and tells at ``<vehicle>/<modem>/received`` what it hears.

    Messages are told when they come, whatever `rate_hz`.

    Attributes:
        ideal: everything that gets across is understood: no noise, no collisions, and it hears while it sends.
        address: of this modem; a device setting.
        addressed: packets carry addresses; without them each is for all, and as source the address for all is told.
        broadcast_address: messages to it are for all.
        highest_address: of any modem of this make.
        protocol: modems understand each other that speak the same one.
        bits_per_s: of the payload, net of coding.
        overhead_s: length of a packet besides its payload: preamble, header, guard time.
        fixed_bytes: each packet is as long as this many bytes at least, as of a device with frames of one length; 0 for none.
        max_bytes: longest payload.
        queue: messages that wait while one is sent; a further one is refused as busy.
        acknowledges: it answers messages that ask for it. The sender learns that its message came, and from the time of the answer the range.
        turn_around_s: between the end of a message and its answer.
        retries: how often a message is sent again that nobody answers.
        max_range_m: for an answer from farther nobody waits.
        assumed_sound_speed_mps: with which it makes a range of a travel time; default: the truth where it is mounted.
        direction_sigma_deg: error of the direction from which a message came, of a modem with an array; default: it tells none.
        clearance_m: what stands nearer than this to either end does not hide it.
        processing_s: from the end of a packet to the message.
    """

    ideal: bool = False
    address: _Address = 1
    addressed: bool = True
    broadcast_address: _Address = 255
    highest_address: _Address = 254
    protocol: Name = "modem"
    bits_per_s: Annotated[float, Meta(ge=1, le=1e9)] = 1000.0
    overhead_s: Annotated[float, Meta(ge=0, le=60)] = 0.0
    fixed_bytes: Annotated[int, Meta(ge=0, le=MOST_BYTES)] = 0
    max_bytes: Annotated[int, Meta(ge=1, le=MOST_BYTES)] = 64
    queue: Annotated[int, Meta(ge=0, le=MOST_QUEUE)] = 4
    acknowledges: bool = True
    turn_around_s: Annotated[float, Meta(ge=0, le=600)] = 0.1
    retries: Annotated[int, Meta(ge=0, le=16)] = 0
    max_range_m: Annotated[float, Meta(gt=0, le=1e6)] = 2000.0
    assumed_sound_speed_mps: Annotated[float, Meta(ge=1, le=1e5)] | UnsetType = UNSET
    direction_sigma_deg: NonNegative | UnsetType = UNSET
    clearance_m: NonNegative = 0.5
    processing_s: Annotated[float, Meta(ge=0, le=600)] = 0.0

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if self.address > self.highest_address:
            raise ValueError(f"address is {self.address}, the highest of this modem is {self.highest_address}")
        if self.address == self.broadcast_address:
            raise ValueError(f"address {self.address} is that for all (broadcast_address): give it one of its own")
        if self.acknowledges and not self.addressed:
            raise ValueError("acknowledges = true needs addressed = true: without addresses all would answer at once")

    def port_of(self, vehicle: str, name: str) -> str:
        """What it hears; beside it is ``send``."""
        return f"{vehicle}/{name}/received"

    def traits(self) -> Traits:
        """Its address, where packets carry one."""
        return Traits(address=self.address if self.addressed else UNSET)


class ModemSettings(Settings, frozen=True):
    """See `ModemTable`; `gain` is added to the level of what it sends, dB, `sound_speed` 0 stands for the truth."""

    address: _Address
    gain: Annotated[float, Meta(ge=-1000, le=0)]
    sound_speed: Annotated[float, Meta(ge=0, le=1e5)]


class Crossing(NamedTuple):
    """How a signal gets from one modem to another.

    Attributes:
        time: of travel, s.
        signal: its power where it arrives, over that of `noise`'s unit.
        noise: power of the noise there, in the same unit.
        late: power of what comes so much later than the signal that it smears the next symbols.
        level_db: of the signal, as the device tells it.
        towards: unit vector (N) to where it comes from.
        leaves: unit vector (N) along which it left.
    """

    time: float
    signal: float
    noise: float
    late: float
    level_db: float
    towards: Vec3
    leaves: Vec3


class Signal(Struct, frozen=True):
    """What is known of a signal in the water besides where it left: enough to receive it when its sender is gone.

    Attributes:
        protocol: its kind.
        frequency, bandwidth: Hz.
        level: at the source: dB re 1 uPa at 1 m, or of light dB re 1 W.
        axis: unit vector (N) along which it was sent.
    """

    protocol: _Path
    frequency: Number
    bandwidth: Annotated[float, Meta(gt=0, le=1e9)]
    level: Annotated[float, Meta(ge=-2000, le=2000)]
    axis: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class Modem(Sensor):
    """The receiving end of a modem: tells the messages in its inbox, one a reading.

    Attributes:
        table: of the device.
        mount: on its vehicle.
    """

    doc = (
        "Modem: a message that came for this modem or for all, or what became of one that asked for an answer: it was delivered, or nobody "
        "answered. Stamped with the arrival of its signal, and told when all of it has come."
    )
    fields = (
        Field("event", "1", '"data", "delivered" (answered) or "failed" (not answered)', type="str"),
        Field(
            "source", "1", "address of the sender; of an event about a message that was sent, of this modem", type="int"
        ),
        Field("destination", "1", "address to which it was sent", type="int"),
        Field("data", "1", "payload", type="bytes"),
        Field("level", "dB", "of the signal: sound re 1 uPa, light re 1 W"),
        Field("snr", "dB", "signal over noise in the band of the modem"),
        Field("range", "m", "distance of who answered, from the time of the answer"),
        Field("bearing", "rad", "direction of the sender from x towards y, of a modem with an array"),
        Field("elevation", "rad", "direction from the x-y plane towards z"),
        Field("relative_speed", "m/s", "with which sender and receiver part, of a modem that measures Doppler"),
    )
    paces = True
    rouses = True
    settings: ModemSettings
    memory: ModemMemory

    def __init__(self, mount: Pose, table: ModemTable) -> None:
        self.mount, self.table = mount, table
        self.arguments = (
            Argument("address", "int", "of this modem", "1", False, minimum=0, maximum=table.highest_address),
            Argument("gain", "float", "added to the level of what it sends", "dB", False, minimum=-60, maximum=0),
            Argument("sound_speed", "float", "what the device believes; 0 for the truth", "m/s", False, minimum=0, maximum=2000),
        )  # fmt: skip
        speed = 0.0 if table.assumed_sound_speed_mps is UNSET else table.assumed_sound_speed_mps
        super().__init__(ModemSettings(table.address, 0.0, speed))

    def turn_on(self) -> ModemMemory:
        """Silent, with nothing to tell."""
        return ModemMemory()

    @property
    def wake(self) -> float | None:
        return self.memory.inbox[0].over if self.memory.inbox else None

    def sense(self, scope: Scope) -> Measurement | None:
        """The oldest message that has come; None where there is none."""
        inbox = self.memory.inbox
        if not inbox or inbox[0].over > scope.t + 1e-9:
            return None
        told, self.memory.inbox = inbox[0], inbox[1:]
        values: list[Value] = [
            told.event, told.source, told.destination, Buffer(data=told.data), told.level, told.snr, told.range, told.bearing,
            told.elevation, told.speed,
        ]  # fmt: skip
        lasted = told.over - told.begin + self.table.processing_s
        since_ns = scope.t_ns - round(told.begin * NANOSECONDS)
        return Measurement(values, True, round(lasted * NANOSECONDS), since_ns=since_ns)

    def properties(self) -> dict[str, Json]:
        """The settings, and what was counted."""
        return {**super().properties(), "counts": structs.asdict(self.memory.counts)}

    def valid(self, record: Memory | Settings) -> None:
        """Whatever the types allow: as many messages may wait as they say."""
        if not isinstance(record, ModemMemory):
            super().valid(record)

    def tell(self, message: Message) -> None:
        """Have something to tell."""
        inbox = self.memory.inbox
        if len(inbox) == MOST_INBOX:
            inbox = inbox[1:]
            self.count("dropped")
        self.memory.inbox = (*inbox, message)
        self.rouse()

    def count(self, what: str) -> None:
        """One more of these."""
        counts = self.memory.counts
        self.memory.counts = structs.replace(counts, **{what: getattr(counts, what) + 1})

    def duration(self, data: bytes) -> float:
        """Of a packet with this payload, s."""
        return self.table.overhead_s + 8.0 * max(len(data), self.table.fixed_bytes) / self.table.bits_per_s

    def is_for_me(self, destination: int) -> bool:
        """Whether it takes messages to an address."""
        return destination in (self.settings.address, self.table.broadcast_address)

    @property
    def told_address(self) -> int:
        """What its packets say of who sent them."""
        return self.settings.address if self.table.addressed else self.table.broadcast_address

    def believed(self, scope: Scope, p: Vec3) -> float:
        """The sound speed (m/s) with which it makes ranges, at its place (N, m)."""
        return self.settings.sound_speed or scope.water.sound_speed(p[2])

    def direction(self, towards: Vec3, q_NS: tuple[float, float, float, float]) -> tuple[float, float] | None:
        """Bearing and elevation (rad, S) of a direction (N), without errors; None for a modem without an array."""
        if isinstance(self.table.direction_sigma_deg, UnsetType):
            return None
        x, y, z = rotate(conjugate(q_NS), towards)
        return math.atan2(y, x), math.atan2(z, math.hypot(x, y))

    @property
    def direction_sigma(self) -> float:
        """Rad."""
        sigma = self.table.direction_sigma_deg
        return 0.0 if isinstance(sigma, UnsetType) or self.table.ideal else rad(sigma)

    @property
    def fastest(self) -> float:
        """It understands nobody who comes nearer, or parts, faster than this, m/s."""
        return math.inf

    @property
    def speed_sigma(self) -> float | None:
        """Standard deviation of the relative speed that it tells, m/s; None for a modem that tells none."""
        return None

    @property
    @abstractmethod
    def speed(self) -> float:
        """No signal is faster, m/s."""

    def speed_at(self, scope: Scope, p: Vec3) -> float:
        """Of its signals at a place (N, m), m/s."""
        return self.speed

    def blur(self, distance: float) -> float:
        """What is narrower than this (m) hides nothing over a distance (m): half of the first Fresnel zone in the middle of the way."""
        return 0.0

    @abstractmethod
    def signal(self, q_NS: tuple[float, float, float, float]) -> Signal:
        """What it sends at this attitude."""

    @abstractmethod
    def overlap(self, signal: Signal) -> float:
        """How much of a signal's power is in its band, 0 to 1."""

    @abstractmethod
    def crossing(
        self, scope: Scope, signal: Signal, a: Vec3, b: Vec3, q_NS: tuple[float, float, float, float], gain: float
    ) -> Crossing | None:
        """How a signal gets from a to b (N, m), where this modem is with an attitude; None where it does not. gain: fading, dB."""

    @abstractmethod
    def notices(self, snr: float) -> bool:
        """Whether it notices a packet at a signal over noise, as a ratio of powers."""

    @abstractmethod
    def error_rate(self, snr: float, size: int) -> float:
        """Probability that a packet with so many bytes is not understood.

        Args:
            snr: signal over all that disturbs it, as a ratio of powers.
            size: bytes.
        """

    @abstractmethod
    def jitter(self, snr: float) -> float:
        """Standard deviation of the time of an arrival, s."""

    @property
    @abstractmethod
    def fading(self) -> tuple[float, float]:
        """Standard deviation of the level, dB, and the time in which it changes, s."""

"""What all kinds of modems share: the table, the memory, and the events that they report.

The medium (`uwserver.world.modems.medium`) works out which signals of a packet reach which modem, and when. A kind of modem says how its signals
travel, and how well they are understood.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Literal, NamedTuple

from msgspec import UNSET, Meta, Struct, UnsetType, structs

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.modifiers.base import Measurement, Memory, Number, Time
from uwserver.ports import Argument, Buffer, Field, Json, Value
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings, Traits
from uwserver.table import Name, NonNegative
from uwserver.units import NANOSECONDS, rad

MOST_BYTES = 1 << 16
HIGHEST_ADDRESS = 65_535
MOST_INBOX = 256
"""Events that wait to be reported. If there are more, the oldest is lost."""
MOST_QUEUE = 64
MOST_SEEN = 16
Address = Annotated[int, Meta(ge=0, le=HIGHEST_ADDRESS)]
_Whole = Annotated[int, Meta(ge=0, le=2**53)]
_Data = Annotated[bytes, Meta(max_length=MOST_BYTES)]
Event = Literal["data", "delivered", "failed"]


class Outgoing(Struct, frozen=True):
    """A message that waits to be sent.

    Attributes:
        id: id of the message; an answer has the id of the message that it answers.
        destination: address of the receiver.
        data: payload.
        answer: it answers a message that `wanted` an answer.
        wanted: it asks for an answer.
        after: earliest time of sending, s.
        tries: how often it may still be sent, if it asks for an answer.
        heard: for an answer, the time at which the message that it answers had arrived, s.
        patience: how long the modem waits for an answer, s; 0 for the longest time that one can take.
        ranging: a caller waits for the range.
    """

    id: _Whole
    destination: Address
    data: _Data = b""
    answer: bool = False
    wanted: bool = False
    after: Time = 0.0
    tries: Annotated[int, Meta(ge=0, le=17)] = 0
    heard: Time = 0.0
    patience: Time = 0.0
    ranging: bool = False


class Waiting(Struct, frozen=True):
    """A message that was sent and not answered yet.

    Attributes:
        message: the message.
        over: time at which the end of the packet was sent, s.
        until: time until which the modem waits, s.
    """

    message: Outgoing
    over: Time
    until: Time


class ModemReport(Struct, frozen=True):
    """An event that a modem reports.

    Attributes:
        event: data has arrived, or the outcome of a message that asked for an answer.
        source, destination: addresses.
        data: payload.
        begin, over: time at which its signal began to arrive, and at which it ended, s.
        level, snr: dB.
        range: m.
        bearing, elevation: rad in S.
        speed: rate at which the path of the sound grows, m/s.
    """

    event: Event
    source: Address
    destination: Address
    data: _Data
    begin: Time
    over: Time
    level: Number | None = None
    snr: Number | None = None
    range: Number | None = None
    bearing: Number | None = None
    elevation: Number | None = None
    speed: Number | None = None


class Counts(Struct, frozen=True):
    """The counters of a modem since the start of the run. Losses count messages to this modem.

    Attributes:
        sent: packets, answers included.
        heard: messages reported.
        collided: lost in the signals of other modems.
        deaf: lost because this modem was sending.
        smeared: lost in their own late echoes.
        faint: lost in noise, or not detected.
        doppler: lost because the modems moved too fast relative to each other.
        unanswered: messages that asked for an answer and got none.
        dropped: messages that were not reported in time.
    """

    sent: _Whole = 0
    heard: _Whole = 0
    collided: _Whole = 0
    deaf: _Whole = 0
    smeared: _Whole = 0
    faint: _Whole = 0
    doppler: _Whole = 0
    unanswered: _Whole = 0
    dropped: _Whole = 0


class ModemMemory(Memory):
    """Attributes:
    busy: time until which it sends, s.
    queue: messages that wait to be sent.
    waiting: messages that were sent and not answered yet.
    seen: ids of the last messages that arrived. If an answer is lost, the same message arrives twice.
    inbox: events to report.
    counts: see `Counts`."""

    busy: Time = 0.0
    queue: Annotated[tuple[Outgoing, ...], Meta(max_length=2 * MOST_QUEUE)] = ()
    waiting: Annotated[tuple[Waiting, ...], Meta(max_length=2 * MOST_QUEUE)] = ()
    seen: Annotated[tuple[_Whole, ...], Meta(max_length=MOST_SEEN)] = ()
    inbox: Annotated[tuple[ModemReport, ...], Meta(max_length=MOST_INBOX)] = ()
    counts: Counts = Counts()


class ModemTable(SensorTable, kw_only=True, frozen=True):
    """The keys of every modem. It takes messages at ``<vehicle>/<modem>/send``, and reports at ``<vehicle>/<modem>/received``.

    Messages are reported when they arrive, whatever `rate_hz` is.

    Attributes:
        ideal: it understands every signal that arrives: there is no noise, there are no collisions, and it receives while it sends.
        address: address of this modem; a device setting.
        addressed: packets carry addresses. Without addresses each packet is for all modems, and the broadcast address is reported as the source.
        broadcast_address: address that stands for all modems.
        highest_address: highest address of a modem of this make.
        protocol: modems with the same protocol understand each other.
        bits_per_s: rate of the payload, net of coding.
        overhead_s: duration of a packet besides its payload: preamble, header, guard time.
        fixed_bytes: each packet lasts at least as long as this many bytes, as on a device whose frames all have one length; 0 for none.
        max_bytes: longest payload.
        queue: how many messages can wait while one is sent; a further one is refused as busy.
        acknowledges: it answers messages that ask for it. The sender learns that its message arrived, and the range from the time of the answer.
        turn_around_s: time between the end of a message and its answer.
        retries: how often a message without an answer is sent again.
        max_range_m: the modem does not wait for answers from farther away.
        assumed_sound_speed_mps: sound speed with which it converts a travel time to a range; default: the true one at its mount.
        direction_sigma_deg: error of the direction of arrival, for a modem with an array; default: it reports no direction.
        clearance_m: things nearer than this to either end do not block the signal.
        processing_s: time from the end of a packet to the message.
    """

    ideal: bool = False
    address: Address = 1
    addressed: bool = True
    broadcast_address: Address = 255
    highest_address: Address = 254
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
        """Raise ValueError if keys do not go together."""
        if self.address > self.highest_address:
            raise ValueError(f"address is {self.address}, the highest of this modem is {self.highest_address}")
        if self.address == self.broadcast_address:
            raise ValueError(
                f"address {self.address} is the one for all modems (broadcast_address): give the modem another one"
            )
        if self.acknowledges and not self.addressed:
            raise ValueError(
                "acknowledges = true needs addressed = true: without addresses all modems would answer at once"
            )

    def port_of(self, vehicle: str, name: str) -> str:
        """Return the path of what it receives. The port ``send`` is beside it."""
        return f"{vehicle}/{name}/received"

    def traits(self) -> Traits:
        """Declare the address, if packets carry one."""
        return Traits(address=self.address if self.addressed else UNSET)


class ModemSettings(Settings, frozen=True):
    """See `ModemTable`. `gain` (dB) is added to the level of what it sends; `sound_speed` 0 means the true one."""

    address: Address
    gain: Annotated[float, Meta(ge=-1000, le=0)]
    sound_speed: Annotated[float, Meta(ge=0, le=1e5)]


class Crossing(NamedTuple):
    """How a signal travels from one modem to another.

    Attributes:
        time: travel time, s.
        signal: its power on arrival, in the unit of `noise`.
        noise: power of the noise there.
        late: power of echoes that come so late that they smear the next symbols, in the same unit.
        level_db: level of the signal, as the device reports it.
        towards: unit vector (N) towards the direction that it comes from.
        leaves: unit vector (N) along which it left the sender.
    """

    time: float
    signal: float
    noise: float
    late: float
    level_db: float
    towards: Vec3
    leaves: Vec3


class Signal(Struct, frozen=True):
    """A signal in the water, apart from the place where it left. This is enough to receive it after its sender is gone.

    Attributes:
        protocol: the protocol of the sender.
        frequency, bandwidth: Hz.
        level: source level: dB re 1 uPa at 1 m, or dB re 1 W for light.
        axis: unit vector (N) along which it was sent.
    """

    protocol: Annotated[str, Meta(max_length=4096)]
    frequency: Number
    bandwidth: Annotated[float, Meta(gt=0, le=1e9)]
    level: Annotated[float, Meta(ge=-2000, le=2000)]
    axis: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class Modem(Sensor):
    """The receiving end of a modem. Each reading reports one message of its inbox.

    Attributes:
        table: the table of the device.
        mount: its mount on the vehicle.
    """

    doc = (
        "Modem: a message to this modem or to all modems; or the outcome of a sent message that asked for an answer. The time stamp is the "
        "beginning of the arrival of its signal; the sample comes after the end of the signal."
    )
    fields = (
        Field("event", "1", '"data", "delivered" (answered) or "failed" (not answered)', type="str"),
        Field("source", "1", "address of the sender; the address of this modem in an outcome", type="int"),
        Field("destination", "1", "address to which it was sent", type="int"),
        Field("data", "1", "payload", type="bytes"),
        Field("level", "dB", "level of the signal: sound re 1 uPa, light re 1 W"),
        Field("snr", "dB", "signal over noise in the band of the modem"),
        Field("range", "m", "distance of the modem that answered, from the time of the answer"),
        Field("bearing", "rad", "direction of the sender from x towards y, if the modem has an array"),
        Field("elevation", "rad", "direction of the sender from the x-y plane towards z"),
        Field("relative_speed", "m/s", "speed at which sender and receiver move apart, if the modem measures Doppler"),
    )
    paces = True
    rouses = True
    settings: ModemSettings
    memory: ModemMemory

    def __init__(self, mount: Pose, table: ModemTable) -> None:
        self.mount, self.table = mount, table
        self.arguments = (
            Argument("address", "int", "address of this modem", "1", False, minimum=0, maximum=table.highest_address),
            Argument("gain", "float", "added to the level of what it sends", "dB", False, minimum=-60, maximum=0),
            Argument("sound_speed", "float", "assumed sound speed; 0 for the true one", "m/s", False, minimum=0, maximum=2000),
        )  # fmt: skip
        speed = 0.0 if table.assumed_sound_speed_mps is UNSET else table.assumed_sound_speed_mps
        super().__init__(ModemSettings(table.address, 0.0, speed))

    def turn_on(self) -> ModemMemory:
        """Return an empty memory."""
        return ModemMemory()

    @property
    def wake(self) -> float | None:
        return self.memory.inbox[0].over if self.memory.inbox else None

    def sense(self, scope: Scope) -> Measurement | None:
        """Report the oldest message that has arrived; None if there is none."""
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
        """Return the settings and the counters."""
        return {**super().properties(), "counts": structs.asdict(self.memory.counts)}

    def valid(self, record: Memory | Settings) -> None:
        """Accept any memory that the types allow: the number of waiting messages may be anything up to their limits."""
        if not isinstance(record, ModemMemory):
            super().valid(record)

    def tell(self, message: ModemReport) -> None:
        """Put an event into the inbox."""
        inbox = self.memory.inbox
        if len(inbox) == MOST_INBOX:
            inbox = inbox[1:]
            self.count("dropped")
        self.memory.inbox = (*inbox, message)
        self.rouse()

    def count(self, what: str) -> None:
        """Increase a counter of `Counts` by one."""
        counts = self.memory.counts
        self.memory.counts = structs.replace(counts, **{what: getattr(counts, what) + 1})

    def duration(self, data: bytes) -> float:
        """Return the duration of a packet with this payload, s."""
        return self.table.overhead_s + 8.0 * max(len(data), self.table.fixed_bytes) / self.table.bits_per_s

    def is_for_me(self, destination: int) -> bool:
        """Return whether messages to an address are for this modem."""
        return destination in (self.settings.address, self.table.broadcast_address)

    @property
    def told_address(self) -> int:
        """The source address that its packets carry."""
        return self.settings.address if self.table.addressed else self.table.broadcast_address

    def believed(self, scope: Scope, p: Vec3) -> float:
        """Return the sound speed (m/s) that it uses for ranges, at its position p (N, m)."""
        return self.settings.sound_speed or scope.water.sound_speed(p[2])

    def direction(self, towards: Vec3, q_NS: tuple[float, float, float, float]) -> tuple[float, float] | None:
        """Return bearing and elevation (rad, S) of a direction (N), without errors; None for a modem without an array."""
        if isinstance(self.table.direction_sigma_deg, UnsetType):
            return None
        x, y, z = rotate(conjugate(q_NS), towards)
        return math.atan2(y, x), math.atan2(z, math.hypot(x, y))

    @property
    def direction_sigma(self) -> float:
        """Standard deviation of the direction of arrival, rad."""
        sigma = self.table.direction_sigma_deg
        return 0.0 if isinstance(sigma, UnsetType) or self.table.ideal else rad(sigma)

    @property
    def fastest(self) -> float:
        """Largest relative speed at which it understands another modem, m/s."""
        return math.inf

    @property
    def speed_sigma(self) -> float | None:
        """Standard deviation of the relative speed that it reports, m/s; None for a modem that reports none."""
        return None

    @property
    @abstractmethod
    def speed(self) -> float:
        """Largest speed of a signal, m/s."""

    def speed_at(self, scope: Scope, p: Vec3) -> float:
        """Return the speed of its signals at a place (N, m), m/s."""
        return self.speed

    def blur(self, distance: float) -> float:
        """Return the width (m) below which a thing blocks nothing over a distance (m): half of the first Fresnel zone at mid-path."""
        return 0.0

    @abstractmethod
    def signal(self, q_NS: tuple[float, float, float, float]) -> Signal:
        """Return the signal that it sends at this attitude."""

    @abstractmethod
    def overlap(self, signal: Signal) -> float:
        """Return the part of a signal's power that lies in its band, 0 to 1."""

    @abstractmethod
    def crossing(
        self, scope: Scope, signal: Signal, a: Vec3, b: Vec3, q_NS: tuple[float, float, float, float], gain: float
    ) -> Crossing | None:
        """Return how a signal travels from a to b (N, m), where this modem is with attitude q_NS; None if it does not arrive. gain: fading, dB."""

    @abstractmethod
    def notices(self, snr: float) -> bool:
        """Return whether it detects a packet at this signal-to-noise ratio, a ratio of powers."""

    @abstractmethod
    def error_rate(self, snr: float, size: int) -> float:
        """Return the probability that a packet is not understood.

        Args:
            snr: power of the signal over the power of everything that disturbs it.
            size: payload, bytes.
        """

    @abstractmethod
    def jitter(self, snr: float) -> float:
        """Return the standard deviation of the time of an arrival, s."""

    @property
    @abstractmethod
    def fading(self) -> tuple[float, float]:
        """Standard deviation of the level, dB, and the time scale on which the level changes, s."""

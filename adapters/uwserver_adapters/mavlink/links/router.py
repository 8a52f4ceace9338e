"""All channels of one vehicle: decodes and routes what comes in, and encodes what the vehicle says. Sans-IO, except for the log.

Senders and the channels behind which they are follow the rules of ArduPilot's MAVLink_routes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

from msgspec import Struct

from uwserver.adapter import AdapterContext, LogFile, Refusals, TurnTimes
from uwserver.ports import Event, Json, Sample
from uwserver_adapters.mavlink.vehicle.ardusub import ArduSub
from uwserver_adapters.mavlink.vehicle.bridge import INFO, WARNING
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.vehicle.others import OtherSystems
from uwserver_adapters.mavlink.wire.channel import Channel, Streams
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields, Layout, MavlinkMessage
from uwserver_adapters.mavlink.wire.frames import (
    EPOCH_S,
    KEY_SIZE,
    STAMPS_PER_S,
    Frame,
    Malformed,
    Signing,
    key_of,
    pack,
)

ROUTES = 64
"""Senders that are remembered; a new one replaces the oldest."""
NEVER_FORWARDED = frozenset({"RADIO", "RADIO_STATUS", "SETUP_SIGNING"})
"""Messages that concern only the two ends of one link."""
COMPONENT = 1
"""Component number of the autopilot; ground stations look at no other."""
_UNSIGNED = frozenset({"RADIO", "RADIO_STATUS"})
_FRAMES_AT_ONCE = 1024
"""Frames and malformed pieces that are decoded from one datagram or one read of a serial line. Real ones have far fewer."""
_PARTS_PER_TICK = 60
"""Download messages that a channel gets between two ticks: 1200/s at the usual 20 ticks per second."""


class Destinations(Struct, frozen=True):
    """Where a message goes: whether it is for us, and the other channels to which it is forwarded unchanged."""

    is_ours: bool
    to: tuple[int, ...] = ()


class Routes:
    """Learns which senders are behind which channels, and decides where messages go.

    Args:
        system, component: our own numbers.
    """

    def __init__(self, system: int, component: int) -> None:
        self._own = (system, component)
        self._seen: dict[tuple[int, int, int], None] = {}

    def destinations(
        self, channel: int, sender: tuple[int, int], target: tuple[int, int], name: str, others: Iterable[int]
    ) -> Destinations:
        """Return where a message goes.

        Args:
            channel: the channel on which it came.
            sender: system and component that sent it.
            target: addressed system and component; 0 for all, or where the message has none.
            name: name of the message.
            others: all open channels.
        """
        if sender == self._own:
            return Destinations(False)  # our own message, which a forwarding peer sent back
        if sender[0]:
            key = (*sender, channel)
            self._seen.pop(key, None)
            self._seen[key] = None
            if len(self._seen) > ROUTES:
                del self._seen[next(iter(self._seen))]
        system, component = target
        is_ours = system == 0 or (system == self._own[0] and component in (0, self._own[1]))
        if name in NEVER_FORWARDED:
            return Destinations(is_ours)
        if system == 0:
            return Destinations(True, tuple(other for other in others if other != channel))
        if is_ours and component:
            return Destinations(True)
        known = {c for s, k, c in self._seen if s == system and component in (0, k) and c != channel}
        return Destinations(is_ours, tuple(other for other in others if other in known))

    def forget(self, channel: int) -> None:
        """Forget all senders behind a channel that has been closed."""
        for key in [key for key in self._seen if key[2] == channel]:
            del self._seen[key]


class Router:
    """The adapter's `Subscriber`. Runs on the loop thread.

    Args:
        config: the adapter's table.
        context: the world.
        vehicle: name of the vehicle.
        dialect: the messages.
        steady: a clock that never jumps, s (the loop's).
        unix_s: seconds since 1970 now.

    Attributes:
        context: the world.
        vehicle: the vehicle's state machine.
        channels: the open channels, by number.
        dialect: the messages.
        refusals: counts and logs what links refuse.
        turns: shares the time between UDP peers.
        counters: counts what was received and not used, by reason.

    Raises:
        OSError: the log cannot be written.
        ValueError: the table has a parameter that does not exist, or a value that it cannot have.
    """

    def __init__(
        self,
        config: MavlinkConfig,
        context: AdapterContext,
        vehicle: str,
        dialect: Dialect,
        steady: Callable[[], float],
        unix_s: float,
    ) -> None:
        self.channels: dict[int, Channel] = {}
        self._config = config
        self.context = context
        self.refusals = Refusals(context.name, context.stats, steady)
        self.turns = TurnTimes()
        self.dialect = dialect
        self._steady = steady
        self._offset = unix_s - steady()
        self._last_number = 0
        self._routes = Routes(config.system, COMPONENT)
        self._signing = None if config.passphrase is None else Signing(key_of(config.passphrase), self._stamp)
        self._payloads: dict[str, Sequence[bytes]] = {}
        self._payloads_of = -1
        self._shown_at = 0.0
        self.vehicle = ArduSub(config, context, vehicle, dialect, self.send)
        self.counters = self.vehicle.bridge.counters
        self._others = OtherSystems(config.externals, context, self.vehicle.bridge.home, self.counters)
        self._tlog = LogFile(config.tlog, context) if config.tlog else None

    def _stamp(self) -> int:
        return int((self._steady() + self._offset - EPOCH_S) * STAMPS_PER_S)

    def _log(self, frame: bytes) -> None:
        """Append a frame to the telemetry log, after its time (8 bytes, us since 1970), as MAVProxy, QGroundControl and mavlogdump.py read it."""
        if self._tlog is not None:
            self._tlog.write(int((self._steady() + self._offset) * 1e6).to_bytes(8, "big") + frame)

    # -- channels ---------------------------------------------------------------------------------------------------------------------

    def open(
        self, name: str, write: Callable[[bytes], bool], is_ready: Callable[[], bool], has_peer: bool = False
    ) -> Channel:
        """Open a channel.

        Args:
            name: the channel as a user would type it.
            write: sends bytes; returns False when it dropped them.
            is_ready: returns whether a download may continue.
            has_peer: a peer is known to be there.
        """
        self._last_number += 1
        streams = Streams(self.vehicle.default_rates())
        frames_per_s = self._config.frames_per_s
        channel = Channel(self._last_number, name, self.dialect, write, is_ready, streams, frames_per_s)
        channel.has_peer, channel.heard_at = has_peer, self._steady()
        channel.allowance = _PARTS_PER_TICK
        self.channels[channel.number] = channel
        self.count_peers()
        return channel

    def close(self, channel: Channel) -> None:
        """Forget a channel that has been closed."""
        if self.channels.pop(channel.number, None) is not None:
            self._routes.forget(channel.number)
            self.vehicle.missions.forget(channel)
            self.vehicle.bridge.autopilot.forget(channel.number)
            self.count_peers()

    def count_peers(self) -> None:
        """Show in the adapter's statistics on how many channels a peer is heard."""
        self.context.stats.peers = sum(channel.has_peer for channel in self.channels.values())

    def end(self) -> None:
        """Close the log."""
        if self._tlog is not None:
            self._tlog.close()

    # -- in ---------------------------------------------------------------------------------------------------------------------------

    def receive(self, channel: Channel, data: bytes) -> None:
        """Take bytes of a peer, all at once. While the peer floods, they are dropped without being decoded."""
        for _ in self.frames(channel, data):
            pass

    def frames(self, channel: Channel, data: bytes) -> Iterator[None]:
        """Take bytes of a peer, one frame at each step of the iterator."""
        if channel.meter.is_flooded(self._steady()):
            self.counters["flood"] += 1
            return
        channel.decoder.receive(data)
        for _ in range(_FRAMES_AT_ONCE):
            if not self.work(channel):
                return
            yield
        self.counters["flood"] += 1
        channel.decoder.clear()

    def work(self, channel: Channel) -> bool:
        """Take the next frame of a channel. Returns False when there is none."""
        event = channel.decoder.next_event()
        if isinstance(event, Frame):
            self._take(channel, event)
        elif isinstance(event, Malformed):
            channel.meter.take(self._steady())
            is_garbage = event.reason == "garbage"
            self.counters["garbage_bytes" if is_garbage else event.reason] += event.size if is_garbage else 1
        return event is not None

    def _take(self, channel: Channel, frame: Frame) -> None:
        now = self._steady()
        if not channel.meter.take(now):
            self.counters["flood"] += 1
            return
        layout = self.dialect.by_id[frame.id]
        if not self._is_trusted(frame, layout):
            return
        channel.heard_at = now
        channel.is_heard = True
        if not channel.has_peer:
            channel.has_peer = True
            self.count_peers()
        self._log(frame.raw)
        message = layout.decode(frame.payload, frame.system, frame.component)
        self._others.take(message, now)
        destinations = self._routes.destinations(
            channel.number, message.sender, _target(message, layout), layout.name, self.channels
        )
        for number in destinations.to:
            self.channels[number].write(frame.raw)
            self.counters["forwarded"] += 1
        if not destinations.is_ours:
            self.counters["not_for_us"] += not destinations.to
        elif layout.name == "SETUP_SIGNING":
            self._set_up_signing(message)
        else:
            autopilot = self.vehicle.bridge.autopilot
            autopilot.asker = channel.number
            try:
                self.vehicle.take(message, channel, now)
            finally:
                autopilot.asker = 0
            self._drain(channel)

    def _is_trusted(self, frame: Frame, layout: Layout) -> bool:
        if self._signing is None or (not frame.is_signed and layout.name in _UNSIGNED):
            return True
        reason = self._signing.refusal(frame)
        if reason:
            self.counters[f"signing_{reason}"] += 1
        return not reason

    def _set_up_signing(self, message: MavlinkMessage) -> None:
        bridge = self.vehicle.bridge
        if bridge.readings.state().armed:
            bridge.tell(WARNING, "Won't setup signing when armed")
            self.counters["refused"] += 1
            return
        key = bytes(int(entry) for entry in message.array("secret_key"))
        is_on = len(key) == KEY_SIZE and any(key)
        self._signing = Signing(key, self._stamp, message.integer("initial_timestamp")) if is_on else None
        bridge.tell(INFO, "Signing is on" if is_on else "Signing is off")

    # -- out --------------------------------------------------------------------------------------------------------------------------

    def send(self, name: str, fields: Fields, channel: Channel | None = None) -> None:
        """Send a message to one channel, or to all without a channel. It is encoded once."""
        layout = self.dialect.by_name[name]
        self.context.stats.encoded += 1
        to = self.channels.values() if channel is None else (channel,) if channel.number in self.channels else ()
        self._write(layout.id, layout.encode(fields), to)

    def _write(self, id: int, payload: bytes, channels: Iterable[Channel]) -> None:
        stats, signing = self.context.stats, self._signing
        is_logged = False
        for channel in channels:
            frame = pack(
                self.dialect, id, payload, channel.next_seq(), self._config.system, COMPONENT, signing is not None
            )
            if signing is not None:
                frame = signing.sign(frame, channel.number)
            if not channel.write(frame):
                stats.dropped += 1
                continue
            stats.samples_sent += 1
            stats.bytes_sent += len(frame)
            if not is_logged:  # a message to many channels is one message of the log
                self._log(frame)
                is_logged = True

    def _drain(self, channel: Channel) -> None:
        """Continue downloads as far as the channel takes them."""
        while channel.backlog and channel.allowance > 0 and channel.is_ready():
            part = next(channel.backlog[0], None)
            if part is None:
                channel.backlog.popleft()
                continue
            channel.allowance -= 1
            self.send(*part, channel)

    @property
    def subscriptions(self) -> Collection[str] | None:
        """Ports that are read; None for all, see `Readings.subscriptions`."""
        subscriptions = self.vehicle.bridge.readings.subscriptions
        return None if subscriptions is None else {*subscriptions, *self.vehicle.tunnel.subscriptions}

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Take the samples of a tick, and send the messages that are due."""
        if not samples:
            return
        t_ns = max(sample.t_sent_ns for sample in samples)
        self.vehicle.advance(t_ns)
        self.vehicle.tunnel.put(samples)
        for channel in self.channels.values():
            for name in channel.streams.due(t_ns):
                for payload in self._built(name, t_ns):
                    self._write(self.dialect.by_name[name].id, payload, (channel,))

    def _built(self, name: str, t_ns: int) -> Sequence[bytes]:
        """Return the payloads of a message at this time, built once for all channels."""
        if self._payloads_of != t_ns:
            self._payloads.clear()
            self._payloads_of = t_ns
        payloads = self._payloads.get(name)
        if payloads is None:
            encode = self.dialect.by_name[name].encode
            payloads = self._payloads[name] = [encode(fields) for fields in self.vehicle.telemetry.build(name)]
            self.context.stats.encoded += len(payloads)
        return payloads

    def put_event(self, event: Event) -> None:
        """Tell the pilots of an event. After a reset all streams begin again."""
        self.vehicle.take_event(event)
        if event.event == "reset":
            for channel in self.channels.values():
                channel.streams.restart()

    def tick(self) -> None:
        """Do what depends on wall time. Called about 20 times per second."""
        now = self._steady()
        self.vehicle.tick(now)
        for channel in list(self.channels.values()):
            channel.allowance = _PARTS_PER_TICK
            self._drain(channel)
        if now - self._shown_at >= 1.0:
            self._shown_at = now
            self.show()

    def show(self) -> None:
        """Show in the adapter's state who is there, and what was received and not used."""
        details: dict[str, Json] = dict(sorted(self.counters.items()))
        links: list[Json] = [channel.name for channel in self.channels.values() if channel.has_peer]
        self.context.stats.details.update({"links": links, "signed": self._signing is not None, "counters": details})
        bad = {"checksum", "unknown", "incompatible", "garbage_bytes", "flood", "json"}
        refused = sum(n for name, n in self.counters.items() if name in bad or name.startswith("signing_"))
        self.context.stats.details["bad_input"] = refused


def _target(message: MavlinkMessage, layout: Layout) -> tuple[int, int]:
    system, component = layout.target_fields
    return (message.integer(system) if system else 0, message.integer(component) if component else 0)

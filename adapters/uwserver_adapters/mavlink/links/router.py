"""All channels of one vehicle: bytes in, routing, the vehicle, bytes out. Sans-IO but for the log."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

from uwserver.adapter import AdapterContext, Refusals, TurnTimes
from uwserver.ports import Event, Json, Sample
from uwserver_adapters.mavlink.links.routes import Routes
from uwserver_adapters.mavlink.links.tlog import Tlog
from uwserver_adapters.mavlink.vehicle.ardusub import ArduSub
from uwserver_adapters.mavlink.vehicle.bridge import INFO, WARNING
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.vehicle.others import Others
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields, Layout, Message
from uwserver_adapters.mavlink.wire.frames import Frame, Malformed, pack
from uwserver_adapters.mavlink.wire.signing import EPOCH_S, KEY_SIZE, STAMPS_PER_S, Signing, key_of
from uwserver_adapters.mavlink.wire.streams import Streams

COMPONENT = 1
"""The autopilot's; ground stations look at no other."""
_UNSIGNED = frozenset({"RADIO", "RADIO_STATUS"})
_AT_ONCE = 1024
"""Frames, and pieces that are none, which are looked at in one datagram or one piece of a serial line; it has far fewer."""
_PARTS = 60
"""Messages of downloads that a channel gets between two ticks: 1200/s at the usual 20 ticks a second."""


class Router:
    """The adapter's `Subscriber`. Loop thread.

    Args:
        config: the adapter's table.
        context: the world.
        vehicle: name of the vehicle.
        dialect: the messages.
        steady: a clock that never jumps, s (that of the loop).
        unix_s: seconds since 1970 now.

    Attributes:
        context: the world.
        vehicle: its state machine.
        channels: those that are open, by number.
        dialect: the messages.
        refusals: of links.
        turns: of peers by UDP.

    Raises:
        OSError: the log cannot be written.
        ValueError: a parameter of the table is none.
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
        self._counters = self.vehicle.bridge.counters
        self._others = Others(config.externals, context, self.vehicle.bridge.home, self._counters)
        self._tlog = Tlog(config.tlog, lambda: int((steady() + self._offset) * 1e6), context) if config.tlog else None

    def _stamp(self) -> int:
        return int((self._steady() + self._offset - EPOCH_S) * STAMPS_PER_S)

    # -- channels ---------------------------------------------------------------------------------------------------------------------

    def open(
        self, name: str, write: Callable[[bytes], bool], is_ready: Callable[[], bool], has_peer: bool = False
    ) -> Channel:
        """A new channel.

        Args:
            name: as a user would type it.
            write: sends bytes, False when they were dropped.
            is_ready: whether a download may go on.
            has_peer: somebody is surely there.
        """
        self._last_number += 1
        streams = Streams(self.vehicle.default_rates())
        frames_per_s = self._config.frames_per_s
        channel = Channel(self._last_number, name, self.dialect, write, is_ready, streams, frames_per_s)
        channel.has_peer, channel.heard_at = has_peer, self._steady()
        channel.allowance = _PARTS
        self.channels[channel.number] = channel
        self.count_peers()
        return channel

    def close(self, channel: Channel) -> None:
        """It is gone."""
        if self.channels.pop(channel.number, None) is not None:
            self._routes.forget(channel.number)
            self.vehicle.missions.forget(channel)
            self.vehicle.bridge.autopilot.forget(channel.number)
            self.count_peers()

    def count_peers(self) -> None:
        """Channels on which somebody is heard."""
        self.context.stats.peers = sum(channel.has_peer for channel in self.channels.values())

    def end(self) -> None:
        """End the log."""
        if self._tlog is not None:
            self._tlog.close()

    # -- in ---------------------------------------------------------------------------------------------------------------------------

    def receive(self, channel: Channel, data: bytes) -> None:
        """Bytes of a peer, all taken at once; what a flood brings is not even looked at."""
        for _ in self.frames(channel, data):
            pass

    def frames(self, channel: Channel, data: bytes) -> Iterator[None]:
        """The same, a frame at a time."""
        if channel.meter.is_flooded(self._steady()):
            self._counters["flood"] += 1
            return
        channel.decoder.receive(data)
        for _ in range(_AT_ONCE):
            if not self.work(channel):
                return
            yield
        self._counters["flood"] += 1
        channel.decoder.clear()

    def count(self, reason: str) -> None:
        """Something came that could not be taken."""
        self._counters[reason] += 1

    def work(self, channel: Channel) -> bool:
        """Take the next frame of a channel; False when there is none."""
        event = channel.decoder.next_event()
        if isinstance(event, Frame):
            self._take(channel, event)
        elif isinstance(event, Malformed):
            channel.meter.take(self._steady())
            self._counters[f"{event.reason}_bytes" if event.reason == "garbage" else event.reason] += (
                event.size if event.reason == "garbage" else 1
            )
        return event is not None

    def _take(self, channel: Channel, frame: Frame) -> None:
        now = self._steady()
        if not channel.meter.take(now):
            self._counters["flood"] += 1
            return
        layout = self.dialect.by_id[frame.id]
        if not self._is_trusted(frame, layout):
            return
        channel.heard_at = now
        channel.is_heard = True
        if not channel.has_peer:
            channel.has_peer = True
            self.count_peers()
        if self._tlog is not None:
            self._tlog.write(frame.raw)
        message = layout.decode(frame.payload, frame.system, frame.component)
        self._others.hear(message, now)
        way = self._routes.way(
            channel.number, (frame.system, frame.component), _target(message, layout), layout.name, self.channels
        )
        for number in way.to:
            self.channels[number].write(frame.raw)
            self._counters["forwarded"] += 1
        if not way.is_ours:
            self._counters["not_for_us"] += not way.to
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
            self._counters[f"signing_{reason}"] += 1
        return not reason

    def _set_up_signing(self, message: Message) -> None:
        if self.vehicle.bridge.readings.state().armed:
            self.vehicle.bridge.tell(WARNING, "Won't setup signing when armed")
            self._counters["refused"] += 1
            return
        key = bytes(int(entry) for entry in message.row("secret_key"))
        if len(key) == KEY_SIZE and any(key):
            self._signing = Signing(key, self._stamp, message.whole("initial_timestamp"))
        else:
            self._signing = None
        self.vehicle.bridge.tell(INFO, "Signing is on" if self._signing is not None else "Signing is off")

    # -- out --------------------------------------------------------------------------------------------------------------------------

    def send(self, name: str, fields: Fields, channel: Channel | None = None) -> None:
        """Send a message to one channel, or to all; it is encoded once."""
        layout = self.dialect.by_name[name]
        self.context.stats.encoded += 1
        to = self.channels.values() if channel is None else (channel,) if channel.number in self.channels else ()
        self._write(layout.id, layout.encode(fields), to)

    def _write(self, id: int, payload: bytes, channels: Iterable[Channel]) -> None:
        stats, signing = self.context.stats, self._signing
        log = self._tlog
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
            if log is not None:
                log.write(frame)
                log = None  # what goes to many is one message of the log

    def _drain(self, channel: Channel) -> None:
        """Go on with downloads, as far as the channel takes it."""
        while channel.backlog and channel.allowance > 0 and channel.is_ready():
            part = next(channel.backlog[0], None)
            if part is None:
                channel.backlog.popleft()
                continue
            channel.allowance -= 1
            self.send(*part, channel)

    @property
    def wanted(self) -> Collection[str] | None:
        """See `Readings.wanted`."""
        wanted = self.vehicle.bridge.readings.wanted
        return None if wanted is None else {*wanted, *self.vehicle.tunnel.wanted}

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Simulation time went on: whatever is due goes out."""
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
        """Payloads of a message at this time, made once for all channels."""
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
        """Tell the pilots."""
        self.vehicle.take_event(event)
        if event.event == "reset":
            for channel in self.channels.values():
                channel.streams.restart()

    def tick(self) -> None:
        """To be called some twenty times a second."""
        now = self._steady()
        self.vehicle.tick(now)
        for channel in list(self.channels.values()):
            channel.allowance = _PARTS
            self._drain(channel)
        if now - self._shown_at >= 1.0:
            self._shown_at = now
            self.show()

    def show(self) -> None:
        """What came and was not taken, and who is there, in the adapter's state."""
        details: dict[str, Json] = dict(sorted(self._counters.items()))
        links: list[Json] = [channel.name for channel in self.channels.values() if channel.has_peer]
        self.context.stats.details.update({"links": links, "signed": self._signing is not None, "counters": details})
        bad = {"checksum", "unknown", "incompatible", "garbage_bytes", "flood", "json"}
        refused = sum(n for name, n in self._counters.items() if name in bad or name.startswith("signing_"))
        self.context.stats.details["bad_input"] = refused


def _target(message: Message, layout: Layout) -> tuple[int, int]:
    system, component = layout.has_target
    return (message.whole(system) if system else 0, message.whole(component) if component else 0)

"""The vehicle's side of MAVLink as one state machine: messages and time in, messages out. Knows no socket."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from typing import Protocol

from uwserver.adapter import AdapterContext
from uwserver.frames import rpy_from_quat
from uwserver.ports import Event
from uwserver_adapters.mavlink.vehicle.autopilot import Autopilot, Done
from uwserver_adapters.mavlink.vehicle.commands import Commands
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.vehicle.failsafe import CRITICAL, ERROR, INFO, NOTICE, WARNING, Failsafes
from uwserver_adapters.mavlink.vehicle.files import SIZE, Files, message, parse
from uwserver_adapters.mavlink.vehicle.home import Home
from uwserver_adapters.mavlink.vehicle.identity import Identity
from uwserver_adapters.mavlink.vehicle.missions import Missions
from uwserver_adapters.mavlink.vehicle.modes import BY_NAME, Mode
from uwserver_adapters.mavlink.vehicle.outputs import Outputs, wired
from uwserver_adapters.mavlink.vehicle.parameters import Parameters
from uwserver_adapters.mavlink.vehicle.payload import Payload
from uwserver_adapters.mavlink.vehicle.pilot import Pilot
from uwserver_adapters.mavlink.vehicle.readings import Readings
from uwserver_adapters.mavlink.vehicle.setpoints import SetPoints
from uwserver_adapters.mavlink.vehicle.telemetry import Telemetry
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.codec import seconds, turns, wrapped
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields, Message
from uwserver_adapters.mavlink.wire.streams import GROUPS, POSITION

HEARTBEAT_S = 1.0
_TEXT = 50
"""Characters of one STATUSTEXT; a longer text comes in pieces."""
_LONGEST_TEXT = 4 * _TEXT
_SEVERITIES = {
    "watchdog": NOTICE, "fault": WARNING, "conflict": WARNING, "diverged": CRITICAL, "adapter_failed": ERROR, "shutdown": WARNING,
}  # fmt: skip
_BUTTON_MODES = {
    5: "MANUAL",
    6: "STABILIZE",
    7: "ALT_HOLD",
    8: "POSHOLD",
    9: "AUTO",
    11: "GUIDED",
    12: "ACRO",
    13: "SURFTRAK",
}


class Send(Protocol):
    """Sends a message to one channel, or to all."""

    def __call__(self, name: str, fields: Fields, channel: Channel | None = None) -> None: ...


class Vehicle:
    """One vehicle, as ground stations see it. Loop thread.

    Args:
        config: the adapter's table.
        context: the world.
        name: of the vehicle in the world.
        dialect: the messages.
        send: where messages go.

    Attributes:
        counters: what came and was not taken: refused, stale_time ...
        epoch_ns: UTC of simulation time zero, ns since 1970.
        tether_turns: whole turns of the heading since the start, clockwise positive.
    """

    def __init__(self, config: MavlinkConfig, context: AdapterContext, name: str, dialect: Dialect, send: Send) -> None:
        self.send = send
        self.counters: Counter[str] = Counter()
        self.epoch_ns = _epoch_ns(context)
        self.tether_turns = 0.0
        self._context = context
        self._own_ports = re.compile(rf'"{re.escape(name)}/(?:autopilot/)?([^"]*)"')
        self._dialect = dialect
        self._config = config
        self._last_yaw: float | None = None
        self._beat_at = -HEARTBEAT_S
        self._text_id = 0
        trial = context.ports.get(f"{name}/autopilot/test")
        motors, patience_s = (trial.fields[0].size, trial.timeout_s or 0.0) if trial is not None else (0, 0.0)
        self.identity = Identity(str(context.hello().get("server", "uwserver")), _thrusters(context, name))
        given = {"MAV_SYSID": config.system, "FRAME_CONFIG": self.identity.frame, **wired(motors), **config.parameters}
        self.parameters = Parameters(given)
        self.readings = Readings(context, name)
        self.autopilot = Autopilot(context, name)
        self.home = Home(config.origin_deg)
        self.payload = Payload()
        self.outputs = Outputs(self.parameters, self.payload, motors, patience_s)
        self.failsafes = Failsafes(self)
        self.pilot = Pilot(self.parameters, self._steer, self._button_actions(), lambda text: self.tell(INFO, text))
        self.missions = Missions(self)
        self.setpoints = SetPoints(self)
        self.commands = Commands(self)
        self.telemetry = Telemetry(self)
        self._files = Files({"@PARAM/param.pck": lambda options: self.parameters.packed("withdefaults=1" in options)})
        self._verbs = self._dispatch()

    def _dispatch(self) -> Mapping[str, Callable[[Message, Channel, float], None]]:
        missions, setpoints = self.missions, self.setpoints
        return {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": lambda m, c, _: self.commands.take(m, c),
            "COMMAND_INT": lambda m, c, _: self.commands.take(m, c),
            "SET_MODE": lambda m, c, _: self.commands.mode_message(m, c),
            "MANUAL_CONTROL": lambda m, _, __: self._manual_control(m),
            "RC_CHANNELS_OVERRIDE": lambda m, _, __: self._rc_override(m),
            "PARAM_REQUEST_LIST": lambda _, c, __: c.backlog.append(self.parameters.download()),
            "PARAM_REQUEST_READ": lambda m, c, _: self._param_read(m, c),
            "PARAM_SET": lambda m, _, __: self._param_set(m),
            "FILE_TRANSFER_PROTOCOL": lambda m, c, _: self._file_transfer(m, c),
            "REQUEST_DATA_STREAM": lambda m, c, _: self._data_stream(m, c),
            "MISSION_COUNT": missions.begin_upload,
            "MISSION_ITEM_INT": missions.take,
            "MISSION_ITEM": missions.take,
            "MISSION_REQUEST_LIST": lambda m, c, _: missions.tell_count(m, c),
            "MISSION_REQUEST_INT": lambda m, c, _: missions.tell_item(m, c),
            "MISSION_REQUEST": lambda m, c, _: missions.tell_item(m, c),
            "MISSION_CLEAR_ALL": lambda m, c, _: missions.clear(m, c),
            "MISSION_SET_CURRENT": lambda m, _, __: self._mission_current(m),
            "SET_POSITION_TARGET_LOCAL_NED": lambda m, _, __: setpoints.local(m),
            "SET_POSITION_TARGET_GLOBAL_INT": lambda m, _, __: setpoints.geodetic(m),
            "SET_ATTITUDE_TARGET": lambda m, _, __: setpoints.attitude(m),
            "SET_GPS_GLOBAL_ORIGIN": lambda m, _, __: self._set_origin(m),
            "TIMESYNC": lambda m, c, _: self._timesync(m, c),
        }

    # -- in ---------------------------------------------------------------------------------------------------------------------------

    @property
    def gcs_system(self) -> int:
        """Number of the ground station that may steer."""
        return round(self.parameters.value("MAV_GCS_SYSID"))

    @property
    def altitude_target(self) -> float:
        """Above the bottom, m, that SURFTRAK holds; 0 in other modes."""
        state = self.readings.state()
        if state.mode != "altitude_hold" or None in (state.depth_ref, state.depth, state.altitude):
            return 0.0
        return (state.altitude or 0.0) + (state.depth or 0.0) - (state.depth_ref or 0.0)

    @property
    def _now(self) -> float:
        return seconds(self.readings.t_ns)

    def take(self, message: Message, channel: Channel, now: float) -> None:
        """A message for us.

        Args:
            message: what came.
            channel: on which.
            now: wall time, s.
        """
        verb = self._verbs.get(message.name)
        if verb is not None:
            verb(message, channel, now)

    def _heartbeat(self, message: Message, _: Channel, __: float) -> None:
        if message.system == self.gcs_system:
            self.failsafes.heard_gcs(self._now)

    def _manual_control(self, message: Message) -> None:
        """Steering counts only from the station in charge, to exactly us; it is a heartbeat too."""
        if message.system != self.gcs_system or message.whole("target") != self._config.system:
            self.counters["not_in_charge"] += 1
            return
        self.failsafes.heard_gcs(self._now)
        self.failsafes.heard_pilot(self._now)
        self.pilot.steer(message, self._now)

    def _rc_override(self, message: Message) -> None:
        if message.system != self.gcs_system:
            self.counters["not_in_charge"] += 1
            return
        self.failsafes.heard_pilot(self._now)
        self.pilot.override(message, self._now)

    def _param_read(self, message: Message, channel: Channel) -> None:
        index = message.whole("param_index")
        name = self.parameters.at(index) if index >= 0 else message.text("param_id")
        if name in self.parameters.names:
            self.send("PARAM_VALUE", self.parameters.message(str(name)), channel)

    def _param_set(self, message: Message) -> None:
        """All are told the value that it has now; an unknown name is met with silence, as ArduPilot does it."""
        name = message.text("param_id")
        if name not in self.parameters.names:
            self.counters["refused"] += 1
            return
        if not self.parameters.set(name, message.number("param_value")):
            self.counters["refused"] += 1
            self.tell(WARNING, f"{name} cannot have that value")
        elif name == "JS_GAIN_DEFAULT":
            self.pilot.gain = self.parameters.value(name)
        self.send("PARAM_VALUE", self.parameters.message(name, is_answer_to_set=True))

    def _file_transfer(self, message_: Message, channel: Channel) -> None:
        request = parse(bytes(int(entry) for entry in message_.row("payload")[:SIZE]))
        system, component = peer = (message_.system, message_.component)
        channel.backlog.append(message(payload, system, component) for payload in self._files.answer(peer, request))

    def _data_stream(self, message: Message, channel: Channel) -> None:
        rate = message.whole("req_message_rate") if message.whole("start_stop") else 0
        group = message.whole("req_stream_id")
        if not channel.streams.set_group(group, rate):
            self.counters["refused"] += 1
        elif rate and group in (0, POSITION):
            # QGroundControl does not ask a submarine for home, and plans no mission before it knows it.
            for fields in self.telemetry.build("HOME_POSITION"):
                self.send("HOME_POSITION", fields, channel)

    def _mission_current(self, message: Message) -> None:
        if not self.missions.set_current(message.whole("seq")):
            self.counters["refused"] += 1

    def _set_origin(self, message: Message) -> None:
        if message.whole("target_system") not in (0, self._config.system):
            return
        if self.home.set_origin(message.whole("latitude"), message.whole("longitude")):
            self.announce("GPS_GLOBAL_ORIGIN")
            self.announce("HOME_POSITION")
        else:
            self.counters["refused"] += 1

    def _timesync(self, message: Message, channel: Channel) -> None:
        if message.whole("tc1") == 0:
            # Zero would read as a question.
            self.send("TIMESYNC", {"tc1": max(1, self.readings.t_ns), "ts1": message.whole("ts1")}, channel)

    # -- out --------------------------------------------------------------------------------------------------------------------------

    def tell(self, severity: int, text: str) -> None:
        """STATUSTEXT to all."""
        data = text.encode("ascii", "replace")[:_LONGEST_TEXT]
        pieces = [data[k : k + _TEXT] for k in range(0, len(data), _TEXT)] or [b""]
        if len(pieces) > 1:
            self._text_id = self._text_id % 0xFFFF + 1
        for number, piece in enumerate(pieces):
            id = self._text_id if len(pieces) > 1 else 0
            self.send("STATUSTEXT", {"severity": severity, "text": piece, "id": id, "chunk_seq": number})
        if len(pieces) > 1 and len(pieces[-1]) == _TEXT:  # a piece that is not full ends the text
            self.send("STATUSTEXT", {"severity": severity, "text": b"", "id": self._text_id, "chunk_seq": len(pieces)})

    def announce(self, name: str) -> None:
        """A message of the telemetry to all, now."""
        for fields in self.telemetry.build(name):
            self.send(name, fields)

    def tick(self, now: float) -> None:
        """Heartbeat, fail-safes, uploads; to be called some twenty times a second of wall time.

        Args:
            now: wall time, s.
        """
        self.readings.forget()
        if now - self._beat_at >= HEARTBEAT_S:
            self._beat_at = now if now - self._beat_at > 2 * HEARTBEAT_S else self._beat_at + HEARTBEAT_S
            self.announce("HEARTBEAT")
        self.missions.tick(now)
        self.pilot.tick(self._now)
        self.failsafes.tick(self._now)
        self._count_turns()

    def advance(self, t_ns: int) -> None:
        """Simulation time went on, and samples came."""
        self.readings.t_ns = t_ns

    def take_event(self, event: Event) -> None:
        """Something that the pilot should know."""
        if event.event == "ports_changed":
            self.readings.open_ports()
        elif event.event == "reset":
            self.readings.t_ns = event.t_ns
            self.readings.forget()
            self.failsafes.restart()
            self.pilot.tick(self._now)
        # Without our own name most texts fit in one message: Cockpit does not join the pieces of a longer one.
        text = self._own_ports.sub(r"\1", event.text or event.event)
        self.tell(_SEVERITIES.get(event.event, INFO), text)

    def _count_turns(self) -> None:
        q = self.readings.state().q_NB
        if q is None:
            return
        yaw = rpy_from_quat(q)[2]
        if self._last_yaw is not None:
            self.tether_turns += turns(wrapped(yaw - self._last_yaw))
        self._last_yaw = yaw

    # -- what all parts need ------------------------------------------------------------------------------------------------------------

    def message_name(self, number: int) -> str:
        """Name of a message by its number; "" for one that there is not."""
        layout = self._dialect.by_id.get(number)
        return layout.name if layout is not None else ""

    def default_rates(self) -> Mapping[int, float]:
        """Streams of a new channel: rates (Hz) by group."""
        return {group: self.parameters.value(f"MAV1_{suffix}") for group, (suffix, _) in GROUPS.items()}

    def arm(self, force: bool, done: Done) -> None:
        """Arm, and say so. What the sticks last said was said to a vehicle at rest: it does not count."""
        self.failsafes.armed()
        self.pilot.neutral()
        self.outputs.begin_test()
        self.autopilot.call("arm", {"force": force}, self._announced(done, "Arming motors", armed=True))

    def disarm(self, done: Done) -> None:
        """Disarm, and say so."""
        self.pilot.neutral()
        self.autopilot.call("disarm", {}, self._announced(done, "Disarming motors", armed=False))

    def set_mode(self, mode: Mode, done: Done) -> None:
        """Change the mode."""
        self.autopilot.call("set_mode", {"mode": mode.autopilot}, self._announced(done, "", mode=mode.autopilot))

    def _announced(self, done: Done, text: str, **change: str | bool) -> Done:
        def told(reason: str) -> None:
            if not reason:
                self.readings.assume(self.autopilot.replied_ns, **change)
                if text:
                    self.tell(INFO, text)
                if change.get("armed"):
                    self.announce("HOME_POSITION")  # as ArduPilot; QGroundControl waits for it
            done(reason)

        return told

    def _steer(self, deflections: Sequence[float]) -> None:
        if self.autopilot.is_there:
            self.autopilot.command("pilot", {"u": list(deflections)})

    def _button_actions(self) -> Mapping[int, Callable[[], None]]:
        def failed(reason: str) -> None:
            if reason:
                self.tell(WARNING, reason)

        def enter(name: str) -> Callable[[], None]:
            return lambda: self.set_mode(BY_NAME[name], failed)

        def toggle() -> None:
            if self.readings.state().armed:
                self.disarm(failed)
            else:
                self.arm(False, failed)

        return {
            **self.payload.actions(lambda: self.parameters.value("JS_LIGHTS_STEPS")),
            **{number: enter(name) for number, name in _BUTTON_MODES.items()},
            2: toggle,
            3: lambda: self.arm(False, failed),
            4: lambda: self.disarm(failed),
        }


def _thrusters(context: AdapterContext, vehicle: str) -> int:
    """How many thrusters a vehicle has, commanded together."""
    ports = (
        port for path, port in context.ports.items() if port.kind == "thrusters" and path.startswith(f"{vehicle}/")
    )
    return sum(port.fields[0].size for port in ports)


def _epoch_ns(context: AdapterContext) -> int:
    world = context.describe("").get("world")
    text = world.get("epoch_utc") if isinstance(world, dict) else None
    if not isinstance(text, str):
        return 0
    epoch = datetime.fromisoformat(text.replace("Z", "+00:00"))
    if epoch.tzinfo is None:
        epoch = epoch.replace(tzinfo=timezone.utc)
    return round(epoch.timestamp()) * 1_000_000_000

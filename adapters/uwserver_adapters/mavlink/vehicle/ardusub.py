"""The vehicle's side of MAVLink as one state machine: takes messages and the time, and sends messages. Knows no socket."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from uwserver.adapter import AdapterContext
from uwserver.ports import Event
from uwserver_adapters.mavlink.vehicle.bridge import CRITICAL, ERROR, INFO, NOTICE, WARNING, Bridge, Done, Home, Send
from uwserver_adapters.mavlink.vehicle.commands import Commands
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.vehicle.missions import Missions
from uwserver_adapters.mavlink.vehicle.modes import BY_NAME, CUSTOM_FRAME, FRAMES, banner, in_words_of_mavlink
from uwserver_adapters.mavlink.vehicle.outputs import Outputs, Payload, wired
from uwserver_adapters.mavlink.vehicle.parameters import SIZE, Files, Parameters, message, parse
from uwserver_adapters.mavlink.vehicle.pilot import Failsafes, Pilot
from uwserver_adapters.mavlink.vehicle.setpoints import SetPoints
from uwserver_adapters.mavlink.vehicle.telemetry import Telemetry
from uwserver_adapters.mavlink.vehicle.tunnel import Tunnel
from uwserver_adapters.mavlink.wire.channel import GROUPS, POSITION, Channel
from uwserver_adapters.mavlink.wire.codec import seconds
from uwserver_adapters.mavlink.wire.dialect import Dialect, MavlinkMessage

HEARTBEAT_S = 1.0
"""Wall time between two heartbeats."""
_SEVERITIES = {
    "watchdog": NOTICE, "fault": WARNING, "conflict": WARNING, "diverged": CRITICAL, "adapter_failed": ERROR, "shutdown": WARNING,
}  # fmt: skip
_TOLD = ("mode ", "armed", "disarmed", "fail-safe: ", "mission: item ")
"""Beginnings of the autopilot's texts that are not passed on, because heartbeats and ArduSub's own texts say the same."""
_BUTTON_MODES = {
    5: "MANUAL", 6: "STABILIZE", 7: "ALT_HOLD", 8: "POSHOLD", 9: "AUTO", 11: "GUIDED", 12: "ACRO", 13: "SURFTRAK",
}  # fmt: skip


class ArduSub:
    """One vehicle as ground stations see it. Runs on the loop thread.

    Args:
        config: the adapter's table.
        context: the world.
        name: name of the vehicle in the world.
        dialect: the messages.
        send: sends messages.

    Attributes:
        bridge: the way to ground stations and the world.
        tunnel: the way to its modem.
        parameters, payload, outputs, pilot, failsafes, missions, setpoints, telemetry, commands: its other parts.
    """

    def __init__(self, config: MavlinkConfig, context: AdapterContext, name: str, dialect: Dialect, send: Send) -> None:
        self._own_ports = re.compile(rf'"{re.escape(name)}/(?:autopilot/)?([^"]*)"')
        self._voice, self._sticks = f'"{name}/autopilot" ', f'"{name}/autopilot/pilot"'
        self._config = config
        self._beat_at = -HEARTBEAT_S
        trial = context.ports.get(f"{name}/autopilot/test")
        motors, patience_s = (trial.fields[0].size, trial.timeout_s or 0.0) if trial is not None else (0, 0.0)
        frame, frame_name = FRAMES.get(_thrusters(context, name), CUSTOM_FRAME)
        given = {"MAV_SYSID": config.system, "FRAME_CONFIG": frame, **wired(motors), **config.parameters}
        self.parameters = Parameters(given)
        self.bridge = bridge = Bridge(context, name, Home(config.origin_deg), dialect, send)
        self.payload = Payload(context, name)
        self.tunnel = Tunnel(context, name, bridge)
        self.outputs = Outputs(self.parameters, self.payload, motors, patience_s)
        self.pilot = Pilot(self.parameters, self._steer, self._button_actions(), lambda text: bridge.tell(INFO, text))
        self.failsafes = Failsafes(bridge, self.parameters, self.pilot, self.disarm)
        self.missions = Missions(bridge)
        self.setpoints = SetPoints(bridge)
        self.telemetry = Telemetry(
            bridge,
            context.world.epoch_ns,
            banner(str(context.hello().get("server", "uwserver")), frame_name),
            self.failsafes,
            self.missions,
            self.pilot,
            self.outputs,
            self.payload,
        )
        self.commands = Commands(
            bridge, self.arm, self.disarm, self.telemetry, self.missions, self.setpoints, self.outputs, self.payload
        )
        self._files = Files({"@PARAM/param.pck": lambda options: self.parameters.packed("withdefaults=1" in options)})
        self._verbs = self._dispatch()

    def _dispatch(self) -> Mapping[str, Callable[[MavlinkMessage, Channel, float], None]]:
        config, missions, setpoints = self._config, self.missions, self.setpoints
        return {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": lambda m, c, _: self.commands.take(m, c),
            "COMMAND_INT": lambda m, c, _: self.commands.take(m, c),
            "SET_MODE": lambda m, c, _: self.commands.mode_message(m, c),
            "MANUAL_CONTROL": lambda m, _, __: self._steered(m, self.pilot.steer, m.integer("target")),
            "RC_CHANNELS_OVERRIDE": lambda m, _, __: self._steered(m, self.pilot.override, config.system),
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
            "TUNNEL": lambda m, _, __: self.tunnel.take(m),
            "TIMESYNC": lambda m, c, _: self._timesync(m, c),
        }

    # -- in ---------------------------------------------------------------------------------------------------------------------------

    @property
    def _now(self) -> float:
        return seconds(self.bridge.readings.t_ns)

    def take(self, message: MavlinkMessage, channel: Channel, now: float) -> None:
        """Take a message that is addressed to us, or to all.

        Args:
            message: the message.
            channel: the channel on which it came.
            now: wall time, s.
        """
        verb = self._verbs.get(message.name)
        if verb is not None:
            verb(message, channel, now)

    def _heartbeat(self, message: MavlinkMessage, _: Channel, __: float) -> None:
        if message.system == self.parameters.gcs_system:
            self.failsafes.heard_gcs(self._now)

    def _steered(self, message: MavlinkMessage, use: Callable[[MavlinkMessage, float], None], target: int) -> None:
        """Use sticks if they come from the station in charge and are for this system. They count as a heartbeat too."""
        if message.system != self.parameters.gcs_system or target != self._config.system:
            self.bridge.counters["not_in_charge"] += 1
            return
        self.failsafes.heard_gcs(self._now)
        use(message, self._now)

    def _param_read(self, message: MavlinkMessage, channel: Channel) -> None:
        index = message.integer("param_index")
        name = self.parameters.at(index) if index >= 0 else message.text("param_id")
        if name in self.parameters.names:
            self.bridge.send("PARAM_VALUE", self.parameters.message(str(name)), channel)

    def _param_set(self, message: MavlinkMessage) -> None:
        """Set a parameter and send its value to all. An unknown name gets no answer, as in ArduPilot."""
        name = message.text("param_id")
        if name not in self.parameters.names:
            self.bridge.counters["refused"] += 1
            return
        if not self.parameters.set(name, message.number("param_value")):
            self.bridge.counters["refused"] += 1
            self.bridge.tell(WARNING, f"{name} cannot have that value")
        elif name == "JS_GAIN_DEFAULT":
            self.pilot.gain = self.parameters.value(name)
        self.bridge.send("PARAM_VALUE", self.parameters.message(name, is_answer_to_set=True))

    def _file_transfer(self, message_: MavlinkMessage, channel: Channel) -> None:
        request = parse(bytes(int(entry) for entry in message_.array("payload")[:SIZE]))
        answer = self._files.answer(message_.sender, request)
        channel.backlog.append(message(payload, message_.sender) for payload in answer)

    def _data_stream(self, message: MavlinkMessage, channel: Channel) -> None:
        rate = message.integer("req_message_rate") if message.integer("start_stop") else 0
        group = message.integer("req_stream_id")
        if not channel.streams.set_group(group, rate):
            self.bridge.counters["refused"] += 1
        elif rate and group in (0, POSITION):
            # QGroundControl does not request the home of a submarine, but plans no mission before it knows it.
            for fields in self.telemetry.build("HOME_POSITION"):
                self.bridge.send("HOME_POSITION", fields, channel)

    def _mission_current(self, message: MavlinkMessage) -> None:
        if not self.missions.set_current(message.integer("seq")):
            self.bridge.counters["refused"] += 1

    def _set_origin(self, message: MavlinkMessage) -> None:
        if message.integer("target_system") not in (0, self._config.system):
            return
        if self.bridge.home.set_origin(message.integer("latitude"), message.integer("longitude")):
            self.telemetry.announce("GPS_GLOBAL_ORIGIN")
            self.bridge.tell_home()
        else:
            self.bridge.counters["refused"] += 1

    def _timesync(self, message: MavlinkMessage, channel: Channel) -> None:
        if message.integer("tc1") == 0:
            # A tc1 of 0 would make the answer another question.
            answer = {"tc1": max(1, self.bridge.readings.t_ns), "ts1": message.integer("ts1")}
            self.bridge.send("TIMESYNC", answer, channel)

    # -- arming -----------------------------------------------------------------------------------------------------------------------

    def arm(self, force: bool, done: Done) -> None:
        """Arm. The last sticks do not count, because they were moved while the vehicle was disarmed."""
        self.pilot.forget()
        self.pilot.neutral()
        self.outputs.begin_test()

        def on_done(reason: str) -> None:
            if not reason:
                self.bridge.tell(INFO, "Arming motors")
                self.bridge.tell_home()  # as ArduPilot does; QGroundControl waits for it
            done(reason)

        self.bridge.switch("arm", {"force": force}, on_done, armed=True)

    def disarm(self, done: Done) -> None:
        """Disarm, with all sticks released."""
        self.pilot.neutral()

        def on_done(reason: str) -> None:
            if not reason:
                self.bridge.tell(INFO, "Disarming motors")
            done(reason)

        self.bridge.switch("disarm", {}, on_done, armed=False)

    # -- out --------------------------------------------------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """Do what depends on wall time: heartbeat, uploads, fail-safes. Called about 20 times per second.

        Args:
            now: wall time, s.
        """
        self.bridge.readings.forget()
        if now - self._beat_at >= HEARTBEAT_S:
            self._beat_at = now if now - self._beat_at > 2 * HEARTBEAT_S else self._beat_at + HEARTBEAT_S
            self.telemetry.announce("HEARTBEAT")
        self.missions.tick(now)
        self.pilot.tick(self._now)
        self.payload.tick()
        self.failsafes.tick(self._now)
        self.bridge.readings.count_turns()

    def advance(self, t_ns: int) -> None:
        """Note that simulation time went on, and samples came."""
        self.bridge.readings.t_ns = t_ns

    def take_event(self, event: Event) -> None:
        """Tell the pilot of an event of the world."""
        if event.event == "ports_changed":
            self.bridge.readings.open_ports()
            self.tunnel.open_ports()
        elif event.event == "reset":
            self.bridge.readings.t_ns = event.t_ns
            self.bridge.readings.forget()
            self.failsafes.restart()
            self.pilot.tick(self._now)
        if self._is_told_otherwise(event):
            return
        # Without our own name most texts fit in one message. Cockpit does not join the pieces of a longer one.
        text = event.text.removeprefix(self._voice) or event.event
        text = in_words_of_mavlink(self._own_ports.sub(r"\1", text))
        self.bridge.tell(_SEVERITIES.get(event.event, INFO), text)

    def _is_told_otherwise(self, event: Event) -> bool:
        """Return whether ground stations learn of an event in another way, or it is a text of another vehicle's autopilot."""
        if event.event == "autopilot":
            return not event.text.startswith(self._voice) or event.text.removeprefix(self._voice).startswith(_TOLD)
        # The pilot port returns to neutral after a second, which is not yet a loss. The fail-safe announces a loss.
        return event.event == "watchdog" and self._sticks in event.text

    def default_rates(self) -> Mapping[int, float]:
        """Return the stream rates (Hz) of a new channel, by group."""
        return {group: self.parameters.value(f"MAV1_{suffix}") for group, (suffix, _) in GROUPS.items()}

    def _steer(self, deflections: Sequence[float]) -> None:
        if self.bridge.autopilot.is_there:
            self.bridge.autopilot.command("pilot", {"u": list(deflections)})

    def _button_actions(self) -> Mapping[int, Callable[[], None]]:
        failed = self.bridge.failure_teller()

        def enter(name: str) -> Callable[[], None]:
            return lambda: self.bridge.set_mode(BY_NAME[name], failed)

        def toggle() -> None:
            if self.bridge.readings.state().armed:
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
    """Return how many thrusters a vehicle has that are commanded together."""
    ports = (
        port for path, port in context.ports.items() if port.kind == "thrusters" and path.startswith(f"{vehicle}/")
    )
    return sum(port.fields[0].size for port in ports)

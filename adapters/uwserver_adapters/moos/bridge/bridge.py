"""The bridge between MOOS variables and the world, which all three adapters share. Nothing here knows a socket."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import msgspec

from uwserver.adapter import (
    AdapterContext,
    CannotServe,
    Conversation,
    port_of_kind,
    vehicle_of,
    vehicles_of,
)
from uwserver.ports import Buffer, Event, Fault, Field, Port, Progress, Refused, Reply, Sample, matches
from uwserver_adapters.moos.bridge.calls import Answer, Calls
from uwserver_adapters.moos.bridge.mixing import Mixer
from uwserver_adapters.moos.bridge.names import Outlet, given, number, variable
from uwserver_adapters.moos.bridge.navigation import Decimator, Navigation
from uwserver_adapters.moos.bridge.pilot import Pilot
from uwserver_adapters.moos.bridge.quota import Faults, Quota
from uwserver_adapters.moos.bridge.report import APPCAST, APPCAST_REQUEST, AppCasts, NodeReports, Pace
from uwserver_adapters.moos.bridge.usm import ELSEWHERE, FREE, MOMENTARY, UsmInputs
from uwserver_adapters.moos.clock import CREDIBLE_S
from uwserver_adapters.moos.codec import Fix, seconds
from uwserver_adapters.moos.config import BridgeTable
from uwserver_adapters.moos.wire import TEXT_LIMIT, readable

DESTINATION, TEXT, BINARY = "ACOMMS_TRANSMIT_DEST", "ACOMMS_TRANSMIT_DATA", "ACOMMS_TRANSMIT_DATA_BINARY"
SOURCE_ID, DEST_ID, DATA = "ACOMMS_RECEIVED_SOURCE_ID", "ACOMMS_RECEIVED_DEST_ID", "ACOMMS_RECEIVED_DATA"
CALL = "UWSERVER_CALL"
REPLY = "UWSERVER_REPLY"
ERROR = "UWSERVER_ERROR"
EVENT = "UWSERVER_EVENT"
TIME = "UWSERVER_TIME"
MODE = "SIMULATION_MODE"
STATUS = "world/status"
CALLS_PER_S = 50
"""Most calls that one client may begin in a second."""
STATES_PER_S = 200
"""Most resets, currents, pauses and the like: enough for a current ten times a second at warp 20."""
COMMANDS_PER_S = 4000
"""Most writes of actuators' variables: enough for three of them 20 times a second at warp 60."""


class Acomms:
    """The acoustic modem of a vehicle. It sends to the last destination that was written, or to all.

    Attributes:
        names: variables that mean something here; none without a modem.
        received, send: paths of the modem's ports; "" without a modem.
    """

    def __init__(self) -> None:
        self._destination: float | None = None
        self.find({}, "")

    def find(self, ports: Mapping[str, Port], vehicle: str) -> None:
        """Look for the first acoustic modem of a vehicle; "" stands for no vehicle."""
        found = [p for p in ports.values() if p.message == "AcousticPacket" and p.path.startswith(f"{vehicle}/")]
        port = next((port for port in found if vehicle and port.direction == "sensor"), None)
        self.names = () if port is None else (DESTINATION, TEXT, BINARY)
        self.received = "" if port is None else port.path
        self.send = "" if port is None else port.path.removesuffix("received") + "send"
        self._fields = () if port is None else tuple([field.name for field in port.fields])

    def hear(self, name: str, value: float | str | bytes) -> dict[str, object] | None:
        """Return the command that a variable causes; None for a destination, which is only kept.

        Raises:
            Refused: a text as destination, or a number as data.
        """
        if name == DESTINATION:
            if not isinstance(value, float | int):
                raise Refused("bad_argument", f"{DESTINATION} must be a number: an address, or -1 for all", name)
            self._destination = None if value < 0 else float(value)
            return None
        if isinstance(value, float | int):
            raise Refused("bad_argument", f"{name} must be a text, not a number: there is nothing to send", name)
        data = value.encode() if isinstance(value, str) else value
        return {"data": data} if self._destination is None else {"data": data, "destination": self._destination}

    def pairs(self, sample: Sample) -> list[tuple[str, float | str]]:
        """Return the variables of a message that was received: the data last, after all that describes them. Bytes that are no printable ASCII text
        become JSON."""
        told = dict(zip(self._fields, sample.value, strict=True))
        data = told["data"]
        if told["event"] != "data" or not isinstance(data, Buffer):
            return []
        text = data.data.decode("latin-1")
        plain = text if text.isascii() and text.isprintable() else msgspec.json.encode(data).decode()
        return [(SOURCE_ID, float(str(told["source"]))), (DEST_ID, float(str(told["destination"]))), (DATA, plain)]


Pairs = Sequence[tuple[str, float | str]]


_Route = tuple[Quota | None, Callable[[str, Any, str], None]]
"""The limit of a variable, and what obeys it: gets name, value and client."""


class Bridge:
    """Publishes samples as variables, and obeys variables that others write. Loop thread.

    Args:
        table: what to publish and to obey.
        context: the world.
        post: publishes variables that belong together.
        listen: asks for writes of further variables.
        source: name by which the world knows the commands of this connection.
        steady: a clock that never jumps, s.

    Attributes:
        appcasts: makes the appcasts; its `node` is the name of the community.

    Raises:
        CannotServe: the table names what is not there.
    """

    def __init__(
        self,
        table: BridgeTable,
        context: AdapterContext,
        post: Callable[[Pairs], None],
        listen: Callable[[Sequence[str]], None],
        source: str,
        steady: Callable[[], float],
    ) -> None:
        self.appcasts = AppCasts()
        self._steady = steady
        self._pace = Pace()
        self._faults = Faults(context.stats, lambda text: post([(ERROR, text)]), steady)
        self._call_quota, self._state_quota = Quota(CALLS_PER_S, steady), Quota(STATES_PER_S, steady)
        self._command_quota = Quota(COMMANDS_PER_S, steady)
        self._t_s = 0.0
        self._table = table
        self._context = context
        self._post = post
        self._listen = listen
        self._outlets: dict[str, Outlet] = {}
        self._decimator = Decimator(table.rate_hz)
        self._seen: dict[str, float] = {}
        self._passed_over: dict[str, float | None] = {}
        self._vehicle_name = vehicle = self._vehicle()
        ports = context.ports
        self._acomms = Acomms()
        self._mixer = Mixer(table.commands, ports, vehicle)
        self._nav = None if table.nav is None else Navigation(table.nav, ports, vehicle)
        self._calls = Calls(context)
        self._reports = NodeReports(table.externals)
        self._peer = Conversation(context, source)
        fix = self._nav.fix if self._nav is not None else Fix()
        teleport = port_of_kind("teleport", ports, vehicle)
        self._pilot = self._make_pilot()
        self._usm = UsmInputs(
            self._peer,
            teleport,
            fix,
            self._neutral,
            self._pilot.override,
            lambda name, value: post([(name, value)]),
            listen,
        )
        self._states = frozenset(self._usm.names) - frozenset(MOMENTARY)
        self._direct: dict[str, tuple[Port, Field]] = {}
        self._routes: dict[str, _Route] = {}
        self._commanded: dict[str, str] = {}
        self._open_ports()

    def _vehicle(self) -> str:
        """Return the vehicle of the table; "" for none, where the table needs none and there are several."""
        table, ports = self._table, self._context.ports
        belongs = table.vehicle is not None or table.nav is not None or bool(table.commands)
        return vehicle_of(table.vehicle, ports) if belongs or len(vehicles_of(ports)) == 1 else ""

    def _make_pilot(self) -> Pilot:
        table = self._table
        pilot = Pilot(table.pid, table.hold_depth_m)
        missing = [name for name in pilot.drives if name not in self._mixer.names]
        if pilot.drives and self._nav is None:
            raise CannotServe("pid and hold_depth_m: give a `nav` table too, which says where the vehicle is")
        if missing:
            raise CannotServe(f"pid and hold_depth_m: `commands` lacks {', '.join(missing)}")
        return pilot

    def _open_ports(self) -> None:
        table = self._table
        self._outlets.clear()
        self._direct.clear()
        self._acomms.find(self._context.ports, self._vehicle_name)
        for path, port in self._context.ports.items():
            if port.direction == "actuator":
                self._direct.update({variable(path, field.name): (port, field) for field in port.fields})
            elif any(matches(pattern, path) for pattern in table.publish):
                self._outlets[path] = Outlet(port, table.vectors, table.on_change)
        # The first of these groups that has a name decides.
        groups: tuple[tuple[Collection[str], _Route], ...] = (
            (self._acomms.names, (self._command_quota, self._obey_modem)),
            (self._pilot.hears, (None, lambda name, value, _: self._pilot.hear(name, number(name, value), self._t_s))),
            (self._mixer.names, (self._command_quota, self._obey_mixed)),
            (self._direct, (self._command_quota, self._obey_direct)),
            (self._reports.names, (self._command_quota, self._obey_report)),
            ((CALL,) if table.services else (), (self._call_quota, self._obey_call)),
            ((APPCAST_REQUEST,), (None, lambda _, value, __: self.appcasts.ask(str(value), self._steady()))),
            (FREE if table.usm else (), (None, self._obey_usm)),
            (self._usm.names if table.usm else (), (self._state_quota, self._obey_usm)),
        )
        self._routes = {name: route for names, route in reversed(groups) for name in names}

    @property
    def listens_to(self) -> tuple[str, ...]:
        """Variables that mean something here."""
        return tuple(self._routes)

    def begin(self, community: str = "") -> None:
        """Begin in a community that was joined, for the first time or again."""
        self.appcasts.node = community
        self._passed_over.clear()
        self._pilot.reset()
        self._post([(MODE, "TRUE")])

    def attend(self) -> None:
        """Publish the state of the world; to be called each second."""
        self._faults.flush()
        wall_s = self._steady()

        def on_status(answer: Reply | Progress) -> None:
            said = answer.result if isinstance(answer, Reply) else None
            if not self.subscriptions:  # then no sample tells the time
                self._t_s = seconds(answer.t_ns)
            if isinstance(said, dict) and (pairs := self._pace.observe(said, wall_s, self._context.name)):
                self._post(pairs)

        self._context.call(STATUS, {}, self._peer.source, on_status)
        if self.appcasts.due(wall_s):
            self._post([(APPCAST, self.appcasts.text(self._report(), self._pace))])

    def _report(self) -> list[str]:
        """Return the lines of an appcast."""
        world = self._context.world
        known = () if self._nav is None else self._nav.known()
        return [
            f"Scenario: {world.scenario}",
            f"Mode: {world.mode}, speed {world.speed:g}, reached {self._pace.factor:.3g}",
            f"Simulation time: {self._t_s:.2f} s",
            f"Enabled: {str(self._usm.is_enabled).lower()}",
            *self._pilot.report(),
            *(f"{name}: {value:.6g}" for name, value in known if isinstance(value, float)),
        ]

    # -- out ------------------------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports that become variables."""
        beside = self._nav.subscriptions if self._nav is not None else ()
        return {*self._outlets, *beside, *filter(None, [self._acomms.received])}

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Publish all variables of a tick together."""
        pairs: list[tuple[str, float | str]] = []
        self._t_s = seconds(samples[-1].t_sent_ns) if samples else self._t_s
        for sample in samples:
            outlet = self._outlets.get(sample.port)
            if outlet is not None and self._decimator.is_due(sample.port, sample.t_sent_ns):
                pairs += outlet.pairs(sample)
            if sample.port == self._acomms.received:
                pairs += self._acomms.pairs(sample)
        if self._nav is not None:
            told = self._nav.pairs(samples)
            if told and self._usm.is_enabled:
                pairs += told
                pairs += self._steer(self._nav.fix)
        if pairs:
            pairs.append((TIME, self._t_s))
            self._post(pairs)

    def _steer(self, fix: Fix) -> list[tuple[str, float]]:
        """Let the autopilot of the adapter act. Returns the variables that it has written."""
        outputs = self._pilot.outputs(fix, self._t_s)
        paths = dict.fromkeys(path for name, value in outputs.items() for path in self._mixer.take(name, value))
        for path in paths:
            self._command(path, self._mixer.command(path), self._peer.source)
        return list(outputs.items())

    def put_event(self, event: Event) -> None:
        """Follow an event, and publish it."""
        if event.event == "ports_changed":
            before = frozenset(self._direct)
            self._open_ports()
            if self._nav is not None and (missing := self._nav.follow(self._context.ports)):
                self._context.stats.last_error = missing
            if come := [name for name in self._direct if name not in before]:
                self._listen(come)
        elif event.event == "reset":
            self._decimator.reset()
            if self._nav is not None:
                self._nav.reset()
            self._usm.forget()
            self._pilot.reset()
        self._post([(EVENT, msgspec.json.encode(event).decode())])

    def _reply(self, answer: Answer) -> None:
        self._post([(REPLY, msgspec.json.encode(answer).decode())])

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def take(self, written: Iterable[tuple[str, float | str | bytes, str, float]], since: float = -math.inf) -> None:
        """Obey what others wrote, all together. Each fault is told in UWSERVER_ERROR.

        The database keeps values from before we came. They are no commands any more, but states (a current, a pause) still hold, once.

        Args:
            written: name, value, client and MOOS time.
            since: MOOS time at which we came.
        """
        for name, value, source, time in written:
            source, value = readable(source), self._read(name, value)
            if time < since and (name not in self._states or time <= self._seen.get(name, -math.inf)):
                if since - time > CREDIBLE_S:  # a little earlier it may have been under way while we came
                    self._pass_over(name, value, source, time)
                continue
            self._seen[name] = time
            try:
                self._obey(name, value, source)
            except Refused as refused:
                self._faults.note(name, value, source, refused.fault)
            except ValueError as error:
                self._faults.note(name, value, source, Fault("bad_argument", str(error), name))
        commanded, self._commanded = self._commanded, {}
        for path, source in commanded.items():
            self._command(path, self._mixer.command(path), source)

    def _is_packed(self, name: str) -> bool:
        """Return whether a variable goes to a field of bytes or a buffer."""
        return name in self._acomms.names or (name in self._direct and self._direct[name][1].is_packed)

    def _read(self, name: str, value: float | str | bytes) -> float | str | bytes:
        """Return the value with a binary one as text, unless it goes to a packed field or is too long."""
        if isinstance(value, str):
            return readable(value)
        if not isinstance(value, bytes) or self._is_packed(name) or len(value) > TEXT_LIMIT:
            return value
        return value.decode("utf-8", "replace")

    def _pass_over(self, name: str, value: float | str | bytes, source: str, time: float) -> None:
        """Note an old write. A kept value comes once; one that comes again was written now, by a clock that is far behind, which is told once."""
        before = self._passed_over.setdefault(name, time)
        if before is not None and time != before:
            self._passed_over[name] = None
            text = "written by a clock that is far behind: is its MOOSTimeWarp ours? It is not obeyed"
            self._faults.note(name, value, source, Fault("bad_argument", text, name))

    def _obey(self, name: str, value: float | str | bytes, source: str) -> None:
        quota, obey = self._routes.get(name, (None, self._obey_elsewhere))
        if quota is not None and not quota.take(source):
            if quota.is_first_too_many(source):
                fault = Fault("overload", f"more than {quota.most} in a second: what is above is not carried out", name)
                if name == CALL and not isinstance(value, bytes):
                    self._calls.take(str(value), source, self._reply, fault)
                else:
                    self._faults.note(name, value, source, fault)
            return
        if isinstance(value, bytes) and not self._is_packed(name):
            raise Refused("too_large", f"a text of {len(value)} bytes: the longest has {TEXT_LIMIT}", name)
        obey(name, value, source)

    def _obey_modem(self, name: str, value: float | str | bytes, source: str) -> None:
        if (message := self._acomms.hear(name, value)) is not None:
            self._command(self._acomms.send, message, source, name)

    def _obey_mixed(self, name: str, value: float | str, source: str) -> None:
        if self._usm.is_enabled and self._pilot.admits(name, number(name, value), self._t_s):
            self._commanded.update(dict.fromkeys(self._mixer.take(name, number(name, value)), source))

    def _obey_direct(self, name: str, value: float | str | bytes, source: str) -> None:
        port, field = self._direct[name]
        content = value if isinstance(value, bytes) or field.type == "str" else given(value)
        self._command(port.path, {field.name: content}, source, name)

    def _obey_report(self, name: str, value: float | str, source: str) -> None:
        for path, told in self._reports.commands(name, value):
            self._command(path, told, source, name)

    def _obey_call(self, _: str, value: float | str, source: str) -> None:
        self._calls.take(str(value), source, self._reply)

    def _obey_usm(self, name: str, value: float | str, source: str) -> None:
        self._usm.take(name, value, source, lambda fault: self._faults.note(name, value, source, fault))

    def _obey_elsewhere(self, name: str, value: float | str, _: str) -> None:
        if self._table.usm and name in ELSEWHERE:
            self._usm.hear_elsewhere(name, value)

    def _neutral(self) -> None:
        self._pilot.rest()
        for path in self._mixer.neutral():
            self._command(path, self._mixer.command(path), self._peer.source)

    def _command(self, path: str, value: Mapping[str, object], source: str, name: str = "") -> None:
        name = name or variable(path)

        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                self._faults.note(name, "", source, reply.fault)

        try:
            # All clients of a community are one source for the world: helm, autopilot and operator take turns by the rules of MOOS.
            self._peer.command(path, value, on_answer)
        except Refused as refused:
            self._faults.note(name, "", source, refused.fault)

    def close(self) -> None:
        """Cancel all calls."""
        self._calls.close()
        self._peer.close()

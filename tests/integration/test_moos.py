"""MOOS programs that others wrote, against a running server.

Opt-in: `UWSERVER_MOOS_BIN` names the folder with MOOSDB, uPokeDB, pHelmIvP ... of a moos-ivp tree (its missions are looked for beside it),
`UWSERVER_PYMOOS_PYTHON` a Python that has pymoos (default: this one, if it has). MOOSDB listens on all interfaces and cannot be told otherwise:
run these in a network namespace (``unshare -n``, loopback up).
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.wire import MoosMessage

PATIENCE_S = 120.0
BIN = Path(os.environ["UWSERVER_MOOS_BIN"]) if os.environ.get("UWSERVER_MOOS_BIN") else None
PYMOOS = os.environ.get("UWSERVER_PYMOOS_PYTHON") or (sys.executable if importlib.util.find_spec("pymoos") else "")
MISSIONS = BIN.resolve().parent / "ivp" / "missions" if BIN else None

needs_moos = pytest.mark.skipif(BIN is None, reason="UWSERVER_MOOS_BIN is not set: a folder with MOOSDB and uPokeDB")
needs_pymoos = pytest.mark.skipif(
    not PYMOOS, reason="pymoos is not installed here, and UWSERVER_PYMOOS_PYTHON is not set"
)
needs_missions = pytest.mark.skipif(
    MISSIONS is None or not (MISSIONS / "s1_alpha").is_dir(),
    reason="UWSERVER_MOOS_BIN is not set, or has no ivp/missions beside it",
)

SCENARIO = """
schema = 1
[world.clock]
speed = {warp}
[vehicles.auv]
model = "{hull}"
position_ned_m = [-20, 0, {depth}]
attitude_rpy_deg = [0, 0, 180]
[vehicles.auv.truth]
rate_hz = 20
[server]
metrics = false
[adapters.moos]
kind = "{kind}"
truth = true
{settings}
vehicle = "auv"
publish = ["auv/depth"]
{more}[{table}.nav]
origin_deg = [43.8253, -70.3304]
[{table}.commands]
{commands}"""


HOLD = "hold_depth_m = 0.0\n"
DEEPEST_M = 2.0

HULLS = {  # as docs/how-to/moos.md has them
    # Fins: top, starboard, bottom, port.
    "lauv": """
DESIRED_THRUST = [{ port = "propeller", field = "speed_radps", full = 395.0 }]
DESIRED_RUDDER = [{ port = "fins", field = "angle_rad", full_deg = [100.0, 0.0, 100.0, 0.0], limit = 20.0 }]
DESIRED_ELEVATOR = [{ port = "fins", field = "angle_rad", full_deg = [0.0, 100.0, 0.0, 100.0], limit = 20.0 }]
""",
    "remus100": """
DESIRED_THRUST = [{ port = "propeller", field = "speed_radps", full = 312.0 }]
DESIRED_RUDDER = [{ port = "rudder", field = "angle_rad", full_deg = 100.0 }]
DESIRED_ELEVATOR = [{ port = "stern_planes", field = "angle_rad", full_deg = 100.0 }]
""",
}
PERCENT = """
DESIRED_THRUST = [{ port = "propeller", field = "speed_radps", full = 159.7 }]
DESIRED_RUDDER = [{ port = "rudder", field = "angle_rad", full_deg = 15.0 }]
DESIRED_ELEVATOR = [{ port = "stern_planes", field = "angle_rad", full_deg = 15.0 }]
"""
"""Of the REMUS 100, as percentages of what its actuators can do; `GAINS` fit."""
GAINS = {
    "speed_factor": "39",
    "yaw_pid_kp": "6.0",
    "yaw_pid_kd": "2.0",
    "yaw_pid_ki": "2.0",
    "pitch_pid_kp": "10.0",
    "pitch_pid_kd": "6.7",
    "maxelevator": "100",
}


def scenario(
    port: int,
    kind: str = "moosdb",
    warp: float = 1.0,
    depth: float = 5.0,
    hull: str = "lauv",
    commands: str = HULLS["lauv"],
    more: str = "",
) -> str:
    """One vehicle, and MOOS: `moos` joins a MOOSDB, `moosdb` is one."""
    if kind == "moos":
        table, settings = "adapters.moos.communities.alpha", f"[adapters.moos.communities.alpha]\nport = {port}"
    else:
        table, settings = "adapters.moos.bridge", f'port = {port}\ncommunity = "alpha"\n[adapters.moos.bridge]'
    return SCENARIO.format(
        warp=warp, depth=depth, hull=hull, kind=kind, settings=settings, table=table, commands=commands, more=more
    )


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Processes:
    """Programs of a test; each in a group of its own, all ended with it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._running: list[subprocess.Popen[str]] = []

    def start(self, *command: str | Path, program: Path | None = None) -> subprocess.Popen[str]:
        log = self.folder / f"{Path(command[0]).name}{len(self._running)}.log"
        with log.open("w") as output:
            started = subprocess.Popen(
                [str(word) for word in command], cwd=self.folder, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                text=True, start_new_session=True, executable=program,
            )  # fmt: skip
        self._running.append(started)
        return started

    def moos(self, program: str, *words: str | Path) -> subprocess.Popen[str]:
        assert BIN is not None
        # A MOOS program looks for its settings under the name by which it was called.
        return self.start(program, *words, program=BIN / program)

    def serve(self, text: str) -> subprocess.Popen[str]:
        (self.folder / "sim.toml").write_text(text)
        server = self.start(sys.executable, "-m", "uwserver", "run", "sim.toml")
        log = self.folder / f"{Path(sys.executable).name}{len(self._running) - 1}.log"
        until(lambda: "Ctrl-C" in log.read_text() or server.poll() is not None, "the server runs", 120.0)
        assert server.poll() is None, log.read_text()
        return server

    def end(self) -> None:
        for process in reversed(self._running):
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            process.wait(PATIENCE_S)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Processes]:
    processes = Processes(tmp_path)
    try:
        yield processes
    finally:
        processes.end()


class Watcher:
    """A MOOS client that only looks on, with a blocking socket."""

    def __init__(self, port: int, *names: str) -> None:
        self.values: dict[str, Any] = {}
        self.sources: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.most: dict[str, float] = {}
        self._socket = until(lambda: _connected(port), "a database", 20.0)
        hello = MoosMessage(wire.DATA, wire.ASYNCHRONOUS, data=b"watcher", kind=wire.STRING, time=1.0)
        self._decoder = wire.Decoder()
        self._socket.sendall(wire.HELLO + wire.packet([wire.encode(hello)]))
        self._send(*(MoosMessage(wire.REGISTER, name, 0.0, src="watcher") for name in names))
        self._beat = 0.0

    def _send(self, *messages: MoosMessage) -> None:
        self._socket.sendall(wire.packet([wire.encode(message) for message in messages]))

    def notify(self, time_s: float = 1e12, **values: float | str) -> None:
        self._send(*(wire.notify(key, value, time_s, "watcher") for key, value in values.items()))

    def read(self) -> None:
        if time.monotonic() > self._beat:
            self._beat = time.monotonic() + 1.0
            # MOOSDB delivers mail of its own (DB_EVENT) only when somebody writes something.
            self._send(
                MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0), wire.notify("WATCHING", 1.0, time.time(), "watcher")
            )
        with contextlib.suppress(TimeoutError):
            data = self._socket.recv(1 << 16)
            assert data, "the database closed the connection"
            self._decoder.receive(data)
        while (event := self._decoder.next_event()) is not None:
            if isinstance(event, wire.Reading):
                continue
            assert isinstance(event, wire.Packet), event
            for message in event.messages:
                if message.type == wire.NOTIFY:
                    self.values[message.key] = message.value
                    self.sources[message.key] = message.src
                    if message.kind == wire.DOUBLE:
                        self.most[message.key] = max(message.number, self.most.get(message.key, message.number))
                    self.counts[message.key] = self.counts.get(message.key, 0) + 1

    def until(self, condition: Callable[[dict[str, Any]], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
        end = time.monotonic() + patience_s
        while not (found := condition(self.values)):
            assert time.monotonic() < end, f"not within {patience_s:g} s: {what}; {self.values}"
            self.read()
        return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def watch() -> Iterator[Callable[..., Watcher]]:
    with contextlib.ExitStack() as stack:

        def make(port: int, *names: str) -> Watcher:
            watcher = Watcher(port, *names)
            stack.callback(watcher.close)
            return watcher

        yield make


def _connected(port: int) -> socket.socket | None:
    try:
        return socket.create_connection(("127.0.0.1", port), 0.1)
    except OSError:
        return None


def until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    end = time.monotonic() + patience_s
    while not (value := condition()):
        assert time.monotonic() < end, f"not within {patience_s:g} s: {what}"
        time.sleep(0.02)
    return value


def moos_file(folder: Path, port: int, warp: float = 1.0, text: str = "") -> Path:
    path = folder / "test.moos"
    path.write_text(f"ServerHost = 127.0.0.1\nServerPort = {port}\nCommunity = alpha\nMOOSTimeWarp = {warp:g}\n{text}")
    return path


def log_of(run: Processes, program: str, pattern: str) -> str | None:
    """What fits a pattern in the output of a program."""
    text = "".join(path.read_text(errors="replace") for path in sorted(run.folder.glob(f"{program}*.log")))
    found = re.search(pattern, re.sub(r"\x1b\[[0-9;]*m", "", text))
    return found[0] if found else None


def database(run: Processes, port: int, warp: float = 1.0) -> subprocess.Popen[str]:
    return run.moos(
        "MOOSDB",
        moos_file(run.folder, port, warp),
        f"--moos_port={port}",
        "--moos_suicide_disable",
        "--moos_community=alpha",
    )


# -- pymoos, against our database -------------------------------------------------------------------------------------------------------

PROBE = """
import json, sys, time
import pymoos

comms = pymoos.comms()
heard = {}

def on_mail():
    for message in comms.fetch():
        if message.is_binary():
            heard[message.key()] = list(bytes(message.binary_data()))
        elif message.is_string():
            heard[message.key()] = message.string()
        else:
            heard[message.key()] = message.double()
        if message.key().startswith("NAV"):
            heard["source"] = message.source()
            heard["age"] = pymoos.time() - message.time()
    return True

def on_connect():
    comms.register("SIMULATION_MODE", 0)
    comms.register("ECHO_BINARY", 0)
    return comms.register("NAV_*", "*", 0)

comms.set_on_connect_callback(on_connect)
comms.set_on_mail_callback(on_mail)
comms.run("127.0.0.1", int(sys.argv[1]), "pymoos_probe")
assert comms.wait_until_connected(5000)
end = time.time() + 20
while time.time() < end and not {"NAV_DEPTH", "SIMULATION_MODE", "ECHO_BINARY"} <= heard.keys():
    comms.notify("DESIRED_THRUST", 30.0, -1)
    comms.notify_binary("ECHO_BINARY", bytes([0, 255, 7]), -1)
    time.sleep(0.1)
heard["community"] = comms.get_community_name()
comms.close(True)
print("HEARD" + json.dumps(heard))
"""


@needs_pymoos
def test_pymoos_talks_with_our_database(run, watch):
    port = free_port()
    run.serve(scenario(port))
    watcher = watch(port, "DESIRED_THRUST", "DB_CLIENTS", "NAV_SPEED")
    done = subprocess.run([PYMOOS, "-c", PROBE, str(port)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    heard = json.loads(done.stdout.partition("HEARD")[2])
    assert (heard["SIMULATION_MODE"], heard["ECHO_BINARY"], heard["community"], heard["source"]) == (
        "TRUE",
        [0, 255, 7],
        "alpha",
        "uwserver",
    )
    assert heard["NAV_DEPTH"] == pytest.approx(5.0, abs=0.5)
    assert abs(heard["age"]) < 5.0, "the clocks of both sides agree"
    watcher.until(lambda v: v.get("DESIRED_THRUST") == 30.0, "the probe's command")
    assert watcher.sources["DESIRED_THRUST"] == "pymoos_probe"
    watcher.until(lambda v: v.get("NAV_SPEED", 0.0) > 0.05, "the vehicle moves")


# -- programs of MOOS-IvP ---------------------------------------------------------------------------------------------------------------


@needs_moos
def test_poke_and_query_our_database(run, watch):
    port = free_port()
    run.serve(scenario(port))
    mission = moos_file(run.folder, port)
    watcher = watch(port, "DESIRED_THRUST", "UWSERVER_REPLY", "NOTE")
    poke = run.moos("uPokeDB", mission, "DESIRED_THRUST=40", "NOTE=hello", "UWSERVER_CALL=7 world/pause")
    watcher.until(lambda v: {"DESIRED_THRUST", "NOTE", "UWSERVER_REPLY"} <= v.keys(), "what was poked")
    assert (watcher.values["DESIRED_THRUST"], watcher.values["NOTE"]) == (40.0, "hello")
    assert json.loads(watcher.values["UWSERVER_REPLY"])["id"] == "7"
    poke.wait(PATIENCE_S)
    query = run.moos("uQueryDB", mission, "--condition=NOTE=hello", "--wait=5")
    assert query.wait(PATIENCE_S) == 0
    query = run.moos("uQueryDB", mission, "--condition=DESIRED_THRUST > 99", "--wait=2")
    assert query.wait(PATIENCE_S) != 0


@needs_moos
def test_a_call_with_blanks_is_poked_and_its_answer_stays(run, watch):
    """As docs/how-to/moos.md has it; who comes later finds the answer in the database."""
    port = free_port()
    run.serve(scenario(port))
    mission = moos_file(run.folder, port)
    call = run.moos("uPokeDB", mission, 'UWSERVER_CALL=7 world/set_current {"velocity_N": [0.2, 0, 0]}')
    call.wait(PATIENCE_S)
    reply = json.loads(watch(port, "UWSERVER_REPLY").until(lambda v: v.get("UWSERVER_REPLY"), "the latched answer"))
    assert (reply["id"], reply["service"], "value" in reply) == ("7", "world/set_current", True), reply
    query = run.moos("uQueryDB", mission, "--condition=UWSERVER_CALL!=x", "--wait=5")
    assert query.wait(PATIENCE_S) == 0


@needs_moos
def test_scope_and_reporter_of_our_database(run, watch):
    """uXMS shows values, sources and types; pNodeReporter makes its report of NAV_*."""
    port = free_port()
    run.serve(scenario(port))
    mission = moos_file(run.folder, port, text="ProcessConfig = pNodeReporter\n{\n platform_type = uuv\n}\n")
    run.moos("pNodeReporter", mission, "--alias=pNodeReporter")
    watcher = watch(port, "NODE_REPORT_LOCAL", "NAV_X")
    report = watcher.until(lambda v: v.get("NODE_REPORT_LOCAL"), "a report")
    said = dict(part.split("=", 1) for part in report.split(","))
    assert float(said["DEP"]) == pytest.approx(5.0, abs=0.5), report
    assert float(said["Y"]) == pytest.approx(-20.0, abs=1.0), report
    run.moos("uXMS", mission, "NAV_DEPTH", "NODE_REPORT_LOCAL", "--mode=streaming", "--show=source,time")
    shown = until(
        lambda: log_of(run, "uXMS", r"NAV_DEPTH\s+uwserver.*\n(.*\n)*?.*NODE_REPORT_LOCAL\s+pNodeReporter"), "uXMS"
    )
    assert shown


@needs_moos
def test_the_log_of_a_killed_server_is_read_by_alogcheck(run, watch):
    port = free_port()
    server = run.serve(scenario(port).replace("publish =", 'alog = "dive.alog"\npublish ='))
    watcher = watch(port, "NAV_DEPTH", "TAG")
    watcher.until(lambda v: "NAV_DEPTH" in v, "samples")
    watcher.notify(time.time(), TAG="here")
    watcher.until(lambda v: v.get("TAG") == "here", "the tag")
    time.sleep(1.5)  # what a kill may cost at most is a second
    server.kill()
    for condition in ("TAG = here", "NAV_DEPTH > 4", "NAV_DEPTH > 50"):
        run.moos("alogcheck", "dive.alog", "--pass", condition).wait(PATIENCE_S)
    assert (log_of(run, "alogcheck", "(?s).*") or "").split() == ["PASSED", "PASSED", "FAILED"]


@needs_moos
def test_a_type_clash_in_their_database_is_told(run, watch):
    """MOOSDB drops the write, and says so at its own console only."""
    port = free_port()
    database(run, port)
    first = watch(port, "NAV_X")
    first.notify(time.time(), NAV_X="east")
    first.until(lambda v: v.get("NAV_X") == "east", "the text")
    first.close()
    run.serve(scenario(port, "moos"))
    watcher = watch(port, "NAV_X", "NAV_Y")
    watcher.until(lambda v: "NAV_Y" in v, "samples")
    until(lambda: log_of(run, Path(sys.executable).name, "has NAV_X with another type"), "the warning")
    assert watcher.values["NAV_X"] == "east"


@needs_moos
def test_our_client_in_their_database(run, watch):
    """Any start order, a restart of MOOSDB, and back within two seconds."""
    port = free_port()
    run.serve(scenario(port, "moos"))
    for _ in range(2):
        served = database(run, port)
        watcher = watch(port, "NAV_DEPTH", "AUV_DEPTH_DEPTH", "NAV_SPEED", "UWSERVER_REPLY")
        started = time.monotonic()
        watcher.until(lambda v: "NAV_DEPTH" in v and "AUV_DEPTH_DEPTH" in v, "samples")
        assert time.monotonic() - started < 2.0
        assert watcher.sources["NAV_DEPTH"] == "uwserver"
        now = time.time()
        watcher.notify(now + 1.0, DESIRED_THRUST=50.0, UWSERVER_CALL="1 world/status")
        watcher.until(lambda v: v.get("NAV_SPEED", 0.0) > 0.1 and "UWSERVER_REPLY" in v, "the vehicle moves")
        served.kill()
        served.wait(PATIENCE_S)


FLEET = """
schema = 1
[server]
metrics = false
[adapters.moos]
kind = "moos"
truth = true
"""
MEMBER = """
[vehicles.{name}]
model = "lauv"
position_ned_m = [{north}, 0, 5]
[vehicles.{name}.truth]
rate_hz = 20
[adapters.moos.communities.{name}]
port = {port}
vehicle = "{name}"
publish = []
[adapters.moos.communities.{name}.nav]
[adapters.moos.communities.{name}.commands]
{commands}
"""


@needs_moos
def test_two_vehicles_in_two_communities(run, watch):
    """Each database has one vehicle's NAV_*, and drives that one alone; the end of one is nothing to the other."""
    alpha, bravo = free_port(), free_port()
    served = [database(run, port) for port in (alpha, bravo)]
    members = (("alpha", 10, alpha), ("bravo", -30, bravo))
    run.serve(FLEET + "".join(MEMBER.format(name=n, north=y, port=p, commands=HULLS["lauv"]) for n, y, p in members))
    first, second = watch(alpha, "NAV_Y", "NAV_SPEED"), watch(bravo, "NAV_Y", "NAV_SPEED")
    for watcher, north in ((first, 10.0), (second, -30.0)):
        watcher.until(lambda v: "NAV_Y" in v, "samples")
        assert watcher.values["NAV_Y"] == pytest.approx(north, abs=0.5)
    second.notify(time.time() + 1.0, DESIRED_THRUST=30.0)
    second.until(lambda v: first.read() or v.get("NAV_SPEED", 0.0) > 0.2, "bravo moves")
    assert abs(first.values["NAV_SPEED"]) < 0.05
    served[0].kill()
    north = second.values["NAV_Y"]
    second.until(lambda v: v["NAV_Y"] > north + 0.5, "bravo goes on")


@needs_moos
def test_stopped_for_ten_seconds_and_back(run, watch):
    """A server that was stopped is thrown out by MOOSDB; it joins again, and nothing jumps."""
    port = free_port()
    database(run, port)
    server = run.serve(scenario(port, "moos"))
    watcher = watch(port, "NAV_DEPTH", "UWSERVER_TIME", "DB_EVENT")
    before = watcher.until(lambda v: v.get("UWSERVER_TIME"), "samples")
    server.send_signal(signal.SIGSTOP)
    watcher.until(lambda v: v.get("DB_EVENT") == "disconnected=uwserver", "MOOSDB throws it out")
    stopped = watcher.values["UWSERVER_TIME"]
    server.send_signal(signal.SIGCONT)
    resumed = time.monotonic()
    watcher.until(lambda v: v.get("DB_EVENT") == "connected=uwserver", "it is back")
    assert time.monotonic() - resumed < 2.0
    watcher.until(lambda v: v["UWSERVER_TIME"] > stopped, "samples again")
    assert watcher.values["UWSERVER_TIME"] - stopped < 3.0, "simulation time goes on where it stood"
    assert before <= stopped


def prepared(run: Processes, mission: str, file: str, port: int, warp: float, **changes: str) -> Path:
    """The mission's files, with only what launching needs changed: host, port, warp, and what `changes` says of the PID block."""
    assert MISSIONS is not None
    for source in (MISSIONS / mission).iterdir():
        if source.suffix in (".moos", ".bhv"):
            text = source.read_text()
            text = re.sub(r"(?m)^ServerHost\s*=.*$", "ServerHost = 127.0.0.1", text)
            text = re.sub(r"(?m)^ServerPort\s*=.*$", f"ServerPort = {port}", text)
            text = re.sub(r"(?m)^MOOSTimeWarp\s*=.*$", f"MOOSTimeWarp = {warp:g}", text)
            for key, value in changes.items():
                text = re.sub(rf"(?m)^(\s*){key}\s*=.*$", rf"\g<1>{key} = {value}", text)
            (run.folder / source.name).write_text(text)
    return run.folder / file


def deploy(run: Processes, watcher: Watcher, mission: Path, *more: str) -> None:
    """Press DEPLOY until the helm drives: it sets DEPLOY=false as it starts, and overrules who was quicker."""
    end = time.monotonic() + PATIENCE_S
    while watcher.values.get("IVPHELM_STATE") != "DRIVE":
        assert time.monotonic() < end, f"the helm does not drive: {watcher.values}"
        run.moos("uPokeDB", mission, "DEPLOY=true", "MOOS_MANUAL_OVERRIDE=false", "RETURN=false", *more)
        again = time.monotonic() + 5.0
        while time.monotonic() < again and watcher.values.get("IVPHELM_STATE") != "DRIVE":
            watcher.read()


DIVE_WARP = 20.0
Fit = tuple[str, str, dict[str, str]]
FITS: dict[str, Fit] = {
    "lauv": ("lauv", HULLS["lauv"], {}),
    "remus100": ("remus100", HULLS["remus100"], {}),
    "remus100 with its own gains": ("remus100", PERCENT, GAINS),
}
"""Hull, its map, and gains of the mission that are changed for it."""

WARPS = [pytest.param(1, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow), 10, 20]


@needs_missions
@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("kind", ["moosdb", "moos"])
@pytest.mark.parametrize("warp", WARPS)
def test_s1_alpha_completes(run, watch, kind, warp, fit):
    """An unmodified helm and autopilot drive a hydrodynamic hull round five waypoints and back."""
    hull, commands, gains = FITS[fit]
    port = free_port()
    mission = prepared(run, "s1_alpha", "alpha.moos", port, warp, **gains)
    if kind == "moos":
        run.moos("MOOSDB", mission, "--moos_suicide_disable")
    run.serve(scenario(port, kind, warp, 0.0, hull, commands, HOLD))
    watcher = watch(
        port, "MISSION", "NAV_X", "NAV_Y", "NAV_DEPTH", "NAV_SPEED", "DESIRED_THRUST", "IVPHELM_STATE", "UWSERVER_TIME"
    )
    watcher.until(lambda v: "UWSERVER_TIME" in v, "the world runs: its kernels may have to be compiled", 120.0)
    for program in ("pHelmIvP", "pMarinePIDV22", "pNodeReporter", "uProcessWatch"):
        run.moos(program, mission)
    watcher.until(lambda v: {"IVPHELM_STATE", "DESIRED_THRUST"} <= v.keys(), "helm and autopilot")
    begin = watcher.values.get("UWSERVER_TIME", 0.0)
    deploy(run, watcher, mission)
    watcher.until(lambda v: v.get("MISSION") == "complete", "the mission", 1000.0 / warp + 60.0)
    v = watcher.values
    took = v["UWSERVER_TIME"] - begin
    end = f"end ({v['NAV_X']:.1f}, {v['NAV_Y']:.1f}), deepest {watcher.most['NAV_DEPTH']:.2f} m"
    print(f"s1_alpha, {fit}, {kind}, warp {warp}: {took:.0f} s, {end}")
    assert (v["NAV_X"] ** 2 + (v["NAV_Y"] + 20.0) ** 2) ** 0.5 < 10.0
    assert watcher.most["NAV_DEPTH"] < DEEPEST_M, "a mission in the plane stays where hold_depth_m says"


def dive(run: Processes, watch: Callable[..., Watcher], name: str, kind: str, fit: Fit, *more: str) -> Watcher:
    """A mission of a submarine at warp 20, under way. Its helm is unchanged; simulator and autopilot are today's."""
    port = free_port()
    hull, commands, gains = fit
    mission = prepared(run, name, f"{name.partition('_')[2]}.moos", port, DIVE_WARP, **gains)
    mission.write_text(
        re.sub(r"(?m)^ProcessConfig = pMarinePID\b", "ProcessConfig = pMarinePIDV22", mission.read_text())
    )
    if kind == "moos":
        run.moos("MOOSDB", mission, "--moos_suicide_disable")
    run.serve(scenario(port, kind, DIVE_WARP, 0.0, hull, commands, HOLD))
    watcher = watch(port, "NAV_DEPTH", "DESIRED_DEPTH", "DESIRED_ELEVATOR", "IVPHELM_STATE", "UWSERVER_TIME")
    watcher.until(lambda v: "UWSERVER_TIME" in v, "the world runs: its kernels may have to be compiled", 120.0)
    for program in ("pHelmIvP", "pMarinePIDV22", "pNodeReporter"):
        run.moos(program, mission)
    watcher.until(lambda v: "IVPHELM_STATE" in v and "DESIRED_ELEVATOR" in v, "helm and autopilot")
    deploy(run, watcher, mission, *more)
    return watcher


def holds(watcher: Watcher, depth: float, hold_s: float, warp: float = DIVE_WARP) -> None:
    """The helm wants a depth; it is reached, and `hold_s` of simulation later the vehicle is within 1 m of it."""
    watcher.until(lambda v: v.get("DESIRED_DEPTH") == depth, f"the helm wants {depth:g} m", 1000.0 / warp)
    watcher.until(lambda v: abs(v["NAV_DEPTH"] - depth) < 0.5, f"{depth:g} m are reached", 1000.0 / warp)
    reached = watcher.values["UWSERVER_TIME"]
    farthest = 0.0

    def held(values: dict[str, Any]) -> bool:
        nonlocal farthest
        if values["UWSERVER_TIME"] > reached + 0.5 * hold_s:
            farthest = max(farthest, abs(values["NAV_DEPTH"] - depth))
        return bool(values["UWSERVER_TIME"] > reached + hold_s)

    watcher.until(held, f"{depth:g} m are held", 5.0 * hold_s / warp + PATIENCE_S)
    print(f"{depth:g} m at {reached:.0f} s, then within {farthest:.2f} m")
    assert farthest < 1.0


@needs_missions
@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("kind", ["moosdb", "moos"])
def test_s10_juliet_holds_its_depths(run, watch, kind, fit):
    """The mission goes to 40, 30 and 20 m and holds each for 45 or 60 s."""
    watcher = dive(run, watch, "s10_juliet", kind, FITS[fit], "GOTO_DEPTH=true")
    for depth in (40.0, 30.0, 20.0):
        holds(watcher, depth, 40.0)


@needs_missions
@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("kind", ["moosdb", "moos"])
def test_s4_delta_holds_its_depths(run, watch, kind, fit):
    """It loiters at its greatest depth, 7 m of the 50 that it would like to have, and comes up as if for a GPS fix when it may."""
    watcher = dive(run, watch, "s4_delta", kind, FITS[fit], "PSURFACE=false")
    holds(watcher, 7.0, 40.0)
    run.moos("uPokeDB", run.folder / "delta.moos", "PSURFACE=true")
    holds(watcher, 0.0, 20.0)

"""A world that its program steps, and clients that hear and command it meanwhile: the real adapters, over loopback.

Also of uwserver.simulation.stepped, uwserver.server.hosted and uwserver.scenario.load.adapters.
"""

from __future__ import annotations

import gc
import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import webbrowser
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import uwclient

import uwserver
from uwserver.server.hosted import THREAD_NAME
from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS

PATIENCE_S = 20.0
SCENARIO = "bluerov2_pool"


@pytest.fixture
def world():
    with uwserver.load(SCENARIO) as loaded:
        yield loaded


@pytest.fixture
def client(world):
    """A client of `world`."""
    with world.serve("sockets") as served, connected(served) as client:
        yield client


def connected(served) -> uwclient.Client:
    return uwclient.connect(port=port_of(served), timeout=PATIENCE_S)


def port_of(served) -> int:
    return int(served.address.rpartition(":")[2])


def is_free(port: int) -> bool:
    with socket.socket() as attempt:
        attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            attempt.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True


def threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name == THREAD_NAME]


def until(condition, doing=lambda: None) -> None:
    """Do something until a condition holds."""
    end = SystemTime().now_ns() + PATIENCE_S * NANOSECONDS
    while not condition():
        doing()
        assert SystemTime().now_ns() < end, "in vain"


class Beside:
    """What a client does in a thread of its own, while the program steps."""

    def __init__(self, work) -> None:
        self.result = self.error = None
        self._work = work
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.result = self._work()
        except Exception as error:  # noqa: BLE001  # told by `over`
            self.error = error

    def over(self, doing=lambda: None):
        """Do something until it is over, and return its result."""
        until(lambda: not self._thread.is_alive(), doing)
        if self.error is not None:
            raise self.error
        return self.result


# -- hearing and commanding -----------------------------------------------------------------------------------------------------------------


def test_a_client_hears_each_sample_of_the_steps_and_its_command_acts(world, client):
    client.subscribe("bluerov2/depth")
    ack = Beside(lambda: client.send("bluerov2/thrusters", u=[0.0] * 4 + [0.5] * 4)).over(world.step)
    assert 0 <= ack.tick <= world.tick
    own = world.record("bluerov2/depth")
    world.step(480)
    wanted = [sample.seq for sample in own["bluerov2/depth"].samples]
    heard = [-1]
    while heard[-1] < wanted[-1]:
        heard.append(client.read("bluerov2/depth", timeout=PATIENCE_S).seq)
    assert heard[-len(wanted) :] == wanted
    assert world.vehicles["bluerov2"].p_NB[2] > 1.1, "it dives"


def test_nothing_changes_between_two_steps_and_sync_does_what_was_asked(world, client):
    before = world.save()
    with world.serve({"second": {"kind": "sockets"}}) as served, connected(served) as other:
        waiting = Beside(lambda: other.call("world/set_current", velocity_N=[0.5, 0.0, 0.0]))
        until(lambda: client.status()["adapters"]["second"]["calls"] == 1)
        assert client.status()["tick"] == 0, "what only reads is answered at once"
        assert world.save() == before
        waiting.over(served.sync)
    assert world.save() != before
    assert world.tick == 0


def test_readers_are_served_while_the_program_does_something_else(world, client):
    world.step(240)
    newest = Beside(lambda: client.latest("bluerov2/depth")).over()
    assert newest is None or newest.t_ns == world.read("bluerov2/depth").t_ns
    with world.view(opens=False, port=0) as page:
        assert page.address.startswith("http://127.0.0.1:")
        connection = http.client.HTTPConnection(
            "127.0.0.1", int(page.address.rstrip("/").rpartition(":")[2]), timeout=PATIENCE_S
        )
        connection.request("GET", "/")
        answer = connection.getresponse()
        assert answer.status == 200
        assert b"<title>" in answer.read()
        connection.close()


def test_a_pause_of_a_client_holds_the_program_and_a_step_of_it_makes_ticks(world, client):
    ends = threading.Event()
    program = Beside(lambda: [*iter(lambda: ends.is_set() or len(world.step()) < 0, True)])
    client.pause()
    paused = client.status()["tick"]
    client.step(2)
    assert client.status()["tick"] == paused + 2
    assert client.status()["paused"]
    ends.set()
    client.resume()
    program.over()
    assert paused + 2 <= world.tick <= paused + 3


def test_a_program_that_waits_in_a_pause_goes_on_when_it_is_closed(world):
    served = world.serve("sockets")
    program = Beside(lambda: world.step(10**5))
    with connected(served) as client:
        client.pause()
        assert client.status()["tick"] < 10**5
        served.close()
        program.over()
    assert world.tick == 10**5


def test_a_reset_of_a_client_begins_recordings_anew_and_the_program_gets_its_ticks(world, client):
    trace = world.record("bluerov2/depth")["bluerov2/depth"]
    world.step(480)
    Beside(client.reset).over(lambda: world.step(24))
    after = world.tick
    world.step(480)
    assert world.tick == after + 480
    assert np.all(np.diff(trace.t) > 0)
    assert trace.t[0] < 0.1
    assert trace.t[-1] == pytest.approx(world.t_s, abs=0.1)
    assert any(event.event == "reset" for event in world.events())


def test_clients_follow_the_program_into_a_world_of_another_seed(world, client):
    client.subscribe("bluerov2/imu")
    world.step(24)
    old = client.read("bluerov2/imu", timeout=PATIENCE_S)
    world.reset(seed=8)
    assert client.status()["tick"] == 0
    assert Beside(lambda: client.send("bluerov2/thrusters", u=[0.2] * 8)).over(world.step).tick <= world.tick
    world.step(240)
    until(lambda: client.latest("bluerov2/imu").t_ns == world.read("bluerov2/imu").t_ns)
    assert client.latest("bluerov2/imu").value["f_S"] == pytest.approx(world.read("bluerov2/imu").f_S.tolist())
    assert old.value != client.latest("bluerov2/imu").value


def test_a_failure_reaches_program_and_clients_and_a_reset_ends_it(world, client):
    world.step()
    row = world.core.vehicles["bluerov2"].row
    world.core.hydro.state[row, 7:10] = np.nan
    with pytest.raises(uwserver.Diverged, match="bluerov2"):
        world.step(10)
    assert "diverged" in client.status()["failure"]
    with pytest.raises(uwserver.Diverged):
        world.step()
    world.reset()
    world.step(10)
    assert world.tick == 10
    assert client.status()["failure"] == ""


def test_what_only_a_server_can_do_is_refused_in_words(client):
    for service in ("world/profile", "recording/start"):
        with pytest.raises(uwclient.CallRefused, match="a program steps this world"):
            client.call(service)


# -- the same numbers -------------------------------------------------------------------------------------------------------------------------


def test_a_world_that_is_watched_steps_as_one_that_is_not():
    """Bit for bit, with clients that subscribe, ask for the newest samples and for the scene all the time."""

    def run(looks) -> tuple[bytes, list[uwserver.Trace]]:
        with uwserver.load("one_of_everything", seed=5) as world, ExitStack() as stack:
            looks(world, stack)
            traces = world.record()
            for k in range(30):
                if k == 10:
                    world.command("heavy/thrusters", u=[0.3] * 8)
                world.step(1 + 7 * (k % 3))
            return world.save(), [(path, trace.samples) for path, trace in traces.items()]

    def watched(world, stack) -> None:
        client = stack.enter_context(connected(stack.enter_context(world.serve("sockets"))))
        client.subscribe("**")
        stack.enter_context(world.view(opens=False, port=0))

    assert run(watched) == run(lambda world, stack: None)


def test_real_time_makes_the_same_ticks_and_keeps_its_pace(world):
    before = SystemTime().now_ns()
    with world.serve("sockets", speed=4.0) as served, connected(served) as client:
        world.step(96)
        assert client.status()["mode"] == "realtime"
    assert SystemTime().now_ns() - before >= 0.09 * NANOSECONDS, "0.4 s at four times real time"
    with uwserver.load(SCENARIO) as other:
        other.step(96)
        assert other.save() == world.save()


# -- beginning and ending ---------------------------------------------------------------------------------------------------------------------


def test_the_end_of_the_block_frees_port_and_thread(world):
    with world.serve("sockets") as served:
        assert threads() == [THREAD_NAME]
        assert served.is_running()
        assert not is_free(port_of(served))
    assert not served.is_running()
    assert is_free(port_of(served))
    assert threads() == []
    served.close()
    served.sync()
    world.step()


def test_one_thread_serves_all_and_ends_with_the_last(world):
    with world.serve("sockets") as one:
        with world.view(opens=False, port=0) as page:
            assert world.view(opens=False).address == page.address, "a page that is there is shown again"
            assert threads() == [THREAD_NAME]
        assert one.is_running()
        assert not page.is_running()
        with world.view(opens=False, port=0):
            pass
    assert threads() == []


def test_closing_the_world_ends_it(world):
    served = world.serve("sockets")
    world.close()
    assert threads() == []
    assert is_free(port_of(served))
    with pytest.raises(uwserver.Refused, match="closed: load it again"):
        world.serve("sockets")


def test_a_client_can_end_it(world, client):
    client.call("world/shutdown")
    until(lambda: threads() == [])
    world.step()
    with world.serve("sockets") as again, connected(again) as other:
        assert other.status()["tick"] == 1


def test_a_world_that_nothing_refers_to_ends_it():
    served = uwserver.load(SCENARIO).serve("sockets")
    port = port_of(served)
    assert served.is_running(), "the handle keeps the world"
    del served
    gc.collect()
    until(lambda: threads() == [])
    assert is_free(port)


PROGRAM = """
import sys, threading, uwserver
world = uwserver.load("bluerov2_pool")
served = world.serve(["sockets"])
world.serve({{"bus": {{"kind": "zenoh", "listen": ["tcp/127.0.0.1:0"]}}}})  # it needs threads of its own to end
world.view(opens=False, port=0)
print(served.address, flush=True)
{then}
"""


@pytest.mark.parametrize(
    ("then", "status"),
    [("world.step(24)", 0), ("while True: world.step()", -signal.SIGINT)],
)
def test_the_end_of_the_process_is_in_order(then, status):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(then=then)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    )
    port = int(process.stdout.readline().rpartition(":")[2])
    if status < 0:
        process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status
    assert told.strip().splitlines()[-1:] == ["KeyboardInterrupt"] * (status < 0)
    assert is_free(port)


def test_a_second_adapter_of_a_name_and_a_taken_port_are_refused(world):
    with world.serve("sockets") as served:
        with pytest.raises(uwserver.Refused, match='has an adapter "sockets" already'):
            world.serve("sockets")
        with pytest.raises(uwserver.Refused, match=r"did not start.*port"):
            world.serve({"other": {"kind": "sockets", "port": port_of(served)}})
        assert served.is_running()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(uwserver.Refused, match="did not start"):
            world.view(opens=False, port=taken.getsockname()[1])
    assert threads() == []


@pytest.mark.parametrize(
    ("adapters", "text"),
    [
        ("socket", 'unknown kind "socket" .did you mean "sockets".'),
        ({"link": {"kind": "mavlink", "prt": 1}}, 'serve: adapters.link: unknown key "prt"'),
        ({"link": {"port": 1}}, 'missing key "kind"'),
        ({"a/b": {"kind": "sockets"}}, "cannot be a name"),
        ([], "names none"),
        (7, '"adapters" must be names, or tables by name'),
    ],
)
def test_wrong_adapters_are_told_before_anything_starts(world, adapters, text):
    with pytest.raises((uwserver.Refused, uwserver.ScenarioError), match=text):
        world.serve(adapters)
    assert threads() == []


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), "fast"])
def test_no_possible_speed(world, speed):
    with pytest.raises(uwserver.Refused, match='"speed" must be within'):
        world.serve("sockets", speed=speed)
    assert threads() == []


# -- the page ---------------------------------------------------------------------------------------------------------------------------------


@pytest.fixture
def opened(monkeypatch):
    """The addresses that were opened in a browser."""
    found: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: found.append(address) or True)
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a desktop")
def test_the_page_is_opened_where_there_is_a_desktop_or_it_was_asked_for(world, opened, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with world.view(port=0) as page:
        assert opened == []
        assert f"open {page.address} in a browser" in capsys.readouterr().err
        assert world.view(opens=True).address == page.address
        until(lambda: opened == [page.address])
        monkeypatch.setenv("DISPLAY", ":7")
        world.view()
        until(lambda: opened == [page.address] * 2)
        monkeypatch.setattr("uwserver.in_process.world.is_notebook", lambda: True)
        world.view()
        assert capsys.readouterr().err == "", "a notebook shows the link"
    assert opened == [page.address] * 2


def test_a_page_that_others_reach_has_a_token_in_its_address(world):
    with world.view(opens=False, port=0, bind="127.0.0.1", view_token="for those who watch") as page:
        assert "#token=" in page.address
    with pytest.raises(uwserver.ScenarioError, match='unknown key "prot"'):
        world.view(opens=False, prot=1)


PAGE = Path(__file__).parents[3] / "docs/how-to/view-from-python.md"


@pytest.mark.parametrize("code", re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M))
def test_the_programs_of_the_page_run(code, opened, capsys):
    exec(compile(code.replace("range(600)", "range(3)"), str(PAGE), "exec"), {})
    assert threads() == []

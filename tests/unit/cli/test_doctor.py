from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

import uwserver.cli.doctor as command
from uwserver.adapter import AdapterNotFound
from uwserver.cli import doctor as diagnosis
from uwserver.cli import main
from uwserver.cli.doctor import Finding
from uwserver.packages import install_command
from uwserver.physics.collision import engine
from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import CacheState
from uwserver.world.builds import STAGES, kernels_of


class Sleeper:
    """Wall time that passes only by waiting, each time longer than asked for."""

    def __init__(self, late_ns: int) -> None:
        self._now, self._late = 0, late_ns

    def now_ns(self) -> int:
        return self._now

    def wait(self, seconds: float, wake: threading.Event) -> None:
        self._now += round(seconds * 1e9) + self._late


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def number_of(server: socket.socket) -> int:
    return int(server.getsockname()[1])


def answer_once(server: socket.socket, answer: bytes) -> threading.Thread:
    """Reads one line from the first peer, answers and hangs up."""

    def serve() -> None:
        peer, _ = server.accept()
        with peer, peer.makefile("rb") as lines:
            assert json.loads(lines.readline())["method"] == "hello"
            peer.sendall(answer)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    return thread


def test_this_python_and_its_packages_are_good() -> None:
    assert diagnosis.python().level == "ok"
    assert {finding.name: finding.level for finding in diagnosis.wheels()}["numba"] == "ok"


@pytest.mark.parametrize(("version", "level"), [((3, 10, 4), "ok"), ((3, 13, 0), "ok"), ((3, 15, 0), "warning")])
def test_pythons_newer_than_those_tried_are_warned_of(
    version: tuple[int, int, int], level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnosis.sys, "version_info", version)
    finding = diagnosis.python()
    assert (finding.level, finding.text.split(":")[0]) == (level, ".".join(map(str, version)))
    assert ("use Python 3.13 or older" in finding.remedy) == (level == "warning")


def test_a_missing_package_is_a_fault_only_if_it_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "_REQUIRED", {"no-such-thing": "no_such_thing"})
    optional_ones = {"nor-this": ("nor_this", "dreams", "dream"), "by-default": ("by_default", "most", "")}
    monkeypatch.setattr(diagnosis, "_OPTIONAL", optional_ones)
    needed, optional, default = diagnosis.wheels()
    assert (needed.name, needed.level, optional.name, optional.level) == (
        "no-such-thing",
        "fault",
        "nor-this",
        "warning",
    )
    assert "no_such_thing" in needed.text
    assert "uwserver[dream]" in optional.remedy
    assert default.remedy.endswith(install_command("uwserver"))


@pytest.mark.parametrize(
    ("installed", "level", "text"),
    [
        (["pybullet", "coal"], "ok", "bullet (coal too)"),
        (["coal"], "ok", "coal"),
        ([], "warning", "neither pybullet nor coal is installed: "),
    ],
)
def test_the_engine_of_contacts_is_named(
    installed: list[str], level: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "find_spec", lambda name: name if name in installed else None)
    finding = diagnosis.contacts()
    command = "" if installed else install_command("uwserver[solid]")
    assert (finding.level, finding.text) == (level, text + command)


def test_rays_without_embree_are_told_to_be_slower(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "find_spec", lambda name: None)
    finding = diagnosis.rays()
    assert finding.level == "warning"
    assert "slower tree of uwserver's own" in finding.text


def test_a_scenario_that_lacks_a_package_gets_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    assert diagnosis.scenario("bluerov2_qgc").level == "ok"
    monkeypatch.setattr("uwserver.scenario.load.extras.find_spec", lambda module: None if "pymavlink" in module else 1)
    found = diagnosis.scenario("bluerov2_qgc")
    assert (found.level, found.text) == ("fault", "not installed: pymavlink")
    assert found.remedy == install_command("uwserver")
    monkeypatch.setattr(diagnosis, "wheels", lambda: iter(()))
    done = CliRunner().invoke(command.doctor, ["bluerov2_qgc"])
    assert done.exit_code == 1
    assert found.remedy in done.output
    assert "`uwserver run bluerov2_qgc` works" in done.output


def test_a_scenario_with_a_fault_is_one_here_too() -> None:
    found = diagnosis.scenario("bluerov2_pol")
    assert found.level == "fault"
    assert "bluerov2_pool" in found.text


KERNELS, LEVEL = Path("all of them"), "x86-64-v3"


@pytest.mark.parametrize(
    ("state", "level", "words"),
    [
        (CacheState(KERNELS, ""), "ok", "(writable)"),
        (CacheState(KERNELS, "read-only"), "ok", "(read-only)"),
        (CacheState(Path("/c"), "", (KERNELS,)), "ok", "came with the wheel, for x86-64-v3"),
        (CacheState(None, "", (KERNELS,)), "ok", "came with the wheel, for x86-64-v3"),
        (
            CacheState(Path("/c"), ""),
            "warning",
            "not compiled yet: cameras, solids, fins in contact, fins, sensors, sonars, contact, ",
        ),
        (
            CacheState(Path("/c"), ""),
            "warning",
            ", autopilots, soundings, free, pictures, sound, echoes, sea, copies; in /c",
        ),
        (CacheState(Path("/c"), ""), "warning", "--warm"),
        (CacheState(None, "not writable: no space"), "warning", "NUMBA_CACHE_DIR"),
    ],
)
def test_kernels(state: CacheState, level: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it says is what a run finds: the files themselves are looked for."""
    there = tmp_path / f"0123-{LEVEL}"
    there.mkdir()
    for stage in STAGES:
        for kernel in kernels_of(stage):
            (there / f"{kernel}-00.kernel").touch()
    state = state._replace(packaged=tuple(there for _ in state.packaged))
    if state.folder == KERNELS:
        state = state._replace(folder=there)
    monkeypatch.setattr(compiled, "cache_state", state)
    finding = diagnosis.kernels()
    assert finding.level == level
    assert words in f"{finding.text} {finding.remedy}"


@pytest.mark.parametrize(
    ("reason", "text"), [("", "two for large worlds, of"), ("one core", "one steps a world: one core")]
)
def test_how_many_threads_there_can_be(reason: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uwserver.physics.kernel.team.why_alone", lambda: reason)
    finding = diagnosis.threads()
    assert finding.level == "ok"
    assert finding.text.startswith(text)


def test_a_free_port_is_good(listener: socket.socket) -> None:
    number = number_of(listener)
    listener.close()
    assert diagnosis.port(number) == Finding(f"port {number}", "ok", "free")


@pytest.mark.parametrize(
    ("answer", "owner"),
    [
        (b'{"jsonrpc":"2.0","id":1,"result":{"server":"uwserver 0.1.0","scenario":"tank"}}\n', "a running uwserver 0.1.0 with scenario tank"),
        (b'{"jsonrpc":"2.0","id":1,"error":{"code":-32000,"message":"no"}}\n', "a running uwserver that wants a token"),
        (b"HTTP/1.1 400 Bad Request\r\n", "another program"),
        (b"[1]\n", "another program"),
        (b"", "another program"),
    ],
)  # fmt: skip
def test_who_has_the_port(answer: bytes, owner: str, listener: socket.socket) -> None:
    thread = answer_once(listener, answer)
    finding = diagnosis.port(number_of(listener))
    thread.join(5.0)
    assert not thread.is_alive()
    assert finding.level == "fault"
    assert finding.text.startswith(f"{owner} has it")
    assert "--port" in finding.remedy


def test_a_silent_owner_of_the_port_does_not_hold_up(listener: socket.socket) -> None:
    assert diagnosis.port(number_of(listener)).text.startswith("another program has it")


@pytest.mark.parametrize(("late_ns", "level"), [(0, "ok"), (900_000, "ok"), (1_100_000, "warning")])
def test_timer(late_ns: int, level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "SystemTime", lambda: Sleeper(late_ns))
    finding = diagnosis.timer()
    assert finding.level == level
    assert f"{late_ns / 1e6:.2f} ms late (p50)" in finding.text


def test_the_real_timer_is_measured() -> None:
    assert "at 500 Hz" in diagnosis.timer().text


@pytest.mark.parametrize(("count", "level"), [(1, "warning"), (2, "ok")])
def test_processors(count: int, level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis.os, "sched_getaffinity", lambda pid: set(range(count)), raising=False)
    assert diagnosis.processors().level == level


@pytest.mark.parametrize(
    ("text", "level"),
    [("MemTotal: 8 kB\nMemAvailable: 409600 kB\n", "ok"), ("MemAvailable: 408575 kB\n", "warning"), ("nonsense", "ok"), (None, "ok")],
)  # fmt: skip
def test_memory(text: str | None, level: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "meminfo").write_text(text)
    assert diagnosis.memory(tmp_path / "meminfo").level == level


def test_adapters_that_load_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(kind: str) -> type:
        if kind == "bad":
            raise AdapterNotFound('adapter "bad" of pack cannot be imported: no moos')
        return int

    monkeypatch.setattr(diagnosis, "adapter_entries", lambda: {"bad": None, "good": None})
    monkeypatch.setattr(diagnosis, "load_adapter", load)
    bad, good = diagnosis.adapters()
    assert (bad.level, good.level) == ("fault", "ok")
    assert "no moos" in bad.text


def test_no_adapter_at_all_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "adapter_entries", dict)
    (finding,) = diagnosis.adapters()
    assert finding.level == "fault"


def test_folder(tmp_path: Path) -> None:
    assert diagnosis.folder(tmp_path).level == "ok"
    assert diagnosis.folder(tmp_path / "absent").level == "warning"
    assert list(tmp_path.iterdir()) == []


GOOD, DOUBTFUL, BAD = (
    Finding("a", "ok", "fine"),
    Finding("b", "warning", "hm", "do b"),
    Finding("c", "fault", "no", "do c"),
)


@pytest.mark.parametrize(
    ("findings", "status", "last"),
    [([GOOD, DOUBTFUL], 0, "ready: uwserver run"), ([GOOD, BAD, BAD], 1, "2 to repair before `uwserver run` works")],
)
def test_exit_status(findings: list[Finding], status: int, last: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "examine", lambda _: findings)
    result = CliRunner().invoke(command.doctor)
    assert result.exit_code == status
    assert result.stdout.splitlines()[-1] == last
    assert all(f"-> {finding.remedy}" in result.stdout for finding in findings if finding.remedy)


def test_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "examine", lambda _: [GOOD, BAD])
    result = CliRunner().invoke(command.doctor, ["--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout) == {
        "ok": False,
        "findings": [
            {"name": "a", "level": "ok", "text": "fine", "remedy": ""},
            {"name": "c", "level": "fault", "text": "no", "remedy": "do c"},
        ],
    }


def test_warming_that_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(say: object) -> bool:
        raise RuntimeError("not finite")

    monkeypatch.setattr("uwserver.world.warm.warm", broken)
    monkeypatch.setattr(command, "examine", lambda _: [GOOD])
    result = CliRunner().invoke(command.doctor, ["--warm"])
    assert result.exit_code == 1
    assert "not finite" in result.stdout


def test_warming_shows_progress_and_removes_old_caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for age, name in enumerate(("kernels-new", "kernels-a", "kernels-b", "kernels-c", "kernels-d", "kernels-old")):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    monkeypatch.setattr(compiled, "cache_state", CacheState(tmp_path / "kernels-new", ""))
    monkeypatch.setattr("uwserver.world.warm._KEPT", 4)
    monkeypatch.setattr("uwserver.world.warm.warm", lambda say: say("kernels: immersed"))
    monkeypatch.setattr(command, "examine", lambda _: [GOOD])
    result = CliRunner().invoke(command.doctor, ["--warm"])
    assert result.exit_code == 0
    assert "kernels: immersed" in result.stderr
    assert len(list(tmp_path.iterdir())) == 5
    assert not (tmp_path / "kernels-old").exists()


# -- an unknown choice of kernels -------------------------------------------------------------------------------------------------------


def test_an_unknown_choice_of_kernels_is_a_finding_and_the_rest_is_examined(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UWSERVER_KERNELS", "Plain")
    found = {finding.name: finding for finding in diagnosis.examine("bluerov2_pool")}
    assert found["kernels"].level == "fault"
    assert found["kernels"].text.startswith('the environment variable UWSERVER_KERNELS is "Plain"')
    assert found["kernels"].remedy == "unset UWSERVER_KERNELS"
    assert "timer" in found
    assert "scenario bluerov2_pool" not in found, "loading one imports kernels"


@pytest.mark.parametrize("command", [["check", "otter"], ["manoeuvres", "otter"], ["--help"]])
def test_other_commands_say_it_in_one_line(command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UWSERVER_KERNELS", "Plain")
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 1
    (line,) = done.output.splitlines()
    assert line.startswith('Error: the environment variable UWSERVER_KERNELS is "Plain": set it to "plain"')

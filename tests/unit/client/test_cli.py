"""Each verb of the command line, its exit codes, Ctrl-C and a closed pipe."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import uwclient
from uwclient import live
from uwclient.cli import main
from uwclient.errors import install_command
from uwclient_fake_server import FakeServer

U = "u=[0.1,0.1,0.1,0.1,0,0,0,0]"


def run(server: FakeServer, *arguments: str) -> int:
    return main(["--port", str(server.port), *arguments])


def test_topics(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(server, "topics") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "rov"
    assert lines[1].split() == ["rov/imu", "sensor", "125", "Hz", "f_S[3]", "m/s^2,", "temperature", "degC"]
    assert [line for line in lines if line.startswith("  rov/ services: ") and "goto" in line]
    assert lines.index("world") > lines.index("rov")
    assert run(server, "topics", "--services") == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("  world/run_until") and line.endswith(" t") for line in lines)
    assert run(server, "topics", "--json") == 0
    described = json.loads(capsys.readouterr().out)
    assert [port["path"] for port in described["ports"]] == ["rov/imu", "rov/depth", "rov/thrusters"]
    assert described["ports"][0]["fields"][0]["unit"] == "m/s^2"
    assert described["world"]["scenario"] == "fake"


def test_watch_shows_the_newest_values_of_all_sensors(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(server, "watch", "--rate", "10", "--seconds", "0.2") == 0
    first, second = capsys.readouterr().out.split("\n\n")
    for shown in (first, second):
        assert [line.split()[0] for line in shown.splitlines() if line.startswith("rov/")] == ["rov/imu", "rov/depth"]
    assert "f_S                  0.500      0.000     -9.810              m/s^2  INVALID" in second
    assert run(server, "watch", "nothing/*") == 1
    assert "no sensor matches" in capsys.readouterr().err


class Terminal(io.StringIO):
    """Says that it is one."""

    def isatty(self) -> bool:
        return True


def test_watch_draws_in_one_place_of_a_terminal(server: FakeServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("LINES", "4")
    out = Terminal()
    with uwclient.connect(port=server.port) as client:
        live.watch(client, "**", 10.0, 0.2, out)
    first, second = out.getvalue().split("\x1b[3F\x1b[J")
    for shown in (first, second):
        assert len(shown.splitlines()) == 3
        assert max(map(len, shown.splitlines())) < 60


def test_a_service_without_a_value_prints_no_null(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(server, "call", "world/reset") == 0
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "world/reset: done\n")


def test_echo(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(server, "echo", "rov/imu", "-n", "2", "--rate", "10", "--fields", "f_S,temperature") == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == "rov/imu seq=0 t=0.000000 f_S=[0.0, 0.0, -9.81] temperature=12.0"
    assert second == "rov/imu seq=1 t=0.008000 INVALID f_S=[0.1, 0.0, -9.81] temperature=null"
    assert server.told("subscribe") == [{"pattern": "rov/imu", "rate_hz": 10.0, "fields": ["f_S", "temperature"]}]
    assert run(server, "echo", "rov/imu", "-n", "1", "--json") == 0
    assert json.loads(capsys.readouterr().out)["value"]["f_S"] == [0.0, 0.0, -9.81]


def test_hz(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    server.samples = 20
    assert run(server, "hz", "rov/*", "--seconds", "0.3") == 0
    header, depth, imu = capsys.readouterr().out.splitlines()
    assert "sim Hz" in header
    assert depth.split()[:2] == ["rov/depth", "20"]
    name, samples, sim_hz, wall_hz, sim_jitter_ms, _, drops = imu.split()
    assert (name, samples, drops) == ("rov/imu", "20", "1")
    assert float(sim_hz) == pytest.approx(118.75)
    assert float(wall_hz) > 0
    assert float(sim_jitter_ms) > 0


def test_hz_without_samples(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    server.samples = 0
    assert run(server, "hz", "rov/imu", "--seconds", "0.05") == 1
    assert "is the world paused?" in capsys.readouterr().err


def test_call(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(server, "call", "echo", "a=1.5", "b=[1,null]", "c=text", "d=true", "e=x=y") == 0
    assert json.loads(capsys.readouterr().out) == {"a": 1.5, "b": [1, None], "c": "text", "d": True, "e": "x=y"}
    assert run(server, "call", "rov/fly") == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err == 'uwclient: no service "rov/fly" [unknown_service: rov/fly]\n'


def test_send_once_and_at_a_rate(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(server, "send", "rov/thrusters", U) == 0
    assert capsys.readouterr().out == "applied at tick 100, 0.400000 s\n"
    assert run(server, "send", "rov/thrusters", U, "--rate", "100", "--seconds", "0.1") == 0
    sent = int(capsys.readouterr().out.split()[0])
    assert 1 <= sent == len(server.told("command")) - 1
    assert run(server, "send", "rov/thrusters", "u=[1]") == 1
    assert "a list of 8 float" in capsys.readouterr().err


def test_plot(server: FakeServer, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "imu.png"
    assert run(server, "plot", "rov/imu", "f_S", "--seconds", "0.1", "--out", str(out)) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out.strip() == str(out)
    assert run(server, "plot", "rov/imu", "f_B", "--seconds", "0.1", "--out", str(out)) == 1
    assert 'no sample came with a field "f_B"' in capsys.readouterr().err
    assert run(server, "plot", "rov/imu", "f_S", "--seconds", "0.1", "--out", str(tmp_path / "no" / "x.png")) == 1


def test_plot_without_matplotlib(
    server: FakeServer, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert run(server, "plot", "rov/imu", "f_S", "--out", "x.png") == 1
    assert install_command("uwclient[plot]") in capsys.readouterr().err
    assert server.told("subscribe") == []


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ([], "VERB"),
        (["fly"], "invalid choice"),
        (["echo"], "PATTERN"),
        (["echo", "x", "-n", "0"], "whole number above 0"),
        (["echo", "x", "--rate", "nan"], "no number above 0"),
        (["call", "x", "y"], "NAME=VALUE"),
        (["send", "x"], "NAME=VALUE"),
        (["hz", "x", "--seconds", "-1"], "no number above 0"),
    ],
)
def test_wrong_usage_is_2(arguments: list[str], phrase: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert phrase in capsys.readouterr().err


def test_no_server_is_1(unused_port: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--port", str(unused_port), "--timeout", "0.2", "topics"]) == 1
    assert "`uwserver run`" in capsys.readouterr().err


def test_token(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    with FakeServer(token="secret") as server:
        assert run(server, "topics") == 1
        assert "denied" in capsys.readouterr().err
        assert run(server, "--token", "secret", "topics") == 0
        monkeypatch.setenv("UWSERVER_TOKEN", "secret")
        assert run(server, "topics") == 0


def start(server: FakeServer, environment: dict[str, str], *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "uwclient", "--port", str(server.port), *arguments]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, encoding="utf-8"
    )


@pytest.mark.parametrize(("verb", "code"), [(["echo", "rov/imu"], 0), (["call", "rov/goto"], 130)])
def test_ctrl_c_ends_cleanly(server: FakeServer, environment: dict[str, str], verb: list[str], code: int) -> None:
    with start(server, environment, *verb) as process:
        stream = process.stderr if verb[0] == "call" else process.stdout
        assert stream is not None
        first = stream.readline()
        assert first
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in err
    if verb[0] == "call":
        assert len(server.told("cancel")) == 1


def test_a_closed_pipe_is_silent(server: FakeServer, environment: dict[str, str]) -> None:
    with start(server, environment, "echo", "rov/imu") as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline()
        process.stdout.close()
        # Sent one after another until the next write finds the pipe closed.
        for seq in range(200):
            server.sample("rov/imu", seq)
            try:
                process.wait(0.1)
                break
            except subprocess.TimeoutExpired:
                continue
        assert process.wait(60) == 0
        assert process.stderr.read() == ""

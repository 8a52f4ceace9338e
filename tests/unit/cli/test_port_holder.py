"""Which program has a port, and that `uwserver run` says so before it starts or compiles anything."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.cli import main
from uwserver.cli.port_holder import holder_of


@pytest.fixture
def taken() -> Iterator[int]:
    """A port at which another program listens."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


def test_a_port_that_is_taken_and_one_that_is_free(taken: int) -> None:
    assert holder_of("127.0.0.1", taken) == "another program"
    assert holder_of("0.0.0.0", taken) == "another program"
    assert holder_of("127.0.0.1", 0) is None
    assert holder_of("::1", taken) is None, "only IPv4 is examined"


def test_run_ends_in_one_line_with_what_to_do(taken: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uwserver.cli.serving.run._run_loop", lambda *_: pytest.fail("it has been started"))
    (tmp_path / "tank.toml").write_text(f'schema = 1\n[adapters.tcp]\nkind = "sockets"\nport = {taken}\n')
    done = CliRunner().invoke(main, ["run", str(tmp_path / "tank.toml")])
    assert done.exit_code == 1
    assert done.output == (
        f"Error: TCP port {taken} is taken by another program: end it, or add --port 0, which takes a free port\n"
    )


def test_an_adapter_that_is_not_required_does_not_stop_a_run(
    taken: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uwserver.cli.serving.run._run_loop", lambda *_: 7)
    monkeypatch.setattr("uwserver.server.process.end_undisturbed", lambda: None)
    text = f'schema = 1\n[adapters.tcp]\nkind = "sockets"\nport = {taken}\nrequired = false\n'
    (tmp_path / "tank.toml").write_text(text)
    assert CliRunner().invoke(main, ["run", str(tmp_path / "tank.toml")]).exit_code == 7

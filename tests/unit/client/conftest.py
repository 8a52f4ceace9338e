"""Makes `uwclient` and the fake server importable, whether or not the client is installed."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).parent
CLIENTS = HERE.parents[2] / "clients"
sys.path[:0] = [str(HERE), str(CLIENTS / "python")]

from uwclient_fake_server import FakeServer  # noqa: E402


@pytest.fixture(autouse=True)
def _no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as fake:
        yield fake


@pytest.fixture
def clients() -> Path:
    """The folder `clients/` of the checkout."""
    return CLIENTS


@pytest.fixture
def environment() -> dict[str, str]:
    """The environment of a subprocess that is to import uwclient."""
    return {**os.environ, "PYTHONPATH": str(CLIENTS / "python")}


@pytest.fixture
def unused_port() -> int:
    """A loopback port nobody listens on (nor, most likely, soon will)."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]

"""Makes the modules beside the tests importable by them (`autopilot_server`, `ground_station`, `zenoh_network`)."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def gcs() -> Iterator[Any]:
    """A ground station to which an autopilot comes (`ground_station.Gcs`)."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    from ground_station import Gcs

    with contextlib.closing(Gcs()) as station:
        yield station

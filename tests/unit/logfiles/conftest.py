"""Logs that are closed when their test ends."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from uwserver.logfiles import Limits, Log, open_log


@pytest.fixture
def read_log() -> Iterator[Callable[..., Log]]:
    """Open a file as a log, with limits by keyword."""
    with ExitStack() as stack:

        def opened(path: Path, **limits: int) -> Log:
            log = open_log(path, Limits(**limits))
            stack.callback(log.close)
            return log

        yield opened


@pytest.fixture
def opened(tmp_path: Path, read_log: Callable[..., Log]) -> Callable[..., Log]:
    """Open bytes as a log in a file of this name, with limits by keyword."""

    def opened(data: bytes, name: str = "run.mcap", **limits: int) -> Log:
        file = tmp_path / name
        file.write_bytes(data)
        return read_log(file, **limits)

    return opened

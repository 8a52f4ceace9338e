"""Turns the errors of third-party parsers into `LogError`. On unexpected bytes such parsers may raise any kind of exception."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uwserver.logfiles.log import LogError

_LONGEST = 300
_PACKAGES = {"google": "protobuf"}
"""The package of a module, where their names differ."""


@contextmanager
def foreign(path: Path, what: str) -> Iterator[None]:
    """Turn every error in the block into a `LogError` that names the file and says what failed."""
    try:
        yield
    except LogError:
        raise
    except OSError as error:
        raise LogError(f"{path}: {what}: {error.strerror or error}") from error
    except ImportError as error:
        module = (error.name or str(error)).split(".")[0]
        package = _PACKAGES.get(module, module)
        raise LogError(f"{path}: {what} needs the package {package}: pip install 'uwserver[logs]'") from error
    except Exception as error:
        text = " ".join(str(error).split())[:_LONGEST]
        raise LogError(f"{path}: {what}: {text or 'damaged'} ({type(error).__name__})") from error

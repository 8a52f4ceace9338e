"""Names and files of compiled kernels: what a kernel is called in the cache, and which files may be read.

Kernels outside physics stand beside tables and fields, which change often. So their names contain a hash of their code alone (`fingerprint`): of the
function, of all that it calls, and of the constants that numba freezes into it; neither files nor line numbers count. Functions of physics count by
their names, as the name of the cache folder already depends on their sources.

A file is a line that names the folder for which it was made, a SHA-256 sum, and a pickle. Whoever can write a pickle that is read here can run any
code. So a folder or a file counts only if its owner is this user or root and nobody else can write to it. A file that is cut off, damaged, or made
for another folder counts as missing.
"""

from __future__ import annotations

import contextlib
import enum
import hashlib
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

PHYSICS = "uwserver.physics."
_SIZE = 12
_SUM = hashlib.sha256
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def names_of(code: CodeType) -> set[str]:
    """Return the names that a function, or a function defined in it, may look up."""
    return set(code.co_names).union(*(names_of(c) for c in code.co_consts if isinstance(c, CodeType)))


def fingerprint(function: Callable[..., Any]) -> str:
    """Return a hash of a function as written and of all that it may name; it is the same in every process of a version of Python."""
    digest = hashlib.sha256()
    _tell(function, lambda text: digest.update(text.encode() + b"\0"), {})
    return digest.hexdigest()[:_SIZE]


def kernel_name(function: Callable[..., Any]) -> str:
    """Return a kernel's module and name; outside physics with the hash of what it is made of."""
    name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
    return name if function.__module__.startswith(PHYSICS) else f"{name}+{fingerprint(function)}"


def _tell(value: Any, say: Callable[[str], None], ray_targets: dict[int, int]) -> None:
    """Pass a description of a value to `say`. Values that numba cannot compile are never part of a kernel, and are left out."""
    value = getattr(value, "py_func", value)
    if isinstance(value, FunctionType):
        _tell_function(value, say, ray_targets)
    elif isinstance(value, tuple | frozenset):
        say(f"{type(value).__qualname__} {len(value)}")
        for item in value if isinstance(value, tuple) else sorted(value, key=repr):
            _tell(item, say, ray_targets)
    elif isinstance(value, np.ndarray):
        say(f"array {value.dtype!r} {value.shape} {hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}")
    elif isinstance(value, type):
        members = list(value) if issubclass(value, enum.Enum) else getattr(value, "_fields", "")
        say(f"{value.__module__}.{value.__qualname__} {members!r}")
    elif isinstance(value, ModuleType | BuiltinFunctionType | np.ufunc):
        say(f"{value.__name__}")
    elif isinstance(value, CodeType):
        say(f"{value.co_code.hex()} {value.co_names} {value.co_varnames} {value.co_freevars}")
        for constant in value.co_consts:
            _tell(constant, say, ray_targets)
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | np.dtype | np.generic):
        say(f"{type(value).__name__} {value!r}")


def _tell_function(function: FunctionType, say: Callable[[str], None], ray_targets: dict[int, int]) -> None:
    if id(function) in ray_targets:
        say(f"again {ray_targets[id(function)]}")
        return
    ray_targets[id(function)] = len(ray_targets)
    say(f"{function.__module__}.{function.__qualname__}")
    if not function.__module__.startswith(PHYSICS):
        code = function.__code__
        # The docstring of a function is one of its constants.
        constants = tuple(c for c in code.co_consts if c != function.__doc__ or c is None)
        _tell(code.replace(co_consts=constants), say, ray_targets)
        _tell(function.__defaults__ or (), say, ray_targets)
        for name in sorted(names_of(code) & function.__globals__.keys()):
            say(name)
            _tell(function.__globals__[name], say, ray_targets)
    for cell in function.__closure__ or ():
        _tell(cell.cell_contents, say, ray_targets)


def _owned_safely(status: os.stat_result) -> bool:
    if not hasattr(os, "geteuid"):
        return True
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def fault_of(folder: Path) -> str:
    """Return why nothing is read from an existing folder; empty if it may be read.

    Raises:
        OSError: it cannot be inspected.
    """
    status = os.lstat(folder)
    if not stat.S_ISDIR(status.st_mode):
        return f"{folder} is a link or a file, not a folder"
    if not _owned_safely(status):
        return f"{folder} belongs to somebody else, or others may write it (chmod 700): not read"
    return ""


def read(folder: Path, name: str, packaged: bool = False) -> bytes | None:
    """Return what `write` got for this name; None if there is no sound file of that name.

    Args:
        folder: one without a `fault_of`.
        name: name of the file.
        packaged: whether the folder is part of the installed package; its files are then as trustworthy as the code beside them.
    """
    try:
        descriptor = os.open(folder / name, os.O_RDONLY | _NO_LINK)
        with os.fdopen(descriptor, "rb") as file:
            if not packaged and not _owned_safely(os.fstat(descriptor)):
                return None
            data = file.read()
    except OSError:
        return None
    head, _, rest = data.partition(b"\n")
    body = rest[_SUM().digest_size :]
    sound = head == folder.name.encode() and rest[: len(rest) - len(body)] == _SUM(body).digest() and body
    return body if sound else None


def write(folder: Path, name: str, body: bytes) -> None:
    """Keep bytes under a name, completely or not at all. If the folder is full or missing, nothing is kept."""
    with contextlib.suppress(OSError):
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:  # mode 0600
            path = Path(file.name)
            try:
                file.write(folder.name.encode() + b"\n" + _SUM(body).digest() + body)
                file.close()
                path.replace(folder / name)
            except OSError:
                path.unlink()
                raise

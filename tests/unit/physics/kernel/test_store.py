"""Names of kernels depend on all that they are made of. Of their files only sound and safe ones are read; all others count as missing."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwserver.physics.kernel import store
from uwserver.physics.kernel.store import fingerprint

BODY = b"a pickle"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "kernels-0123"
    made.mkdir(mode=0o700)
    store.write(made, "a.kernel", BODY)
    return made


def test_what_was_written_is_read_and_nobody_else_may(folder: Path) -> None:
    assert store.fault_of(folder) == ""
    assert store.read(folder, "a.kernel") == BODY
    assert store.read(folder, "b.kernel") is None
    assert [path.name for path in folder.iterdir()] == ["a.kernel"]
    assert (folder / "a.kernel").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("keep", [0, 1, 12, 20, 44, 45, -1])
def test_a_file_that_is_cut_off_is_as_none(folder: Path, keep: int) -> None:
    path = folder / "a.kernel"
    path.write_bytes(path.read_bytes()[:keep])
    assert store.read(folder, "a.kernel") is None


@pytest.mark.parametrize("place", [0, 13, 14, 45, -1])
def test_a_damaged_file_is_as_none(folder: Path, place: int) -> None:
    path = folder / "a.kernel"
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    assert store.read(folder, "a.kernel") is None


def test_a_file_of_another_folder_is_as_none(folder: Path) -> None:
    other = folder.rename(folder.with_name("kernels-4567"))
    assert store.read(other, "a.kernel") is None


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_can_write_is_not_read(folder: Path, mode: int) -> None:
    (folder / "a.kernel").chmod(mode)
    assert store.read(folder, "a.kernel") is None
    assert store.read(folder, "a.kernel", packaged=True) == BODY


def test_a_link_to_a_file_is_not_read(folder: Path) -> None:
    (folder / "b.kernel").symlink_to(folder / "a.kernel")
    assert store.read(folder, "b.kernel") is None


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_a_folder_that_others_can_write_is_a_fault(folder: Path, mode: int) -> None:
    folder.chmod(mode)
    assert "chmod 700" in store.fault_of(folder)


def test_a_link_to_a_folder_is_a_fault(folder: Path) -> None:
    link = folder.with_name("link")
    link.symlink_to(folder)
    assert "link" in store.fault_of(link)


def test_what_somebody_else_owns_is_not_read_and_what_root_owns_is(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    owned_by_root = user == 0
    assert (store.fault_of(folder) == "") is owned_by_root
    assert (store.read(folder, "a.kernel") == BODY) is owned_by_root
    if owned_by_root:
        os.chown(folder, 4321, -1)
        os.chown(folder / "a.kernel", 4321, -1)
        assert "somebody else" in store.fault_of(folder)
        assert store.read(folder, "a.kernel") is None


def test_a_folder_that_is_gone_keeps_nothing(tmp_path: Path) -> None:
    store.write(tmp_path / "gone", "a.kernel", BODY)
    assert not list(tmp_path.iterdir())


SOURCE = '''
import math
import numpy as np
GAIN, TABLE, NAMES = 2.0, np.array([1.0, 2.0]), frozenset({"a", "b", "c", "d", "f", "g", "h", "i"})
RECORD = np.dtype([("x", "f8")])


def inner(x):
    return GAIN * x


def outer(x, y=1):
    """A text."""
    # A comment.
    return math.sin(inner(x)) + TABLE[0] + len(NAMES) + np.zeros(1, RECORD)[0]["x"] + y
'''


def made(source: str = SOURCE) -> Callable[..., Any]:
    scope: dict[str, Any] = {"__name__": "elsewhere"}
    exec(source, scope)
    function: Callable[..., Any] = scope["outer"]
    return function


def test_lines_comments_texts_and_what_is_not_named_change_nothing() -> None:
    other = (
        SOURCE.replace("A comment.", "Another.").replace("A text.", "Another.").replace("def inner", "\n\ndef inner")
    )
    assert fingerprint(made(other + "\nMORE = 1\n")) == fingerprint(made())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("GAIN, TABLE, NAMES = 2.0", "GAIN, TABLE, NAMES = 3.0"),
        ("1.0, 2.0", "1.0, 2.5"),
        ('"c", "d"', '"c", "e"'),
        ('("x", "f8")]', '("x", "f8"), ("y", "f8")]'),
        ("return GAIN * x", "return GAIN + x"),
        ("math.sin", "math.cos"),
        ("y=1", "y=2"),
        ("[0]", "[1]"),
    ],
)
def test_each_constant_and_each_piece_of_code_counts(old: str, new: str) -> None:
    assert old in SOURCE
    assert fingerprint(made(SOURCE.replace(old, new))) != fingerprint(made())


def test_what_a_closure_holds_counts() -> None:
    def of(dtype: Any) -> Callable[[], Any]:
        return lambda: np.zeros(1, dtype)

    assert fingerprint(of(np.dtype("f8"))) != fingerprint(of(np.dtype("f4")))
    assert fingerprint(of(np.dtype("f8"))) == fingerprint(of(np.dtype("f8")))


def test_functions_that_call_themselves_have_one() -> None:
    def down(n: int) -> int:
        return 0 if n == 0 else down(n - 1)

    assert len(fingerprint(down)) == 12


def test_it_is_the_same_in_every_process() -> None:
    """Also of a set of texts, whose order is another in each."""
    run = f"scope = {{'__name__': 'elsewhere'}}; exec({SOURCE!r}, scope); print(fingerprint(scope['outer']))"
    code = f"from uwserver.physics.kernel.store import fingerprint; {run}"
    environment = os.environ | {"PYTHONHASHSEED": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert done.stdout.strip() == fingerprint(made())


def test_functions_of_physics_count_by_name() -> None:
    """The folder of the cache tells their sources."""

    def one() -> int:
        return 1

    def other() -> int:
        return 2

    for function in (one, other):
        function.__module__, function.__qualname__ = "uwserver.physics.kernel.linear", "rotation"
    assert fingerprint(one) == fingerprint(other)
    other.__module__ = "uwserver.frames"
    assert fingerprint(one) != fingerprint(other)

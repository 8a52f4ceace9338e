"""The hash of a kernel follows its code and what it names, and nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from uwserver.physics.kernel.fingerprint import fingerprint

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
    code = f"from uwserver.physics.kernel.fingerprint import fingerprint; {run}"
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
        function.__module__, function.__qualname__ = "uwserver.physics.kernel.rotation", "rotation"
    assert fingerprint(one) == fingerprint(other)
    other.__module__ = "uwserver.frames"
    assert fingerprint(one) != fingerprint(other)

"""Machine code for other CPUs: the same as a process makes for its own, and for aarch64 code of aarch64 with nothing of x86-64 in it."""

from __future__ import annotations

import json
import os
import platform
import struct
import subprocess
import sys
from pathlib import Path

import emitting
import pytest

from uwserver.physics.kernel import places
from uwserver.physics.kernel.compiled import LEVELS

ROOT = Path(__file__).parents[3]

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="emits from x86-64")

PROGRAM = """
import json, pickle, sys
sys.path.append(sys.argv[1])
import emitting
from uwserver.physics.kernel.compiled import LEVELS, entry, files_of

made = {}
levels = [emitting.Level(machine, *level) for machine, of_it in LEVELS.items() for level in of_it.items()]
emitting.emit(levels, lambda level, name, body: made.__setitem__(level.name, pickle.loads(body)[0][2][0].hex()))

import numpy
from uwserver.physics.kernel import atomics

@entry
def turn(places, a, b, out):
    atomics.pause()
    atomics.futex(places, 0, 129, 1)
    both = numpy.zeros(3)  # of numba's own memory
    for i in range(3):
        both[i] = a[i] * b[i] + out[i]
    out[:] = both

own = {}
turn._cache = files_of(turn.py_func, (), None, kept=False)
turn._cache._write = lambda name, body: own.__setitem__(0, pickle.loads(body)[0][2][0].hex())
places, one = numpy.zeros(8, numpy.int64), numpy.ones(3)
turn.load(places, one, one, one)
print(json.dumps({"own": own[0], **made}))
"""
ARM, X86 = 183, 62
"""Of an object file, as ELF numbers machines."""


@pytest.fixture(scope="module")
def made() -> dict[str, bytes]:
    """Object files of a kernel by kind of CPU, and that of the process itself, which compiles for x86-64-v3."""
    features = ",".join(f"+{feature}" for feature in LEVELS["x86_64"]["x86-64-v3"])
    environment = os.environ | {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": features}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(ROOT / "tools")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return {name: bytes.fromhex(code) for name, code in json.loads(done.stdout).items()}


def test_it_is_what_the_process_makes_for_itself(made: dict[str, bytes]) -> None:
    assert made["x86-64-v3"] == made["own"]
    assert made["x86-64"] != made["own"]


def test_there_is_code_of_every_machine(made: dict[str, bytes]) -> None:
    machines = {name: struct.unpack_from("<H", code, 18)[0] for name, code in made.items()}
    assert machines == {"own": X86, "x86-64-v3": X86, "x86-64": X86, "armv8-a": ARM}


def test_arm_waits_in_its_own_way_and_fuses_nothing(made: dict[str, bytes]) -> None:
    """Instructions of AArch64 are words: `hint #1` is YIELD; FMADD and FMLA (vector) multiply and add in one rounding."""
    words = [word for (word,) in struct.iter_unpack("<I", made["armv8-a"][: len(made["armv8-a"]) // 4 * 4])]
    assert 0xD503203F in words
    assert not [word for word in words if word & 0xFFE08000 in (0x1F400000, 0x1F600000)]
    assert not [word for word in words if word & 0xBFE0FC00 == 0x0E20CC00 | 0x00400000]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("call void @llvm.x86.sse2.mfence()", "llvm.x86.sse2.mfence"),
        ("call i64 (i64, ...) @syscall(i64 39, i64 0)", "no futex"),
    ],
)
def test_what_no_other_machine_has_is_refused(text: str, told: str) -> None:
    with pytest.raises(emitting.Untranslatable, match=told):
        emitting.translated(text, "aarch64")


def test_what_waits_is_translated() -> None:
    text = "declare void @llvm.x86.sse2.pause()\ncall void @llvm.x86.sse2.pause()\ncall i64 (i64, ...) @syscall(i64 202, i8* %a)\n"
    assert emitting.translated(text, "aarch64") == (
        "declare void @llvm.aarch64.hint(i32)\ncall void @llvm.aarch64.hint(i32 1)\n"
        "call i64 (i64, ...) @syscall(i64 98, i8* %a)\n"
    )


def test_the_numbers_are_those_of_the_waiting_code() -> None:
    """`places` says what a machine has; here both sides of the translation stand."""
    text = Path(places.__file__).read_text()
    assert '"x86_64": 202' in text
    assert '"aarch64": 98' in text
    assert '"aarch64": ("llvm.aarch64.hint", 1)' in text

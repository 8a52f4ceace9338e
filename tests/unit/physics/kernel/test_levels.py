"""Kernels of wheels: made for kinds of CPU, not for the building machine's, and with the same results on each."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from functools import cache

import pytest

from uwserver.physics.kernel.compiled import LEVELS

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")

MADD = """
import numpy, sys
from uwserver.physics.kernel.compiled import entry
@entry
def madd(a, b, c, out):
    for i in range(len(a)):
        out[i] = a[i] * b[i] + c[i]
out, one, small = numpy.empty(64), numpy.ones(64), 2.0**-30
madd(one + small, one - small, -one, out)
assert not out.any(), "rounded once: multiplication and addition were fused"
sys.stdout.write("".join(madd.inspect_asm().values()))
"""
"""(1 + e)(1 - e) - 1 is 0 where the product is rounded, as IEEE and Python have it, and -e^2 where it is not."""
HASHES = """
import uwserver
for name, vehicle in {scenarios}.items():
    world = uwserver.load(name)
    for n in range(100):
        world.command(vehicle + "/thrusters", u=[0.2, -0.1, 0.3, 0.1, *[0.6 - 0.01 * n] * 4])
        world.step(100)
    print(name, world.call("world/state_hash")["hash"])
"""
SCENARIOS = {"bluerov2_open_sea": "bluerov2", "slope": "rov", "one_of_everything": "heavy"}
"""With the vehicle that is driven: currents and waves; vehicles with and without fins, and things in contact with a grid; every sensor."""


@cache
def printed(program: str, level: str | None) -> str:
    """By a Python whose kernels are compiled for a level, or for the CPU of this machine."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU")}
    if level is not None:
        features = ",".join(f"+{feature}" for feature in LEVELS["x86_64"][level])
        environment |= {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": features}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=1500
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("level", ["x86-64-v3", pytest.param("x86-64", marks=pytest.mark.slow), None])
def test_multiplication_and_addition_are_never_fused(level: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    if level is None:
        exec(MADD, {"__name__": "here"})
        code = capsys.readouterr().out
    else:
        code = printed(MADD, level)
    assert "mulpd" in code
    assert "vfmadd" not in code


@pytest.mark.slow  # numba's own affair, but for the settings
def test_code_for_a_level_has_nothing_of_the_builders_cpu() -> None:
    best, least = printed(MADD, "x86-64-v3"), printed(MADD, "x86-64")
    assert "%ymm" in best
    assert "%zmm" not in best
    assert "%ymm" not in least


@pytest.mark.slow  # compiles most of the physics for each level, when that is not in the user's cache
@pytest.mark.parametrize("level", LEVELS["x86_64"])
def test_ten_thousand_ticks_give_the_same_state_for_every_cpu(level: str) -> None:
    program = HASHES.format(scenarios=SCENARIOS)
    ours = printed(program, None)
    assert len(ours.splitlines()) == len(SCENARIOS)
    assert printed(program, level) == ours

"""Kernels that Python calls are compiled ahead."""

from __future__ import annotations

import re
from importlib.util import find_spec

from sources import modules

from uwserver.physics.kernel.compiled import ENTRY_KERNELS

ENTRY = re.compile(r"^@entry\ndef ([a-z]\w*)", re.MULTILINE)


def test_each_kernel_that_python_calls_is_compiled_ahead() -> None:
    """One that is not listed would be compiled where somebody waits for it. Those of our own tree of rays are needed where Embree is not there."""
    listed = {name for names in ENTRY_KERNELS.values() for name in names}
    found: set[str] = set()
    for module in modules("uwserver"):
        stem = module.path.stem
        if module.part == "physics" and (stem != "tree" or not find_spec("embreex")):
            found |= {f"{stem}.{name}" for name in ENTRY.findall(module.text)}
    assert len(found) > 20
    assert found <= listed

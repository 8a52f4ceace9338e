"""The shell command that installs a package for the Python that runs."""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

_OWN = re.compile(r"uwserver(?:\[(\w+)\])?")
"""Requirement for this distribution itself or one of its extras."""


def install_command(*requirements: str) -> str:
    """Return one shell command that installs all requirements, with our own extras in one requirement.

    It names the interpreter that runs, unless the `pip` that a shell finds belongs to it: the first `pip` on PATH often installs elsewhere.
    """
    wanted = sorted(set(requirements))
    own = [found[1] for each in wanted if (found := _OWN.fullmatch(each))]
    extras = ",".join(extra for extra in own if extra)
    whole = [f"uwserver[{extras}]" if extras else "uwserver"] if own else []
    whole += [each for each in wanted if not _OWN.fullmatch(each)]
    quoted = (each if re.fullmatch(r"[\w.-]+", each) else f'"{each}"' for each in whole)
    return f"{_pip_install()} {' '.join(quoted)}"


def _pip_install() -> str:
    python = Path(sys.executable or "python")
    pip = shutil.which("pip")
    if not sys.executable or (pip is not None and Path(pip).parent == python.parent):
        return "pip install"
    here = Path.cwd()
    name = shlex.quote(str(python.relative_to(here) if python.is_relative_to(here) else python))
    if find_spec("pip") is None and shutil.which("uv") is not None:
        return f"uv pip install --python {name}"
    return f"{name} -m pip install"

"""An installed version of uwserver: its Python, and an environment in which its processes do not see the other version."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uwserver_bench.processes import BenchFailed

PACKAGES = ("uwserver", "numpy", "numba", "msgspec")
EXTRAS = ("pymavlink", "zenoh")
"""Packages that some adapters need."""
_FACTS = """
import json, platform
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
import uwserver
print(json.dumps({
    "folder": str(Path(uwserver.__file__).parent),
    "python": platform.python_version(),
    "packages": {name: metadata.version(name) for name in PACKAGES},
    "extras": [name for name in EXTRAS if find_spec(name)],
    "distributions": len({distribution.name for distribution in metadata.distributions()}),
}))
"""


@dataclass(frozen=True)
class Installation:
    """A Python that imports one version of uwserver.

    Attributes:
        side: "ours" or "theirs".
        python: program of its Python.
        environment: environment variables of its processes.
    """

    side: str
    python: str
    environment: Mapping[str, str]

    def facts(self, place: Path) -> Mapping[str, Any]:
        """Return folder of the package, version of Python, versions of packages, the installed extras, and the number of distributions.

        Args:
            place: an empty working directory; Python would look for packages in any other.

        Raises:
            BenchFailed: uwserver is not installed there.
        """
        code = f"PACKAGES, EXTRAS = {PACKAGES!r}, {EXTRAS!r}\n{_FACTS}"
        done = subprocess.run(
            [self.python, "-c", code], cwd=place, env=dict(self.environment), capture_output=True, text=True, check=False
        )  # fmt: skip
        if done.returncode != 0:
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            raise BenchFailed(f"{self.python} cannot import uwserver: {last}")
        facts: dict[str, Any] = json.loads(done.stdout)
        return facts


def ours() -> Installation:
    """Return the installation that runs this command."""
    return Installation("ours", sys.executable, dict(os.environ))


def theirs(venv: Path) -> Installation:
    """Return the installation in another virtual environment.

    Raises:
        BenchFailed: there is no Python in the folder.
    """
    python = venv.absolute() / "bin" / "python"
    if not python.is_file():
        raise BenchFailed(f"{venv} is no virtual environment: {python} is missing. Make one: python -m venv {venv}")
    # With PYTHONPATH it would find our version, and our settings are not meant for it.
    foreign = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return Installation("theirs", str(python), foreign)

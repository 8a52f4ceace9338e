"""Writes requirements.lock: all packages of the container image with version and hashes, so that two builds of one commit hold the same.

Needs uv, and asks the package index. Versions that the file has stay as they are while they fit pyproject.toml; `--upgrade` takes the newest.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
PROJECTS = (ROOT / "pyproject.toml", ROOT / "clients" / "python" / "pyproject.toml")
NOT_FOR_SERVING = ("coal", "dev", "docs", "release", "site")
"""Extras of which the image needs nothing; it has one engine for contacts."""
ONLY = {"embreex": "platform_machine == 'x86_64'"}
"""Where there is a wheel of what comes in no other form; elsewhere the image is built without it, and rays take a slower way."""


def name_of(requirement: str) -> str:
    """Name of a distribution as PEP 503 writes it: ``Msg_Pack[a]>=1`` is ``msg-pack``."""
    found = re.match(r"[\w.-]+", requirement)
    if found is None:
        raise ValueError(f"{requirement!r} is no requirement")
    return re.sub(r"[-_.]+", "-", found.group()).lower()


def requirements() -> list[str]:
    """What the image needs by pyproject.toml of both projects: to build them, to run, and for each extra that serves; without themselves."""
    wanted, own = set[str](), set[str]()
    for path in PROJECTS:
        tables = tomllib.loads(path.read_text())
        project = tables["project"]
        own.add(name_of(project["name"]))
        extras = project.get("optional-dependencies", {})
        wanted.update(tables["build-system"]["requires"], project["dependencies"])
        wanted.update(each for extra, needs in extras.items() if extra not in NOT_FOR_SERVING for each in needs)
    return sorted(_where_it_is(each) for each in wanted if name_of(each) not in own)


def _where_it_is(requirement: str) -> str:
    marker = ONLY.get(name_of(requirement))
    return requirement if marker is None or ";" in requirement else f"{requirement}; {marker}"


def main() -> None:
    """Write the file."""
    command = ["uv", "pip", "compile", "-", "--no-config", "--quiet", "--universal", "--python-version", "3.11"]
    command += ["--generate-hashes", "--custom-compile-command", "make lock", "--output-file", str(LOCK), *sys.argv[1:]]
    subprocess.run(command, input="\n".join(requirements()), text=True, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()

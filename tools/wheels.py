"""Builds source distributions of uwserver, uwclient and the benchmark and wheels from these, once for what they are made of: every tool and test
that needs wheels of this checkout takes them from here. Prints their folder.

Below build/wheels each folder carries a hash of all files that go in, and of the environment that builds: what has changed has another folder, and
nobody gets a wheel that is older than the checkout. One builds at a time, and a folder is there once all is in it.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "uwserver": (ROOT, ("uwserver", "adapters/uwserver_adapters", "scenarios/uwserver_scenarios")),
    "uwclient": (ROOT / "clients" / "python", ("uwclient",)),
    "uwserver_bench": (ROOT / "bench", ("uwserver_bench",)),
}
"""Distributions: the folder of each, and its packages in there."""
GO_IN = (
    ".gitignore", "CHANGELOG.md", "LICENSE", "README.md", "pyproject.toml", "adapters", "bench", "clients/python", "clients/web", "scenarios",
    "uwserver", "tools/wheels.py",
)  # fmt: skip
"""Files and folders of the checkout that decide what is in a wheel or source distribution."""
SCHEMAS = ("scenario", "vehicle", "device")
"""Kinds of file whose JSON Schema is made for the wheel; git does not keep them."""
BUILT = ROOT / "build" / "wheels"
KEPT = 2
"""Folders of wheels that stay; the oldest go."""
TIMEOUT_S = 900.0


class Fault(Exception):
    """What is wrong with a wheel."""


def run(*command: str | Path, cwd: Path, environment: dict[str, str] | None = None, timeout: float = TIMEOUT_S) -> str:
    """Output of a command that must succeed."""
    done = subprocess.run(
        list(map(str, command)),
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    if done.returncode != 0:
        raise Fault(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def expected_files(project: Path, folders: tuple[str, ...]) -> set[str]:
    """Paths that the wheel must hold: every file of the packages in the checkout but byte code, and of the page and of what reports
    plot with, where the server is."""
    places = {project / folder: (project / folder).name for folder in folders}
    if project == ROOT:
        places[ROOT / "clients" / "web"] = "uwserver_adapters/web/page"
        places[ROOT / "clients" / "web" / "vendor" / "uplot-1.6.32"] = "uwserver/recording/report/uplot"
    return {
        f"{place}/{path.relative_to(folder)}"
        for folder, place in places.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def make_schemas() -> None:
    """Write the JSON Schemas to where the wheel takes them from, as `make docs` does."""
    folder = ROOT / "uwserver" / "schemas"
    folder.mkdir(exist_ok=True)
    for kind in SCHEMAS:
        text = run(sys.executable, "-m", "uwserver", "schema", f"--{kind}", cwd=ROOT)
        path = folder / f"{kind}.schema.json"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def build(name: str, out: Path) -> Path:
    """The wheel of a distribution, built from its source distribution, with its contents compared with the checkout.

    Raises:
        Fault: a file is missing, or too much.
    """
    project, folders = PACKAGES[name]
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, project, cwd=out)
    (wheel,) = out.glob(f"{name}-*-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        inside = {path for path in archive.namelist() if ".dist-info/" not in path}
        licensed = any(path.endswith("LICENSE") for path in archive.namelist())
    expected = expected_files(project, folders)
    if inside != expected or not licensed:
        raise Fault(
            f"{wheel.name}: missing {sorted(expected - inside)}, unexpected {sorted(inside - expected)}, LICENSE: {licensed}"
        )
    print(f"{wheel.name}: {len(inside)} files, {wheel.stat().st_size // 1024} KiB")
    return wheel


def build_all(out: Path) -> dict[str, Path]:
    """The wheels of all distributions, with the source distributions beside them.

    Raises:
        Fault: see `build`.
    """
    make_schemas()
    return {name: build(name, out) for name in PACKAGES}


def sources() -> Iterator[Path]:
    """All files that go in. JSON Schemas are made of the others; caches are named with a point."""
    for name in GO_IN:
        if (ROOT / name).is_file():
            yield ROOT / name
        for place, below, files in os.walk(ROOT / name):
            below[:] = sorted(inner for inner in below if inner != "__pycache__" and not inner.startswith("."))
            yield from (Path(place) / file for file in sorted(files) if not file.endswith(".schema.json"))


def made_of() -> str:
    """Hash of all that decides what is in the wheels."""
    digest = hashlib.sha256(f"{sys.version}\0{sorted((d.name, d.version) for d in distributions())}".encode())
    for path in sources():
        content = path.read_bytes()
        digest.update(f"\0{path.relative_to(ROOT)}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


def folder() -> Path:
    """Where wheels and source distributions of this checkout are, as it is now: built if they are not there.

    Raises:
        Fault: a wheel is not right, or files change while it is built.
    """
    BUILT.mkdir(parents=True, exist_ok=True)
    with (BUILT / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        there = BUILT / made_of()
        if not there.is_dir():
            _build_into(there)
        there.touch()
        made = sorted((path for path in BUILT.iterdir() if path.is_dir()), key=lambda path: path.stat().st_mtime)
        for old in made[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)
    return there


def _build_into(there: Path) -> None:
    with tempfile.TemporaryDirectory(dir=BUILT, prefix="part-") as work:
        part = Path(work) / "all"
        part.mkdir()
        build_all(part)
        if BUILT / made_of() != there:
            raise Fault("files were changed while the wheels were built: once more, please")
        part.rename(there)


def of_checkout() -> dict[str, Path]:
    """The wheel of each distribution of this checkout, as it is now.

    Raises:
        Fault: see `folder`.
    """
    there = folder()
    return {name: next(there.glob(f"{name}-*-py3-none-any.whl")) for name in PACKAGES}


def main() -> int:
    """Build, and say where."""
    try:
        print(folder().relative_to(ROOT))
    except Fault as fault:
        print(f"wheels: {fault}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

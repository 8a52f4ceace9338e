"""Tries uwserver with the other CPythons of this machine; exits with 1 if anything failed there.

Each gets a fresh environment with the wheels of this checkout, and there what can differ by the version of Python: every module is imported, with
warnings as errors; schemas, and the doctor at a scenario with every kind of table; a server with a client; and `TESTS`. A world that is stepped
needs kernels, and these take minutes of processor time for each Python: the server plays a recording that this Python has made, and the only kernels
that are compiled are small. `--all` compiles all, checks every scenario, runs each scenario with something solid, and the tests of `MORE_TESTS`.

What uwserver depends on is installed once for each Python, into the user's cache, and anew when what is needed changes; kernels likewise compile
once. Versions that are not on the machine are skipped, with a line that says so. The wall time of each part is printed, and the processor time
of all.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeAlias

from wheels import ROOT, Fault, of_checkout

VERSIONS = ("3.10", "3.12", "3.13")
EXTRAS = "solid"
TESTING = ("pytest>=8.2", "hypothesis>=6.100", "msgpack>=1.0", "jsonschema>=4.20", "pyserial>=3.5")
SHIPPED = ROOT / "scenarios" / "uwserver_scenarios"
SOLID = ("pool_inspection", "subsea_template", "slope", "push_the_crate", "remus_survey", "one_of_everything")
TESTS = {
    "unit/scenario/files/test_documents.py::test_what_cannot_be_read_is_told_with_its_position": "TOML: tomli before 3.11, tomllib then",
    "unit/logfiles/test_timebase.py::test_instants": "datetime.fromisoformat takes less in 3.10",
    "unit/adapter/test_contract.py::test_broken_ones_do_not_keep_others_from_loading": "entry points, and what imports raise",
    "unit/adapter/test_listening.py::test_a_server_ends_with_all_its_peers": "a server of asyncio waits for its connections from 3.12 on",
    "unit/adapter/test_connection.py::test_the_end_waits_for_peers_but_not_for_those_who_do_not_read": "streams and time limits of asyncio",
    "unit/adapter/test_threads.py::test_cancelled_work_still_ends_first": "how asyncio cancels, and waits for threads",
    "unit/adapter/test_tls.py::test_an_authority_makes_certificates_of_clients_a_duty": "3.13 is stricter with certificates",
    "unit/adapters/native/test_codec.py": "msgspec, json, and numbers as text",
    "unit/server/test_process.py": "the loop, and signals on loops that know them and on others",
    "unit/client/test_sync.py::test_drive_and_read": "sockets and threads of the client",
    "unit/client/test_aio.py::test_progress_and_cancelled_task": "streams of the client, and how its tasks are cancelled",
    "unit/physics/kernel/test_store.py": "kernels are kept by their byte code",
    "unit/physics/collision/test_coal_engine.py": "the engine from 3.12 on; before it is that of the Python that has all tests",
}  # fmt: skip
"""Below tests/: what can differ, and why. No kernels are needed."""
MORE_TESTS = (
    "tests/unit/ports",
    "tests/unit/adapter",
    "tests/unit/adapters/native",
    "tests/unit/adapters/moos",
    "tests/unit/physics/collision/test_engine.py",
    "tests/unit/physics/collision/test_solids.py",
    "tests/physics/test_contact.py",
)
IMPORTS = f"""import importlib, pathlib, pkgutil, re, sys, warnings
warnings.filterwarnings("error", module="(.*/site-packages/)?uw(server|client)")
standard, packages = {sorted(sys.stdlib_module_names)!r}, ("uwserver", "uwserver_adapters", "uwserver_scenarios", "uwclient")
modules, without = [], []
for package in packages:
    path = importlib.import_module(package).__path__
    modules += [found.name for found in pkgutil.walk_packages(path, package + ".") if not found.name.endswith("__main__")]
for name in modules:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in packages or missing in standard or missing in sys.stdlib_module_names:
            raise
        without.append(missing)  # of an extra that is not installed
assert len(modules) > 600 and len(without) < 20, (len(modules), without)

import uwserver
from uwserver.scenario.authoring.catalogue import FILES, json_schema
for kind in FILES:
    made = pathlib.Path(uwserver.__file__).with_name("schemas") / f"{{kind}}.schema.json"
    # From 3.13 on docstrings begin at the margin.
    there, here = (re.sub(r"(?:\\\\n|\\s)+", " ", text) for text in (made.read_text(encoding="utf-8"), json_schema(kind)))
    assert there == here, f"the schema of a {{kind}} is another than in the wheel"
"""
"""Imports every module, with warnings as errors; what one Python has in its standard library and another has not is no extra. Then the types of all
tables say what they said to the Python that made the wheel."""
SERVED = """import re, signal, subprocess, sys
import uwclient
command = sys.argv[1], "play", sys.argv[2], "--port", "0", "--loop"
with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
    try:
        found = next(found for line in server.stdout if (found := re.search(r"tcp: 127\\.0\\.0\\.1:(\\d+)", line)))
        with uwclient.connect(port=int(found[1])) as client:
            client.subscribe("**")
            ports = {client.read().port for _ in range(300)}
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0, server.returncode
    finally:
        server.kill()
assert len(ports) >= 5, ports
"""
"""A recording is played until its samples have come, and the server ends when it is told."""
RUN_TESTS = """import os, sys
import pytest
os.chdir(sys.argv[1])
sys.path.append("bench")  # where the proofs are
sys.exit(pytest.main(["-q", "-m", "not slow", "-p", "no:cacheprovider", *sys.argv[2:]]))
"""
"""As a file: with `python -m pytest` the checkout would stand before the wheel."""
PROJECTS = {"uwserver": ROOT, "uwclient": ROOT / "clients" / "python"}
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python")
FREERUN = ("--port", "0", "--mode", "freerun", "--until")
RECORDING = "recording.mcap"
BORROW = "import site; site.addsitedir({!r})\n"
KEPT = 2
"""Environments kept of each Python; the oldest go."""
TIMEOUT_S = 1800.0


Parts: TypeAlias = "tuple[tuple[str, tuple[tuple[str | Path, ...], ...]], ...]"
"""Names of parts, and the commands of each."""


class Failed(Exception):
    """A command that did not succeed, with what it printed."""


def interpreter(version: str) -> Path | None:
    """Python of a version: below `pyenv root`, else on the PATH; None if there is none."""
    for root in _pyenv_roots():
        found = sorted(root.glob(f"versions/{version}.*/bin/python"), key=_numbers)
        if found:
            return found[-1]
    there = shutil.which(f"python{version}")
    if there is None or subprocess.run([there, "-c", ""], capture_output=True, timeout=60.0, check=False).returncode:
        return None  # pyenv leaves a shim of each version that any folder uses
    return Path(there)


def _numbers(path: Path) -> list[int]:
    return [int(part) for part in path.parents[1].name.split(".") if part.isdigit()]


def _pyenv_roots() -> Iterator[Path]:
    if os.environ.get("PYENV_ROOT"):
        yield Path(os.environ["PYENV_ROOT"])
    if shutil.which("pyenv"):
        yield Path(subprocess.run(["pyenv", "root"], capture_output=True, text=True, check=True).stdout.strip())


def run(*command: str | Path, cwd: Path, fails: bool = False) -> str:
    """Output of a command that must succeed, unless it says itself what fails; without the settings of this checkout."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        list(map(str, command)),
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    if done.returncode != 0 and not fails:
        raise Failed(
            f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout[-8000:]}{done.stderr[-8000:]}"
        )
    return done.stdout


def cache() -> Path:
    """Where environments with the dependencies are kept: outside of any checkout."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "uwserver" / "pythons"


def dependencies(version: str, python: Path, wheels: tuple[Path, ...]) -> Path:
    """Folder with what uwserver and these tests need for one Python; made if there is none for what is needed now."""
    needed = hashlib.sha256(f"{python} {EXTRAS} {TESTING}".encode())
    for project in PROJECTS.values():
        needed.update((project / "pyproject.toml").read_bytes())
    folder = cache() / f"{version}-{needed.hexdigest()[:12]}"
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        # Of two that make it at once, the first to end has made it; nobody sees half of one.
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f"{version}-part-") as work:
            part = Path(work) / "env"
            run(python, "-m", "venv", "--without-pip", part, cwd=folder.parent)
            server, *others = wheels
            # Byte code of what is imported comes with the first import: that of all takes longer than the rest.
            install = (*PIP, part / "bin" / "python", "install", "--quiet", "--no-compile")
            run(*install, f"uwserver[{EXTRAS}] @ {server.as_uri()}", *others, *TESTING, cwd=folder.parent)
            run(*PIP, part / "bin" / "python", "uninstall", "--quiet", "--yes", *PROJECTS, cwd=folder.parent)
            if not folder.is_dir():
                part.rename(folder)
    folder.touch()
    made = [path for path in folder.parent.glob(f"{version}-*") if "part" not in path.name]
    for old in sorted(made, key=lambda path: path.stat().st_mtime)[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return folder / "lib" / f"python{version}" / "site-packages"


def environment(version: str, python: Path, wheels: tuple[Path, ...], home: Path) -> None:
    """A fresh environment with the wheels, which borrows what they depend on."""
    borrowed = dependencies(version, python, wheels)
    run(python, "-m", "venv", "--without-pip", home, cwd=ROOT)
    own = home / "lib" / f"python{version}" / "site-packages"
    (own / "dependencies.pth").write_text(BORROW.format(str(borrowed)))
    install = (*PIP, home / "bin" / "python", "install", "--quiet", "--no-compile", "--no-deps", "--no-index")
    run(*install, "--ignore-installed", *wheels, cwd=ROOT)


def record(path: Path) -> None:
    """Write what servers play."""
    run(sys.executable, "-m", "uwserver", "run", *FREERUN, "1.0", "--record", path, cwd=path.parent)


def scripts(work: Path) -> dict[str, Path]:
    """The programs above as files."""
    texts = {"imports": IMPORTS, "served": SERVED, "run_tests": RUN_TESTS}
    for name, text in texts.items():
        (work / f"{name}.py").write_text(text)
    return {name: work / f"{name}.py" for name in texts}


def daily(home: Path, work: Path) -> Parts:
    """What can differ by the version of Python."""
    python, server, program = home / "bin" / "python", home / "bin" / "uwserver", scripts(work)
    return (
        ("all modules and schemas", ((python, program["imports"]),)),
        ("a recording served", ((python, program["served"], server, work / RECORDING),)),
        ("tests", ((python, program["run_tests"], ROOT, *(f"tests/{test}" for test in TESTS)),)),
    )


def all_else(home: Path, work: Path) -> Parts:
    """With all kernels."""
    python, server, program = home / "bin" / "python", home / "bin" / "uwserver", scripts(work)
    shipped = sorted(path.stem for path in SHIPPED.glob("*.toml"))
    return (
        ("all checks", ((server, "check", *shipped),)),
        ("all kernels", ((python, "-m", "uwserver.world.warm"),)),
        ("default scenario", ((server, "run", *FREERUN, "0.5"),)),
        ("solid scenarios", tuple((server, "run", name, *FREERUN, "0.2") for name in SOLID)),
        ("codecs and contacts", ((python, program["run_tests"], ROOT, *MORE_TESTS),)),
    )


def examine(home: Path) -> None:
    """The doctor finds all that a scenario with every kind of table needs; whoever has the default port is no matter. Raises Failed."""
    server = home / "bin" / "uwserver"
    found = json.loads(run(server, "doctor", "--json", "one_of_everything", cwd=home, fails=True))["findings"]
    faults = [finding for finding in found if finding["level"] == "fault" and not finding["name"].startswith("port")]
    if faults:
        raise Failed(f"{server} doctor: {faults}")


def try_one(version: str, python: Path, wheels: tuple[Path, ...], work: Path, everything: bool) -> None:
    """All parts with one Python. Raises Failed."""
    home = work / version
    with timed(version, "environment"):
        environment(version, python, wheels, home)
    with timed(version, "doctor"):
        examine(home)
    for name, commands in (*daily(home, work), *(all_else(home, work) if everything else ())):
        with timed(version, name):
            for command in commands:
                run(*command, cwd=work)


class timed:  # read as a statement
    """Prints how long a part took."""

    def __init__(self, version: str, part: str) -> None:
        self._label, self._begin = f"python {version}: {part}", 0.0

    def __enter__(self) -> None:
        self._begin = time.monotonic()

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        outcome = "ok" if kind is None else "FAILED"
        print(f"{self._label}: {outcome}, {time.monotonic() - self._begin:.0f} s", flush=True)


def _processor_s() -> float:
    """Processor time of all commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(versions: tuple[str, ...], everything: bool) -> int:
    """Try some versions, as many at a time as there are cores; returns 1 if one failed."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        with timed(f"{sys.version_info[0]}.{sys.version_info[1]}", "wheels and a recording"):
            built = of_checkout()
            wheels = tuple(built[name] for name in PROJECTS)
            record(work / RECORDING)

        def succeeds(version: str) -> bool:
            python = interpreter(version)
            if python is None:
                print(f"python {version}: skipped, neither below `pyenv root` nor on the PATH", flush=True)
                return True
            try:
                with timed(version, "all"):
                    try_one(version, python, wheels, work, everything)
            except (Failed, subprocess.TimeoutExpired) as error:
                print(error, file=sys.stderr, flush=True)
                return False
            return True

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            done = list(pool.map(succeeds, versions))
        print(f"{_processor_s():.0f} s of processors", flush=True)
    return 0 if all(done) else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("versions", nargs="*", default=VERSIONS, help=f"default: {' '.join(VERSIONS)}")
    parser.add_argument(
        "--all", action="store_true", help="with all kernels, scenarios and tests: minutes for each Python"
    )
    options = parser.parse_args()
    try:
        sys.exit(main(tuple(options.versions), options.all))
    except (Failed, Fault) as fault:
        sys.exit(str(fault))

"""Installs the wheels of this checkout (tools/wheels.py) in a fresh environment and uses them there; exits with 1 at the first fault. The
benchmark comes last: before, `uwserver bench` must say what to install.

By default the environment borrows the dependencies of the environment that runs this script, and only the wheels are installed. Kernels are then
those that this user has, which every environment with the same sources shares, but for one stage that is compiled into an empty cache.
`--dependencies` installs all dependencies too, as a user's pip would, watches how much that is, and begins with no kernel at all. `--dist DIR`
does so as well, and takes the wheels of a folder, as `make dist` left them: those with compiled kernels must not compile anything.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import sysconfig
import tempfile
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wheels import PACKAGES, ROOT, SCHEMAS, TIMEOUT_S, Fault, of_checkout, run

BENCHMARK = "uwserver_bench"
MODULES = ("uwserver", "uwserver_adapters.sockets", "uwserver_scenarios", "uwclient")
WHERE = "import sys, importlib; print(*(importlib.import_module(name).__file__ for name in sys.argv[1:]), sep='\\n')"
COMMANDS = (
    ("uwserver", "--version"),
    ("uwserver", "list"),
    ("uwserver", "check", "bluerov2_pool"),
    ("uwclient", "--help"),
    ("uwserver", "validate", str(ROOT / "tests" / "physics" / "oracles" / "spheroid_1.json")),
    ("uwserver", "run", "--port", "0", "--until", "0.5", "--mode", "freerun"),
)
FINISHED = ("push_the_crate", "slope", "bluerov2_open_sea")
"""Scenarios that between them need most kernels; run where a wheel brings these."""
COPIES = """
schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
[vehicles.rov.autopilot]
[vehicles.rov.sensors]
ahrs = { kind = "attitude", profile = "mems_ahrs", rate_hz = 60 }
dvl = { kind = "dvl", profile = "a50", rate_hz = 8 }
"""
COPIED = ("copies.toml", "bluerov2_pool", "bluerov2_open_sea")
"""Of which copies are stepped there too: the first is the scenario `COPIES`."""
BATCH = "import sys, uwserver; uwserver.batch(sys.argv[1], 2).step(30)"
STAGE = "sea"
"""Of the stages of kernels the quickest, compiled into an empty cache."""
COMPILE = f"""
from uwserver.physics.kernel.compiled import cache_state
from uwserver.world.builds import kernels_of, prepare, progress
prepare(["{STAGE}"], progress())
print(cache_state.folder, *cache_state.missing(kernels_of("{STAGE}")))
"""
PAGE = ROOT / "clients" / "web"
PAGE_KINDS = (".html", ".js", ".css", ".json", ".svg")
INSTALLED_MB, DOWNLOAD_SLACK = 1000.0, 0.1
"""What all default dependencies may take on the disk, and how far the download may be from the figure in the README."""
PAGE_TESTS = "keys_steer or contend"
"""Of the tests of the page, those that are repeated with the installed server."""


def install(python: Path, wheels: list[Path], dependencies: bool, work: Path) -> None:
    """Put wheels into the environment of a Python."""
    pip = (sys.executable, "-m", "pip", "--python", python)
    if not dependencies:
        run(*pip, "install", "--quiet", "--no-deps", "--no-compile", *wheels, cwd=work)
        return
    stock = work / "stock"
    run(*pip, "download", "--quiet", "--find-links", wheels[0].parent, "--dest", stock, *wheels, cwd=work)
    run(*pip, "install", "--quiet", "--no-index", "--find-links", stock, *wheels, cwd=work)


def weigh(environment: Path, stock: Path) -> None:
    """Compare what was downloaded and installed with what is promised."""
    download, installed = megabytes(stock), megabytes(environment)
    print(f"default dependencies: {download:.0f} MB to download, {installed:.0f} MB installed")
    found = re.search(r"\b(\d+) MB to download", (ROOT / "README.md").read_text(encoding="utf-8"))
    if found is None or abs(download / float(found[1]) - 1.0) > DOWNLOAD_SLACK:
        raise Fault(f"{download:.0f} MB were downloaded: write that into README.md, which says {found and found[0]}")
    if installed > INSTALLED_MB:
        raise Fault(f"{installed:.0f} MB were installed, {INSTALLED_MB:.0f} at most: which dependency has grown?")


def megabytes(folder: Path) -> float:
    """Size of all files below a folder, 10^6 bytes."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()) / 1e6


def environment_with(wheels: list[Path], folder: Path, dependencies: bool) -> Path:
    """A fresh environment with the wheels; returns its folder of scripts."""
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    python = folder / "bin" / "python"
    install(python, wheels, dependencies, folder.parent)
    if dependencies:
        weigh(folder, folder.parent / "stock")
    else:
        # Path entries of a .pth file are not searched for further .pth files, so an editable install over there stays out.
        packages = Path(
            run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder.parent).strip()
        )
        (packages / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin"


def clean_environment(work: Path, fresh: bool) -> dict[str, str]:
    """Without the settings of this checkout; with a kernel cache of its own, or the user's."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_"))}
    return environment | ({"XDG_CACHE_HOME": str(work / "cache")} if fresh else {})


def use(scripts: Path, work: Path, fresh: bool) -> None:
    """Import and run what was installed, far from the checkout."""
    environment = clean_environment(work, fresh)
    found = run(scripts / "python", "-c", WHERE, *MODULES, cwd=work, environment=environment).split()
    for module, place in zip(MODULES, found, strict=True):
        if not Path(place).is_relative_to(scripts.parent):
            raise Fault(f"{module} comes from {place}, not from its wheel")
    for name, *arguments in COMMANDS:
        run(scripts / name, *arguments, cwd=work, environment=environment)
        print(f"{name} {' '.join(arguments)}: ok")
    for kind in SCHEMAS:
        (shipped,) = scripts.parent.glob(f"lib/python*/site-packages/uwserver/schemas/{kind}.schema.json")
        if shipped.read_text(encoding="utf-8") != run(
            scripts / "uwserver", "schema", f"--{kind}", cwd=work, environment=environment
        ):
            raise Fault(f"{shipped.name} in the wheel is not what `uwserver schema --{kind}` prints")
    fetch_page(scripts, work, environment)


def fetch_page(scripts: Path, work: Path, environment: dict[str, str]) -> None:
    """The page that the installed server serves is that of the checkout; and the server ends when it is told."""
    wanted = {f"/{path.relative_to(PAGE)}": path for path in PAGE.rglob("*") if path.suffix in PAGE_KINDS}
    with served(scripts, work, environment) as address:
        for place, path in wanted.items() | {("/", PAGE / "index.html")}:
            with urllib.request.urlopen(address + place, timeout=TIMEOUT_S) as answer:
                if answer.read() != path.read_bytes():
                    raise Fault(f"the installed server sends {place} otherwise than it is in the checkout")
    print(f"page of the installed server: all {len(wanted)} files")


@contextmanager
def served(scripts: Path, work: Path, environment: dict[str, str]) -> Iterator[str]:
    """The default scenario as installed: the address of its page."""
    command = (str(scripts / "uwserver"), "run", "--port", "0")
    with subprocess.Popen(
        command, cwd=work, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            told: list[str] = []
            for line in process.stdout or ():
                told.append(line)
                if found := re.match(r"Open (http://127\.0\.0\.1:\d+)/", line):
                    break
            else:
                raise Fault(f"the installed server ended without a page:\n{''.join(told)}")
            yield found[1]
            process.send_signal(signal.SIGTERM)
            if process.wait(TIMEOUT_S) != 0:
                raise Fault(f"the installed server ended with {process.returncode} when it was told to end")
        finally:
            process.kill()


def compile_anew(scripts: Path, work: Path) -> None:
    """With an empty cache the installed server compiles what is asked for, into a folder with the name that it has for the checkout."""
    told = run(scripts / "python", "-c", COMPILE, cwd=work, environment=clean_environment(work, fresh=True))
    folder, *missing = told.split()
    if missing or not Path(folder).is_relative_to(work):
        raise Fault(f"of the kernels of {STAGE!r} were not compiled into {folder}: {missing}")
    shared = run(sys.executable, "-c", COMPILE, cwd=work, environment=clean_environment(work, fresh=False)).split()[0]
    if Path(shared).name != Path(folder).name:
        raise Fault(f"kernels of the wheel and of the checkout are kept apart: {folder}, {shared}")
    print(f"kernels of {STAGE!r}: compiled into an empty cache, and shared with the checkout")


def use_benchmark(scripts: Path, wheel: Path, work: Path, dependencies: bool) -> None:
    """`uwserver bench` without its distribution, and with it."""
    environment, command = clean_environment(work, fresh=False), (str(scripts / "uwserver"), "bench", "--help")
    alone = subprocess.run(
        command, cwd=work, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    if alone.returncode == 0 or "pip install uwserver-bench" not in alone.stderr:
        raise Fault(f"uwserver bench without its distribution ended with {alone.returncode}:\n{alone.stderr}")
    install(scripts / "python", [wheel], dependencies, work)
    if "--against" not in run(*command, cwd=work, environment=environment):
        raise Fault("uwserver bench is not that of its wheel")
    print("uwserver bench: ok")


def check_nothing_is_compiled(scripts: Path, work: Path) -> None:
    """Run what needs the engines of solid things and most kernels; that environment's cache of kernels stays empty."""
    environment = clean_environment(work, fresh=True)
    for scenario in FINISHED:
        command = ("run", scenario, "--port", "0", "--until", "0.5", "--mode", "freerun")
        run(scripts / "uwserver", *command, cwd=work, environment=environment)
        print(f"uwserver {' '.join(command)}: ok")
    (work / COPIED[0]).write_text(COPIES, encoding="utf-8")
    for scenario in COPIED:
        run(scripts / "python", "-c", BATCH, scenario, cwd=work, environment=environment)
        print(f"uwserver.batch of {scenario}: ok")
    compiled = sorted(path.name for path in (work / "cache").rglob("*.kernel"))
    if compiled:
        raise Fault(f"the wheel has kernels, and these were compiled all the same: {', '.join(compiled)}")
    print("kernels: as they came in the wheel")


def use_page(scripts: Path, work: Path, pictures: Path | None) -> None:
    """Drive the page that the installed server serves, in a browser; this environment brings the tests."""
    # Kernels are those of this user's cache, which all environments share: whether a wheel brings them is looked at elsewhere.
    environment = clean_environment(work, fresh=False)
    environment["UWSERVER_PAGE_PYTHON"] = str(scripts / "python")
    if pictures is not None:
        environment["UWSERVER_PAGE_PICTURES"] = str(pictures.resolve())
    command = (sys.executable, "-m", "pytest", "-q", "-n", "0", "-rs", ROOT / "tests/integration/test_web_page.py")
    told = run(*command, "-k", PAGE_TESTS, cwd=ROOT, environment=environment).strip().splitlines()
    print(f"page of the installed server: {told[-1]}")


def taken(dist: Path) -> dict[str, Path]:
    """The wheels of a folder for this Python, by distribution: one with kernels before a pure one."""
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    wheels = {}
    for name in PACKAGES:
        found = [*sorted(dist.glob(f"{name}-*-{tag}-*.whl")), *sorted(dist.glob(f"{name}-*-py3-none-any.whl"))]
        if not found:
            raise Fault(f"{dist} has no wheel of {name} for {tag}: make dist")
        wheels[name] = found[0].resolve()
    return wheels


def main() -> int:
    """Install, use."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dependencies", action="store_true", help="install the dependencies too, and compile all")
    parser.add_argument("--dist", type=Path, help="take the wheels of this folder")
    parser.add_argument("--page", action="store_true", help="drive the page of the installed server in Chromium")
    parser.add_argument("--pictures", type=Path, help="with --page: the folder for a picture of each test's end")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="uwserver-wheels-") as name:
        out = Path(name)
        try:
            wheels = taken(options.dist) if options.dist else of_checkout()
            fresh = options.dependencies or options.dist is not None
            finished = not wheels["uwserver"].name.endswith("-py3-none-any.whl")
            benchmark, work = wheels.pop(BENCHMARK), out / "work"
            work.mkdir()
            scripts = environment_with([*wheels.values()], out / "venv", options.dependencies)
            use(scripts, work, fresh)
            if finished:
                check_nothing_is_compiled(scripts, work)
            elif not fresh:
                compile_anew(scripts, work)
            if options.page:
                use_page(scripts, work, options.pictures)
            use_benchmark(scripts, benchmark, work, options.dependencies)
        except Fault as fault:
            print(f"wheel smoke test: {fault}", file=sys.stderr)
            return 1
    print("wheel smoke test: ok")
    return 0


if __name__ == "__main__":
    sys.exit(main())

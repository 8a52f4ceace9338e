"""Builds source distributions of uwserver, uwclient and the benchmark and wheels from these, installs the wheels in a fresh environment and uses
them there; exits with 1 at the first fault. The benchmark comes last: before, `uwserver bench` must say what to install.

By default the environment borrows the dependencies of the environment that runs this script, and only the wheels are installed;
`--dependencies` installs these too, as a user's pip would, and watches how much that is. `--dist DIR` takes the wheels of a folder, as `make dist`
left them: those with compiled kernels must not compile anything.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "uwserver": (ROOT, ("uwserver", "adapters/uwserver_adapters", "scenarios/uwserver_scenarios")),
    "uwclient": (ROOT / "clients" / "python", ("uwclient",)),
    "uwserver_bench": (ROOT / "bench", ("uwserver_bench",)),
}
BENCHMARK = "uwserver_bench"
MODULES = ("uwserver", "uwserver_adapters.sockets", "uwserver_scenarios", "uwclient")
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
SCHEMAS = ("scenario", "vehicle", "device")
"""Kinds of file whose JSON Schema is made for the wheel; git does not keep them."""
INSTALLED_MB, DOWNLOAD_SLACK = 1000.0, 0.1
"""What all default dependencies may take on the disk, and how far the download may be from the figure in the README."""
TIMEOUT_S = 300.0
PAGE_TESTS = "keys_steer or contend"
"""Of the tests of the page, those that are repeated with the installed server."""


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
        (folder / f"{kind}.schema.json").write_text(text, encoding="utf-8")


def build(name: str, out: Path) -> Path:
    """The wheel of a distribution, built from its source distribution, with its contents compared with the checkout."""
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


def install(python: Path, wheels: list[Path], dependencies: bool, work: Path) -> None:
    """Put wheels into the environment of a Python."""
    pip = (sys.executable, "-m", "pip", "--python", python)
    if not dependencies:
        run(*pip, "install", "--quiet", "--no-deps", *wheels, cwd=work)
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


def clean_environment(work: Path) -> dict[str, str]:
    """Without the settings of this checkout, and with a kernel cache of its own."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_"))}
    return environment | {"XDG_CACHE_HOME": str(work / "cache")}


def use(scripts: Path, work: Path) -> None:
    """Import and run what was installed, far from the checkout."""
    environment = clean_environment(work)
    for module in MODULES:
        found = run(
            scripts / "python", "-c", f"import {module} as m; print(m.__file__)", cwd=work, environment=environment
        )
        if not Path(found.strip()).is_relative_to(scripts.parent):
            raise Fault(f"{module} comes from {found.strip()}, not from its wheel")
    for name, *arguments in COMMANDS:
        run(scripts / name, *arguments, cwd=work, environment=environment)
        print(f"{name} {' '.join(arguments)}: ok")
    for kind in SCHEMAS:
        (shipped,) = scripts.parent.glob(f"lib/python*/site-packages/uwserver/schemas/{kind}.schema.json")
        if shipped.read_text(encoding="utf-8") != run(
            scripts / "uwserver", "schema", f"--{kind}", cwd=work, environment=environment
        ):
            raise Fault(f"{shipped.name} in the wheel is not what `uwserver schema --{kind}` prints")


def use_benchmark(scripts: Path, wheel: Path, work: Path, dependencies: bool) -> None:
    """`uwserver bench` without its distribution, and with it."""
    environment, command = clean_environment(work), (str(scripts / "uwserver"), "bench", "--help")
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
    for scenario in FINISHED:
        command = ("run", scenario, "--port", "0", "--until", "0.5", "--mode", "freerun")
        run(scripts / "uwserver", *command, cwd=work, environment=clean_environment(work))
        print(f"uwserver {' '.join(command)}: ok")
    (work / COPIED[0]).write_text(COPIES, encoding="utf-8")
    for scenario in COPIED:
        run(scripts / "python", "-c", BATCH, scenario, cwd=work, environment=clean_environment(work))
        print(f"uwserver.batch of {scenario}: ok")
    compiled = sorted(path.name for path in (work / "cache").rglob("*.kernel"))
    if compiled:
        raise Fault(f"the wheel has kernels, and these were compiled all the same: {', '.join(compiled)}")
    print("kernels: as they came in the wheel")


def use_page(scripts: Path, work: Path, pictures: Path | None) -> None:
    """Drive the page that the installed server serves, in a browser; this environment brings the tests."""
    # Kernels are those of this user's cache, which all environments share: whether a wheel brings them is looked at elsewhere.
    kept = {name: os.environ[name] for name in ("XDG_CACHE_HOME",) if name in os.environ}
    environment = {name: value for name, value in clean_environment(work).items() if name != "XDG_CACHE_HOME"} | kept
    environment["UWSERVER_PAGE_PYTHON"] = str(scripts / "python")
    if pictures is not None:
        environment["UWSERVER_PAGE_PICTURES"] = str(pictures.resolve())
    command = (sys.executable, "-m", "pytest", "-q", "-n", "0", "-rs", ROOT / "tests/integration/test_web_page.py")
    told = (
        run(*command, "-k", PAGE_TESTS, cwd=ROOT, environment=environment, timeout=3.0 * TIMEOUT_S).strip().splitlines()
    )
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
    """Build, install, use."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dependencies", action="store_true", help="install the dependencies too")
    parser.add_argument("--dist", type=Path, help="take the wheels of this folder")
    parser.add_argument("--page", action="store_true", help="drive the page of the installed server in Chromium")
    parser.add_argument("--pictures", type=Path, help="with --page: the folder for a picture of each test's end")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="uwserver-wheels-") as name:
        out = Path(name)
        try:
            if options.dist:
                wheels = taken(options.dist)
            else:
                make_schemas()
                wheels = {distribution: build(distribution, out) for distribution in PACKAGES}
            finished = not wheels["uwserver"].name.endswith("-py3-none-any.whl")
            benchmark, work = wheels.pop(BENCHMARK), out / "work"
            work.mkdir()
            scripts = environment_with([*wheels.values()], out / "venv", options.dependencies)
            use(scripts, work)
            if finished:
                check_nothing_is_compiled(scripts, work)
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

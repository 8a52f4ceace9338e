"""What is published: wheels with kernels, source distributions, the size of the default installation. Also of uwserver.version."""

from __future__ import annotations

import base64
import csv
import hashlib
import importlib.metadata
import importlib.util
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement
from reader import blocks

import uwserver
from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import LEVELS
from uwserver.world.builds import STAGES, kernels_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
MOST_MB = 1000.0
PROJECTS = (ROOT, ROOT / "clients/python", ROOT / "bench")
TAGS = ("cp311-cp311-manylinux_2_27_x86_64", "cp311-cp311-manylinux_2_28_x86_64")
PINS = {"numba": "0.68.1", "llvmlite": "0.50.0"}


def tool(name: str) -> ModuleType:
    """A script of tools/, with those that it imports."""
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, ROOT / f"tools/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOT / "tools"))
    return module


@pytest.fixture(scope="module")
def built() -> Path:
    """Source distributions, and wheels that are built from these: of this checkout, as all who need wheels have them."""
    return Path(tool("wheels").folder())


def names_in(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def metadata_of(wheel: Path) -> str:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return archive.read(name).decode()


def test_one_file_has_the_version_of_all_distributions(built: Path) -> None:
    for project in PROJECTS:
        table = tomllib.loads((project / "pyproject.toml").read_text())
        assert table["project"]["dynamic"] == ["version"]
        assert (project / table["tool"]["hatch"]["version"]["path"]).resolve() == ROOT / "uwserver/version.py"
    names = "uwserver", "uwclient", "uwserver_bench"
    expected = {f"{name}-{uwserver.__version__}.tar.gz" for name in names}
    assert {path.name for path in built.glob("*.tar.gz")} == expected


def test_a_source_distribution_has_all_that_its_wheel_needs(built: Path) -> None:
    wheels = tool("wheels")
    for name, package in wheels.PACKAGES.items():
        (wheel,) = built.glob(f"{name}-*.whl")
        inside = {path for path in names_in(wheel) if ".dist-info/" not in path}
        assert inside == wheels.expected_files(*package)
    with tarfile.open(next(built.glob("uwserver-*.tar.gz"))) as archive:
        assert any(name.endswith("/CHANGELOG.md") for name in archive.getnames())


def test_wheels_are_kept_by_a_hash_of_all_that_goes_into_them(built: Path) -> None:
    wheels = tool("wheels")
    known = {str(path.relative_to(ROOT)) for path in wheels.sources()}
    for name, (project, _) in wheels.PACKAGES.items():
        with tarfile.open(next(built.glob(f"{name}-*.tar.gz"))) as archive:
            inside = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
        ours = inside - {"PKG-INFO", ".gitignore"} - {f"uwserver/schemas/{kind}.schema.json" for kind in wheels.SCHEMAS}
        assert {str((project / path).relative_to(ROOT)) for path in ours} <= known
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["version"]["path"]
    assert {version, *(str((project / "pyproject.toml").relative_to(ROOT)) for project in PROJECTS)} <= known


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Wheels of a checkout with one file."""
    wheels = tool("wheels")
    (tmp_path / "package").mkdir()
    (tmp_path / "package/one.py").write_text("1")
    for name, value in {"ROOT": tmp_path, "GO_IN": ("package",), "BUILT": tmp_path / "build"}.items():
        monkeypatch.setattr(wheels, name, value)
    monkeypatch.setattr(wheels, "build_all", lambda out: shutil.copy(tmp_path / "package/one.py", out))
    return wheels


def test_wheels_are_built_anew_when_a_file_has_changed_and_only_then(small: ModuleType) -> None:
    first = small.folder()
    assert (first / "one.py").read_text() == "1"
    (first / "seen").touch()
    (small.ROOT / "package/__pycache__").mkdir()
    (small.ROOT / "package/__pycache__/one.pyc").touch()
    assert small.folder() == first
    assert (first / "seen").exists()
    for text in "234":
        (small.ROOT / "package/one.py").write_text(text)
        assert (small.folder() / "one.py").read_text() == text
    assert not first.exists()
    (small.ROOT / "package/one.py").rename(small.ROOT / "package/other.py")
    with pytest.raises(FileNotFoundError):
        small.folder()
    assert len([path for path in small.BUILT.iterdir() if path.is_dir()]) == small.KEPT


def test_of_files_that_change_meanwhile_no_wheels_are_kept(small: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(small, "build_all", lambda out: (small.ROOT / "package/one.py").write_text("2"))
    with pytest.raises(small.Fault, match="changed while"):
        small.folder()
    assert not [path for path in small.BUILT.iterdir() if path.is_dir()]


def test_the_server_brings_its_client_and_the_client_brings_nothing(built: Path) -> None:
    server, client = (metadata_of(next(built.glob(f"{name}-*.whl"))) for name in ("uwserver", "uwclient"))
    assert "Requires-Dist: uwclient[msgpack]" in server
    assert not [line for line in client.splitlines() if line.startswith("Requires-Dist") and "extra ==" not in line]


def test_the_client_tells_its_version() -> None:
    import uwclient

    assert uwclient.__version__ == importlib.metadata.version("uwclient")
    with pytest.raises(AttributeError, match="__verion__"):
        uwclient.__verion__  # noqa: B018


@pytest.fixture
def finished(built: Path, tmp_path: Path) -> Path:
    """A wheel with something in the place of kernels."""
    (pure,) = built.glob("uwserver-*.whl")
    added = {"uwserver/physics/kernel/finished/0123-x86-64/step.strike-4567.kernel": b"kernel"}
    return Path(tool("kernel_wheel").assemble(pure, added, TAGS, PINS, tmp_path))


def test_a_wheel_with_kernels_is_the_pure_one_and_these(finished: Path, built: Path) -> None:
    (pure,) = built.glob("uwserver-*.whl")
    tag = "cp311-cp311-manylinux_2_27_x86_64.manylinux_2_28_x86_64"
    assert finished.name == f"uwserver-{uwserver.__version__}-{tag}.whl"
    assert names_in(finished) - names_in(pure) == {
        "uwserver/physics/kernel/finished/0123-x86-64/step.strike-4567.kernel"
    }
    assert names_in(pure) < names_in(finished)
    plain, pinned = (
        {line for line in metadata_of(wheel).splitlines() if line.startswith("Requires-Dist")}
        for wheel in (pure, finished)
    )
    assert pinned - plain == {f"Requires-Dist: {name}=={version}" for name, version in PINS.items()}
    (given_up,) = plain - pinned
    assert Requirement(given_up.partition(": ")[2]).name == "numba"


def test_its_record_is_right_and_it_can_be_installed(finished: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(finished) as archive:
        (record,) = (name for name in archive.namelist() if name.endswith(".dist-info/RECORD"))
        rows = {path: (digest, size) for path, digest, size in csv.reader(io.StringIO(archive.read(record).decode()))}
        assert rows.keys() == set(archive.namelist())
        assert rows.pop(record) == ("", "")
        for path, (digest, size) in rows.items():
            data = archive.read(path)
            sha = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
            assert (digest, int(size)) == (f"sha256={sha}", len(data))
        wheel = archive.read(record.replace("RECORD", "WHEEL")).decode()
    assert [line for line in wheel.splitlines() if line.startswith("Tag")] == [f"Tag: {tag}" for tag in TAGS]
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-compile",
        "--no-deps",
        "--no-index",
        "--target",
        str(tmp_path / "to"),
    ]
    platform = ["--platform", "manylinux_2_28_x86_64", "--python-version", "3.11", "--implementation", "cp"]
    subprocess.run([*pip, *platform, str(finished)], check=True, timeout=120)
    (there,) = (tmp_path / "to").rglob("*.kernel")
    assert there.read_bytes() == b"kernel"


def test_metadata_without_a_compiler_is_refused() -> None:
    kernel_wheel = tool("kernel_wheel")
    with pytest.raises(kernel_wheel.NotBuilt, match="numba"):
        kernel_wheel.pinned("Name: uwserver\nRequires-Dist: numpy\n\nIt needs numba.\n", PINS)


@pytest.mark.parametrize(
    ("text", "release", "words"),
    [
        ("## [1.2.3] - 2026-01-02\n- New.\n", True, None),
        ("## [1.2.3] - 2026-01-02\n- New.\n", False, None),
        ("## [Unreleased] 1.2.3\n### Added\n- New.\n", False, None),
        ("## [Unreleased] 1.2.3\n### Added\n- New.\n", True, "no section"),
        ("## [1.2.4] - 2026-01-02\n- New.\n", False, "no section"),
        ("## [1.2.3] - 2026-01-02\n\n## [1.2.2] - 2025-01-02\n- Old.\n", True, "says nothing"),
    ],
)
def test_the_changelog_is_looked_at(text: str, release: bool, words: str | None) -> None:
    dist = tool("dist")
    if words is None:
        dist.check_changelog(text, "1.2.3", release)
        return
    with pytest.raises(Exception, match=words):
        dist.check_changelog(text, "1.2.3", release)


def installed(requirement: Requirement, seen: dict[str, float]) -> None:
    """Add the size (MB) of what a requirement brings to this environment, by name."""
    name = requirement.name.lower()
    if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
        return
    if name not in seen and name not in ("uwserver", "uwclient"):
        distribution = importlib.metadata.distribution(name)
        seen[name] = sum(file.size or 0 for file in distribution.files or ()) / 1e6
        for line in distribution.requires or ():
            installed(Requirement(line), seen)


def test_the_default_installation_has_its_parts_and_stays_below_a_gigabyte() -> None:
    """Without byte code, of which pip writes some 100 MB: `tools/wheel_smoke.py --dependencies` counts that too."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    seen: dict[str, float] = {}
    for line in [*table["dependencies"], "msgpack"]:
        installed(Requirement(line), seen)
    assert {"numpy", "eclipse-zenoh", "pymavlink", "msgpack", "scipy", "trimesh"} <= seen.keys()
    whole = sum(seen.values())
    largest = sorted(seen.items(), key=lambda entry: -entry[1])[:8]
    assert 300.0 < whole < MOST_MB - 100.0, f"{whole:.0f} MB: {largest}"


STATE = """
import pybullet, sys, uwserver
assert pybullet.__file__.startswith(sys.prefix), pybullet.__file__
world = uwserver.load("push_the_crate")
world.step(500)
print(world.call("world/state_hash")["hash"])
"""


@pytest.mark.slow  # copies and strips 134 MB
@pytest.mark.skipif(shutil.which("strip") is None, reason="needs strip, of binutils")
def test_without_what_may_go_all_is_the_same(tmp_path: Path) -> None:
    """The listing of docs/how-to/install.md, in an environment that borrows all but pybullet."""
    ours = Path(sysconfig.get_path("platlib"))
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")], check=True, timeout=120)
    (packages,) = (tmp_path / "venv/lib").glob("python*/site-packages")
    (library,) = ours.glob("pybullet.*.so")
    shutil.copy(library, packages)
    for folder in ("data", "envs", "examples", "robots"):
        (packages / f"pybullet_{folder}").mkdir()
    # As a folder of packages and not only as a path: what is installed to be edited stands in files there that name it.
    (packages / "others.pth").write_text(f"import site; site.addsitedir({str(ours)!r})\n")

    def printed(*command: str) -> str:
        environment = os.environ | {"PATH": f"{tmp_path / 'venv/bin'}{os.pathsep}{os.environ['PATH']}"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()[-1] if done.stdout else ""

    before = printed("python", "-c", STATE)
    (listing,) = (block.text for block in blocks("docs/how-to/install.md", "sh") if "strip" in block.text)
    printed("sh", "-e", "-c", listing)
    assert not list(packages.glob("pybullet_*"))
    assert (packages / library.name).stat().st_size < 0.2 * library.stat().st_size
    assert printed("python", "-c", STATE) == before


def test_what_other_pythons_try_is_there() -> None:
    """A test that has another name now would be missed only on machines that have these Pythons."""
    others = tool("other_pythons")
    for test in (*(f"tests/{name}" for name in others.TESTS), *others.MORE_TESTS):
        path, _, name = test.partition("::")
        assert (ROOT / path).exists(), test
        assert not name or f"\ndef {name}(" in (ROOT / path).read_text(), test


def test_all_is_every_extra_that_a_server_can_use() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (line,) = extras["all"]
    assert Requirement(line).extras == extras.keys() - {"all", "coal", "dev", "docs", "release", "site", "video"}


def test_a_wheel_has_the_kernels_of_all_stages(tmp_path: Path) -> None:
    """What is built is complete only when all are there, of each kind of CPU."""
    levels = [(machine, level) for machine, of_it in LEVELS.items() for level in of_it]
    physics = Path(compiled.__file__).parents[1]
    own = tmp_path / "own" / f"kernels-{compiled.made_of(physics)}-{compiled.cpu_of()}"
    places = [own, *(tmp_path / f"{compiled.made_of(physics, machine)}-{level}" for machine, level in levels)]
    kernels = {*(kernel for stage in STAGES for kernel in kernels_of(stage)), "tree.pick_nearest"}
    for place in places:
        place.mkdir(mode=0o700, parents=True)
        for kernel in kernels:
            (place / f"{kernel}-0.kernel").touch()
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "own")}

    def told() -> str:
        command = [sys.executable, str(ROOT / "tools/emit_kernels.py"), str(tmp_path), "check"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
        assert (done.returncode == 0) is not done.stderr.strip()
        return done.stderr

    assert told() == ""
    (places[-1] / "tree.pick_nearest-0.kernel").unlink()
    assert "armv8-a: 1 kernels are missing, tree.pick_nearest" in told()
    (own / f"{kernels_of('copies')[0]}-0.kernel").unlink()
    assert "not all kernels were compiled" in told()


def test_stages_are_shared_by_what_they_take() -> None:
    parts = tool("emit_kernels").shares(list(STAGES), 2)
    assert sorted(stage for part in parts for stage in part) == sorted(STAGES)
    first, second = (sum(STAGES[stage] for stage in part) for part in parts)
    assert abs(first - second) < max(STAGES.values())


def test_a_release_needs_every_python_and_another_build_takes_those_there(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dist = tool("dist")
    text = (ROOT / "pyproject.toml").read_text()
    monkeypatch.setattr(
        dist.other_pythons, "interpreter", lambda version: None if version == "3.13" else Path(f"py{version}")
    )
    assert dist.interpreters(text, release=False) == ["py3.10", "py3.11", "py3.12"]
    assert "Python 3.13" in capsys.readouterr().out
    with pytest.raises(dist.Fault, match=r"Python 3\.13"):
        dist.interpreters(text, release=True)

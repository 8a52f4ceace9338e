"""`make docs-check` runs again only that for which something has changed (`tools/made_of.py`), and all of it; and says what `make docs` wrote."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType, ModuleType, SimpleNamespace

import pytest

from uwserver.scenario.world.tables import Environment
from uwserver.validation.manoeuvres import report as manoeuvres

ROOT = Path(__file__).parents[2]
KERNEL = "uwserver/physics/dynamics/fossen.py"
FILES = {
    KERNEL: "a = f / m\n",
    "uwserver/scenario/vehicle/body.py": "m = mass_kg\n",
    "uwserver/validation/manoeuvres/trials.py": "20 s\n",
    "uwserver/frames.py": "NED\n",
    "uwserver/server/http.py": "not of motion\n",
    "bench/uwserver_bench/proofs/motion.py": "energy\n",
    "tests/physics/oracles/free.json": "[]",
    "scenarios/uwserver_scenarios/vehicles/otter.toml": 'name = "otter"\ndevice = "fan"\n',
    "scenarios/uwserver_scenarios/vehicles/lauv.toml": 'name = "lauv"\nmesh = "../assets/hull.stl"\n',
    "scenarios/uwserver_scenarios/devices/fan.toml": "power = 1\n",
    "scenarios/uwserver_scenarios/assets/hull.stl": "solid",
    "scenarios/uwserver_scenarios/assets/rock.stl": "solid",
    "tools/vehicle_pages.py": "tool\n",
    "tools/validation_report.py": "tool\n",
}
OTTER, LAUV = "docs/vehicles/otter.md", "docs/vehicles/lauv.md"
STALE = "docs/vehicles.md is stale: run python tools/vehicle_pages.py\n"


class Pages:
    """A small checkout whose vehicles have a speed and nothing else; `ran` are those whose manoeuvres ran since `start`."""

    def __init__(self, root: Path, tool: ModuleType) -> None:
        self.root, self.tool = root, tool
        self.speeds = {"otter": 3.19, "lauv": 2.5}
        self.ran: list[str] = []

    def report(self, name: str) -> SimpleNamespace:
        self.ran.append(name)
        return SimpleNamespace(name=name, speed=self.speeds[name])

    def append(self, path: str, text: str = "# more\n") -> None:
        with (self.root / path).open("a") as file:
            file.write(text)

    def picture(self, name: str) -> None:
        self.tool.picture_of(name).touch()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With `FILES`, to which `made_of` looks."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "docs/images").mkdir(parents=True)
    monkeypatch.syspath_prepend(ROOT / "tools")
    made_of = importlib.import_module("made_of")
    monkeypatch.setattr(made_of, "ROOT", tmp_path)
    monkeypatch.setattr(made_of, "KEPT", tmp_path / "tools/made_of.toml")
    monkeypatch.setattr(made_of, "SIMULATOR", tmp_path / "uwserver")
    monkeypatch.setattr(made_of, "SHIPPED", tmp_path / "scenarios/uwserver_scenarios")
    return tmp_path


@pytest.fixture
def pages(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> Pages:
    """As `make docs` left them."""
    tool = importlib.import_module("vehicle_pages")
    made = Pages(checkout, tool)
    monkeypatch.setattr(tool, "TOOL", checkout / "tools/vehicle_pages.py")
    monkeypatch.setattr(tool, "INDEX", checkout / "docs/vehicles.md")
    monkeypatch.setattr(tool, "PAGES", checkout / "docs/vehicles")
    monkeypatch.setattr(tool, "IMAGES", checkout / "docs/images")
    monkeypatch.setattr(tool, "SHIPPED", checkout / "scenarios/uwserver_scenarios/vehicles")
    monkeypatch.setattr(tool, "report", made.report)
    monkeypatch.setattr(tool, "draw", made.picture)
    monkeypatch.setattr(tool, "page", lambda found: f"# {found.name}\n\nspeed {found.speed}\n")
    monkeypatch.setattr(tool, "row", lambda found: f"| [{found.name}](vehicles/{found.name}.md) | {found.speed} |")
    assert tool.write() == 0
    made.ran.clear()
    return made


def test_where_nothing_has_changed_nothing_runs(pages: Pages, capsys: pytest.CaptureFixture[str]) -> None:
    pages.append("uwserver/server/http.py")
    pages.append("scenarios/uwserver_scenarios/assets/rock.stl")
    assert pages.tool.check() == 0
    assert pages.ran == []
    assert capsys.readouterr() == ("", "")


def test_all_runs_all(pages: Pages, capsys: pytest.CaptureFixture[str]) -> None:
    assert pages.tool.check(everything=True) == 0
    assert pages.ran == ["lauv", "otter"]
    assert capsys.readouterr() == ("", "")
    pages.speeds["lauv"] = 2.8
    assert pages.tool.check(everything=True) == 1
    assert "docs/vehicles/lauv.md\n- speed 2.5\n+ speed 2.8\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changed", "ran"),
    [
        ("scenarios/uwserver_scenarios/vehicles/otter.toml", ["otter"]),
        ("scenarios/uwserver_scenarios/devices/fan.toml", ["otter"]),
        ("scenarios/uwserver_scenarios/assets/hull.stl", ["lauv"]),
        (KERNEL, ["lauv", "otter"]),
        ("uwserver/physics/dynamics/new.py", ["lauv", "otter"]),
        ("uwserver/scenario/vehicle/body.py", ["lauv", "otter"]),
        ("uwserver/validation/manoeuvres/trials.py", ["lauv", "otter"]),
        ("uwserver/frames.py", ["lauv", "otter"]),
        ("tools/vehicle_pages.py", ["lauv", "otter"]),
    ],
)
def test_what_has_changed_runs_again(
    pages: Pages, capsys: pytest.CaptureFixture[str], changed: str, ran: list[str]
) -> None:
    """What says the same passes with a word; what says something else is stale; after `make docs` neither."""
    pages.append(changed)
    assert pages.tool.check() == 0
    assert pages.ran == ran
    told = capsys.readouterr().out
    assert "`make docs` renews the hashes" in told
    assert [name in told for name in (LAUV, OTTER)] == ["lauv" in ran, "otter" in ran]
    for name in ran:
        pages.speeds[name] *= 1.2
    assert pages.tool.check() == 1
    assert capsys.readouterr().err.endswith(STALE)
    assert pages.tool.write() == 0
    pages.ran.clear()
    assert pages.tool.check() == 0
    assert pages.ran == []


def test_a_kernel_that_is_gone_or_has_another_name_runs_all(pages: Pages) -> None:
    (pages.root / KERNEL).rename(pages.root / "uwserver/physics/dynamics/newton.py")
    assert pages.tool.check() == 0
    assert pages.ran == ["lauv", "otter"]


def edit(path: str, old: str, new: str) -> Callable[[Path], None]:
    return lambda root: (root / path).write_text((root / path).read_text().replace(old, new)) and None


@pytest.mark.parametrize(
    ("change", "told", "ran"),
    [
        (edit(OTTER, "3.19", "3.91"), "docs/vehicles/otter.md\n- speed 3.91\n+ speed 3.19\n", ["otter"]),
        (edit(OTTER, "speed", "way"), "docs/vehicles/otter.md\n- way 3.19\n+ speed 3.19\n", ["otter"]),
        (edit("docs/vehicles.md", "3.19", "3.91"), "docs/vehicles.md\n- | [otter](vehicles/otter.md) | 3.91 |\n", ["otter"]),
        (edit("docs/vehicles.md", "# Vehicles", "# Ships"), "docs/vehicles.md\n- # Ships\n", []),
        (edit("docs/vehicles.md", "| [otter](vehicles/otter.md) | 3.19 |\n", ""), "another number of lines", ["otter"]),
        (lambda root: (root / OTTER).unlink(), "docs/vehicles/otter.md is missing\n", []),
        (lambda root: (root / "docs/vehicles.md").unlink(), "docs/vehicles.md is missing\n", ["lauv", "otter"]),
        (lambda root: (root / "docs/images/vehicle_otter.png").unlink(), "docs/images/vehicle_otter.png is missing\n", []),
        (lambda root: (root / "docs/vehicles/nautilus.md").touch(), "docs/vehicles/nautilus.md is of no vehicle\n", []),
        (lambda root: (root / "scenarios/uwserver_scenarios/vehicles/rov.toml").touch(), "docs/vehicles/rov.md is missing\n", []),
    ],
)  # fmt: skip
def test_pages_that_are_not_as_they_were_written_are_stale(
    pages: Pages, capsys: pytest.CaptureFixture[str], change: Callable[[Path], None], told: str, ran: list[str]
) -> None:
    change(pages.root)
    assert pages.tool.check() == 1
    assert pages.ran == ran
    err = capsys.readouterr().err
    assert told in err
    assert err.endswith(STALE)


def test_hashes_of_pages_that_are_gone_go_too(pages: Pages) -> None:
    (pages.root / LAUV).unlink()
    (pages.root / "scenarios/uwserver_scenarios/vehicles/lauv.toml").unlink()
    assert pages.tool.write() == 0
    kept = (pages.root / "tools/made_of.toml").read_text()
    assert OTTER in kept
    assert LAUV not in kept


# -- docs/validation.md ----------------------------------------------------------------------------------------------------------------------


class Document:
    """The document of a small checkout, and how often it was computed."""

    def __init__(self, root: Path, tool: ModuleType) -> None:
        self.root, self.tool, self.runs = root, tool, 0
        self.text = "# Validation\n\nerror 2.5e-07\n\n![drawn](images/drawn.png)\n"

    def compute(self) -> tuple[str, list[SimpleNamespace]]:
        self.runs += 1
        return self.text, [SimpleNamespace(image="drawn.png", draw=Path.touch), SimpleNamespace(image="", draw=None)]


@pytest.fixture
def document(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> Document:
    """As `make docs` left it."""
    tool = importlib.import_module("validation_report")
    made = Document(checkout, tool)
    monkeypatch.setattr(tool, "TOOL", checkout / "tools/validation_report.py")
    monkeypatch.setattr(tool, "PROOFS", checkout / "bench/uwserver_bench/proofs")
    monkeypatch.setattr(tool, "ORACLES", checkout / "tests/physics/oracles")
    monkeypatch.setattr(tool, "DOCUMENT", checkout / "docs/validation.md")
    monkeypatch.setattr(tool, "IMAGES", checkout / "docs/images")
    monkeypatch.setattr(tool, "VEHICLES", ("lauv", "otter"))
    monkeypatch.setattr(tool, "document", made.compute)
    assert tool.write() == 0
    made.runs = 0
    return made


def test_a_document_of_which_nothing_has_changed_is_not_computed(
    document: Document, capsys: pytest.CaptureFixture[str]
) -> None:
    with (document.root / "uwserver/server/http.py").open("a") as file:
        file.write("# more\n")
    assert document.tool.check() == 0
    assert document.runs == 0
    assert document.tool.check(everything=True) == 0
    assert document.runs == 1
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    "changed", [name for name in FILES if "http" not in name and "rock" not in name and "_pages" not in name]
)
def test_a_document_of_which_something_has_changed_is_computed(
    document: Document, capsys: pytest.CaptureFixture[str], changed: str
) -> None:
    with (document.root / changed).open("a") as file:
        file.write("# more\n")
    assert document.tool.check() == 0
    assert document.runs == 1
    assert "`make docs` renews the hashes: docs/validation.md" in capsys.readouterr().out
    document.text = document.text.replace("2.5", "3.5")
    assert document.tool.check() == 1
    told = capsys.readouterr().err
    assert "- error 2.5e-07\n+ error 3.5e-07\n" in told
    assert told.endswith("docs/validation.md is stale: run python tools/validation_report.py\n")


@pytest.mark.parametrize(
    ("change", "told", "runs"),
    [
        (edit("docs/validation.md", "2.5", "1.5"), "- error 1.5e-07\n+ error 2.5e-07\n", 1),
        (lambda root: (root / "docs/validation.md").unlink(), "docs/validation.md is missing\n", 0),
        (lambda root: (root / "docs/images/drawn.png").unlink(), "docs/images/drawn.png is missing\n", 0),
    ],
)
def test_a_document_that_is_not_as_it_was_written_is_stale(
    document: Document, capsys: pytest.CaptureFixture[str], change: Callable[[Path], None], told: str, runs: int
) -> None:
    change(document.root)
    assert document.tool.check() == 1
    assert document.runs == runs
    assert told in capsys.readouterr().err


# -- this checkout ---------------------------------------------------------------------------------------------------------------------------


def of_the_simulator(run: Callable[[], object]) -> set[Path]:
    """Its files of which a function is called by Python while something runs."""
    called: set[str] = set()

    def watch(frame: FrameType, event: str, argument: object) -> None:
        called.add(frame.f_code.co_filename)

    before = sys.gettrace()
    sys.settrace(watch)
    try:
        run()
    finally:
        sys.settrace(before)
    return {path for path in map(Path, called) if path.is_relative_to(ROOT / "uwserver")}


def test_all_that_runs_for_a_page_is_in_its_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    """What loading only checks with, as sensors, is not of the scenario's rooms."""
    monkeypatch.syspath_prepend(ROOT / "tools")
    code = set(importlib.import_module("made_of").code())
    loading = of_the_simulator(lambda: manoeuvres.resolve("girona500", Environment()))
    assert ROOT / "uwserver/scenario/load/scenario.py" in loading
    assert [path for path in loading - code if "scenario" in path.parts] == []
    resolved = manoeuvres.resolve("girona500", Environment(density_kgpm3=1025.0))
    monkeypatch.setattr(manoeuvres, "resolve", lambda *_: resolved)
    running = of_the_simulator(lambda: manoeuvres.report("girona500"))
    assert ROOT / "uwserver/scenario/vehicle/body.py" in running
    assert running - code == set()


def test_all_of_the_physics_is_in_the_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled kernels are not seen as they run."""
    monkeypatch.syspath_prepend(ROOT / "tools")
    code = set(importlib.import_module("made_of").code())
    for room in ("physics", "actuators", "environment", "scenario/vehicle", "validation"):
        assert set((ROOT / "uwserver" / room).rglob("*.py")) <= code

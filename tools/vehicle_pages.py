"""Writes docs/vehicles.md, a page and a picture for each shipped vehicle, from runs of its manoeuvres: ``python tools/vehicle_pages.py``.

With ``--check`` nothing is written: the manoeuvres of vehicles for which anything has changed since (`made_of`; ``--all``: of every vehicle) are
run again and compared with the pages, and the exit status is 1 when they say something else, or numbers differ by more than rounding on another
machine can explain.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import made_of

from uwserver.cli.recordings.vehicle_picture import vehicle_picture
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.world.tables import Environment
from uwserver.units import deg
from uwserver.validation.manoeuvres.pages import NONE_FOUND, markdown
from uwserver.validation.manoeuvres.report import Comparison, Report, report, resolve

ROOT = Path(__file__).parents[1]
TOOL = Path(__file__)
INDEX = ROOT / "docs" / "vehicles.md"
PAGES = ROOT / "docs" / "vehicles"
IMAGES = ROOT / "docs" / "images"
SHIPPED = ROOT / "scenarios" / "uwserver_scenarios" / "vehicles"
INTRODUCTION = """\
# Vehicles

`python tools/vehicle_pages.py` writes this page: do not edit it. `--check` runs again what has changed. Each name leads to a page with the
vehicle's picture, its numbers with their status, and its manoeuvres. The manoeuvres are open loop, in still water, with everything at its
supply voltage, as a pilot without an autopilot would see them. Published figures of the real vehicle (`[[published]]` in the vehicle file)
stand beside them, if any were found.

`uwserver manoeuvres VEHICLE` writes such a report for your own vehicle; `uwserver plot vehicle VEHICLE` draws it.

Iver3 and REMUS 600 are not here, because we could not read a complete set of numbers for them. According to their summaries, the
identification of an Iver3 (doi 10.1177/02783649231191184) and the model of an Iver2 (doi 10.1007/s00773-014-0259-0) have one. For the REMUS
600 only dimensions are published. A stretched REMUS 100 would be neither of them.
"""
REMEDY = "docs/vehicles.md is stale: run python tools/vehicle_pages.py"
HEAD = (
    "vehicle", "what it is", "mass kg", "top speed m/s", "published", "turning diameter m", "published", "largest tilt ahead deg", "guesses",
)  # fmt: skip


def shipped() -> list[str]:
    """Return the names of all shipped vehicles."""
    return sorted(path.stem for path in SHIPPED.glob("*.toml"))


def index(rows: Sequence[str]) -> str:
    """Return the page that links to the others."""
    return "\n".join([INTRODUCTION, f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD), *rows]) + "\n"


def row(found: Report) -> str:
    """Return the row of a vehicle in the index."""
    mass = next(p.values[0] for p in found.particulars if p.name == "mass")
    tilts = [row.values[1] for row in found.trial("straight").rows if row.values[1] is not None]
    cells = (
        f"[{found.name}](vehicles/{found.name}.md)", found.description.partition(":")[2].strip() or found.description,
        f"{mass:.4g}", *_pair(found, "ahead_speed_mps"), *_pair(found, "turning_diameter_m"),
        f"{deg(max(tilts)):.0f}" if tilts else "-", f"{found.guesses} of {found.groups}",
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _pair(found: Report, quantity: str) -> tuple[str, str]:
    """Return the simulated and the published figure, of the condition with a published one, or of the first."""
    known = [c for c in found.comparisons if c.quantity == quantity]
    if not known:
        return "-", "-"
    chosen: Comparison = next((c for c in known if c.published), known[-1])
    simulated = "-" if chosen.simulated is None else f"{chosen.simulated:.3g}"
    return simulated, " / ".join(f"{p.value:g}" for p in chosen.published) or NONE_FOUND


def draw(name: str) -> None:
    """Draw the picture of a vehicle."""
    environment = Environment()
    resolved = resolve(name, environment)
    figure = vehicle_picture(resolved, body_params(resolved.vehicle, resolved.devices, environment))
    # Without the version of matplotlib in it, the same plot is the same file.
    figure.savefig(picture_of(name), dpi=110, metadata={"Software": None})


def row_of(text: str, name: str) -> str:
    """Return the present row of a vehicle in the index; empty if it has none."""
    return next((line for line in text.splitlines() if line.startswith(f"| [{name}](")), "")


def page_of(name: str) -> Path:
    """Return the path of a vehicle's page."""
    return PAGES / f"{name}.md"


def picture_of(name: str) -> Path:
    """Return the path of a vehicle's picture."""
    return IMAGES / f"vehicle_{name}.png"


def page(found: Report) -> str:
    """Return the page of a vehicle."""
    return markdown(found, f"../images/{picture_of(found.name).name}")


def made(names: Sequence[str]) -> dict[str, str]:
    """Hash of all that each vehicle's page is made of, of its own text and of its row of the index."""
    code = made_of.digest([*made_of.code(), TOOL])
    rows = INDEX.read_text(encoding="utf-8") if INDEX.is_file() else ""
    return {
        name: made_of.digest(
            made_of.vehicle_files(name), code, page_of(name).read_text(encoding="utf-8"), row_of(rows, name)
        )
        for name in names
    }


def write() -> int:
    """Write pages, pictures and hashes."""
    reports = [report(name) for name in shipped()]
    PAGES.mkdir(exist_ok=True)
    INDEX.write_text(index([row(found) for found in reports]), encoding="utf-8")
    for found in reports:
        page_of(found.name).write_text(page(found), encoding="utf-8")
        draw(found.name)
    made_of.keep({made_of.named(page_of(name)): value for name, value in made(shipped()).items()})
    return made_of.outcome(strays(), (), REMEDY)


def check(everything: bool = False) -> int:
    """Exit status; vehicles whose hash is the old one are not run again, unless `everything` is."""
    there = [name for name in shipped() if page_of(name).is_file()]
    kept = made_of.kept()
    old = [name for name, value in made(there).items() if kept.get(made_of.named(page_of(name))) != value]
    reports = {name: report(name) for name in (there if everything else old)}
    stale = made_of.missing(INDEX, *map(page_of, shipped()), *map(picture_of, shipped())) + strays()
    for name, found in reports.items():
        stale += _told(page_of(name), page(found))
    if INDEX.is_file():
        text = INDEX.read_text(encoding="utf-8")
        stale += _told(INDEX, index([row(reports[n]) if n in reports else row_of(text, n) for n in shipped()]))
    return made_of.outcome(stale, [made_of.named(page_of(name)) for name in old], REMEDY)


def strays() -> list[str]:
    """Return complaints about pages of vehicles that no longer exist."""
    return [
        f"{made_of.named(path)} is of no vehicle" for path in sorted(PAGES.glob("*.md")) if path.stem not in shipped()
    ]


def _told(path: Path, text: str) -> list[str]:
    lines = made_of.differences(path.read_text(encoding="utf-8"), text)
    return [f"{made_of.named(path)}\n{line}" for line in lines]


def main() -> int:
    """Exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare with the pages instead of writing them")
    parser.add_argument("--all", action="store_true", help="check even those for which nothing has changed")
    chosen = parser.parse_args()
    return check(chosen.all) if chosen.check else write()


if __name__ == "__main__":
    sys.exit(main())

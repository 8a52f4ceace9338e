"""Writes docs/vehicles.md, a page and a picture for each shipped vehicle, from runs of its manoeuvres: ``python tools/vehicle_pages.py``.

With ``--check`` nothing is written: all manoeuvres are run again and compared with the pages, and the exit status is 1 when they say something
else, or numbers differ by more than rounding on another machine can explain.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from validation_report import differences

from uwserver.cli.vehicle_picture import vehicle_picture
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.water.tables import Environment
from uwserver.units import deg
from uwserver.validation.manoeuvres.report import NONE_FOUND, Comparison, Report, markdown, report, resolve

ROOT = Path(__file__).parents[1]
INDEX = ROOT / "docs" / "vehicles.md"
PAGES = ROOT / "docs" / "vehicles"
IMAGES = ROOT / "docs" / "images"
SHIPPED = ROOT / "scenarios" / "uwserver_scenarios" / "vehicles"
INTRODUCTION = """\
# Vehicles

Written by `python tools/vehicle_pages.py`; do not edit. `--check` runs all manoeuvres again. Each name leads to a page with the vehicle's
picture, its numbers with their status, and its manoeuvres: open loop, in still water, everything at its supply voltage, as a pilot without an
autopilot would see them. Beside them stand published figures of the real vehicle (`[[published]]` in the vehicle file), where any were found.

`uwserver manoeuvres VEHICLE` writes such a report of a vehicle of your own, `uwserver plot vehicle VEHICLE` draws it.

Not here: Iver3 and REMUS 600. A set of numbers for them that is whole could not be read: the identification of an Iver3 (doi
10.1177/02783649231191184) and the model of an Iver2 (doi 10.1007/s00773-014-0259-0) have it, by their summaries; of the REMUS 600 only
dimensions are published. A REMUS 100 drawn longer would be neither.
"""


HEAD = (
    "vehicle", "what it is", "mass kg", "top speed m/s", "published", "turning diameter m", "published", "largest tilt ahead deg", "guesses",
)  # fmt: skip


def shipped() -> list[str]:
    """Names of all shipped vehicles."""
    return sorted(path.stem for path in SHIPPED.glob("*.toml"))


def index(reports: list[Report]) -> str:
    """The page that leads to the others."""
    lines = [INTRODUCTION, f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]
    for found in reports:
        mass = next(p.values[0] for p in found.particulars if p.name == "mass")
        tilts = [row.values[1] for row in found.trial("straight").rows if row.values[1] is not None]
        cells = (
            f"[{found.name}](vehicles/{found.name}.md)", found.description.partition(":")[2].strip() or found.description,
            f"{mass:.4g}", *_pair(found, "ahead_speed_mps"), *_pair(found, "turning_diameter_m"),
            f"{deg(max(tilts)):.0f}" if tilts else "-", f"{found.guesses} of {found.groups}",
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _pair(found: Report, quantity: str) -> tuple[str, str]:
    """The simulated figure and the published one, of the condition that has one, or of the first."""
    known = [c for c in found.comparisons if c.quantity == quantity]
    if not known:
        return "-", "-"
    chosen: Comparison = next((c for c in known if c.published), known[-1])
    simulated = "-" if chosen.simulated is None else f"{chosen.simulated:.3g}"
    return simulated, " / ".join(f"{p.value:g}" for p in chosen.published) or NONE_FOUND


def draw(name: str) -> None:
    """Its picture."""
    environment = Environment()
    resolved = resolve(name, environment)
    figure = vehicle_picture(resolved, body_params(resolved.vehicle, resolved.devices, environment))
    # Without the version of matplotlib in it, the same plot is the same file.
    figure.savefig(IMAGES / f"vehicle_{name}.png", dpi=110, metadata={"Software": None})


def main() -> int:
    """Exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare with the pages instead of writing them")
    check: bool = parser.parse_args().check
    reports = [report(name) for name in shipped()]
    pages = {INDEX: index(reports)}
    pages |= {PAGES / f"{found.name}.md": markdown(found, f"../images/vehicle_{found.name}.png") for found in reports}
    stale = []
    for path, text in pages.items():
        if not check:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        elif not path.is_file():
            stale.append(f"{path.relative_to(ROOT)} is missing")
        else:
            stale += [
                f"{path.relative_to(ROOT)}\n{line}" for line in differences(path.read_text(encoding="utf-8"), text)
            ]
    for name in shipped():
        if not check:
            draw(name)
        elif not (IMAGES / f"vehicle_{name}.png").is_file():
            stale.append(f"docs/images/vehicle_{name}.png is missing")
    stale += [f"{path.relative_to(ROOT)} is of no vehicle" for path in sorted(PAGES.glob("*.md")) if path not in pages]
    if stale:
        sys.stderr.write("\n".join(stale) + "\ndocs/vehicles.md is stale: run python tools/vehicle_pages.py\n")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())

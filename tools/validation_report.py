"""Writes docs/validation.md and its plots from runs of the production kernel: ``python tools/validation_report.py``.

With ``--check`` nothing is written: if anything has changed of which the document is made (`made_of`; ``--all``: in any case), the numbers are
computed again and compared with those in the document, and the exit status is 1 when they differ by more than rounding on another machine can
explain.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import made_of
import numpy as np
import validation_plots as plots
from uwserver_bench.proofs.closed_forms import closed_forms, tilt
from uwserver_bench.proofs.contact_forms import contact_forms
from uwserver_bench.proofs.motion import decay_rise, energy_excess, momentum, record
from uwserver_bench.proofs.remus import SIMULATED, STEPS, Remus, remus_track

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.energy import kinetic_energy, rotations
from uwserver.physics.dynamics.immersion import immersion
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Environment
from uwserver.units import deg
from uwserver.validation.oracle import build, load_oracle, run, validate

ROOT = Path(__file__).parents[1]
TOOL = Path(__file__)
ORACLES = ROOT / "tests" / "physics" / "oracles"
PROOFS = ROOT / "bench" / "uwserver_bench" / "proofs"
DOCUMENT = ROOT / "docs" / "validation.md"
IMAGES = ROOT / "docs" / "images"
VEHICLES = tuple(sorted(path.stem for path in (ROOT / "scenarios" / "uwserver_scenarios" / "vehicles").glob("*.toml")))
TIME_STEPS_MS = (1, 4, 10, 20)
RATES = (30, 60, 120, 240, 480)
LONG = ("bluerov2_heavy_6axis_60s", "kirchhoff_free_60s", "work_class_full_60s")
SHORT = ("spheroid_1", "spheroid_2", "spheroid_3")
BARS = {"bluerov2_heavy_6axis_60s": 1e-6, "kirchhoff_free_60s": 1e-6, "work_class_full_60s": 5e-6}

INTRODUCTION = """\
`python tools/validation_report.py` writes this page: do not edit it. `--check` computes again what has changed. `tests/physics` asserts the
same bars (the largest error that is allowed). It also tests properties that have no number to show: each force term alone against its
formula, a circular turn in a current, the Galilean shift by a uniform current (1e-8 m), thruster tables, lag, inflow and immersion,
sub-steps and the implicit fallback of stiff bodies, fins from attached flow to a plate, propellers by the open-water curves of their source
in the first quadrant, and as a Wageningen B4-70 in all four (signs, drag when stopped, crash stop, no power from nothing), ballast, strips
and derivatives, and bit-identical repeats in another process and together with any other bodies. For contacts,
`tests/physics/test_contact.py` also tests hits between bodies, momentum across them, stillness at rest, and breaking loose in eight
directions.
"""


class Section(NamedTuple):
    """One table with its text."""

    title: str
    text: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    image: str = ""
    draw: Callable[[Path], None] | None = None


def vehicle_params(name: str) -> BodyParams:
    """Kernel parameters of a shipped vehicle in sea water."""
    scenario = Scenario(schema=1, vehicles={name: VehicleEntry(model=name, position_ned_m=(0.0, 0.0, 5.0))})
    resolved = load(scenario, adapters={}).vehicles[name]
    return body_params(resolved.vehicle, resolved.devices, Environment())


def oracle_section() -> Section:
    """Errors of each oracle file at its usual rate."""
    rows, errors, tracks = [], {}, {}
    for name in LONG + SHORT:
        rate = 240 if name in LONG else 1000
        result = validate(ORACLES / f"{name}.json", rate)
        rows.append((name, f"{rate}", f"{BARS.get(name, 1e-6):.0e}", *(number(worst.error) for worst in result[:4])))
    for name in LONG:
        oracle = load_oracle(ORACLES / f"{name}.json")
        expected = np.array(oracle.states)
        states, _ = run(oracle, 240.0)
        errors[name] = (np.array(oracle.t_s), np.linalg.norm((states - expected)[:, :3], axis=1))
        tracks[name] = (states, expected)
    return Section(
        "Free motion against independent trajectories",
        "Two independent authors integrated these cases with DOP853: full 6x6 added mass, centre of gravity off the origin, full damping\n"
        "matrices, current and a six-axis wrench. Gazebo's three spheroids are added; their published end state has a tolerance of 1e-3 m. The\n"
        "table gives the largest errors over all samples; `uwserver validate FILE...` gives the same for any file of the format.",
        ("oracle", "rate Hz", "bar m", "position m", "attitude deg", "velocity m/s", "rate rad/s"),
        rows,
        "validation_oracles.png",
        partial(plots.oracles, errors=errors, track=tracks["bluerov2_heavy_6axis_60s"]),
    )


def order_section() -> Section:
    """Error against rate, and the order between neighbours."""
    rows, curves = [], {}
    for name in ("kirchhoff_free_60s", "work_class_full_60s"):
        errors = [validate(ORACLES / f"{name}.json", rate).position.error for rate in RATES]
        curves[name] = errors
        for k, rate in enumerate(RATES):
            order = f"{math.log2(errors[k - 1] / errors[k]):.2f}" if k else ""
            rows.append((name, f"{rate}", number(errors[k]), order))
    return Section(
        "Order of convergence",
        "The table gives the largest position error over 60 s. The bar is an order of at least 3.8 for the Kirchhoff oracle from 60 to 240 Hz.\n"
        "In the work-class case the slope of |u_r| D_S nu_r jumps where the surge velocity changes sign; without that term it converges with\n"
        "order 4 and more.",
        ("oracle", "rate Hz", "position error m", "order"),
        rows,
        "validation_order.png",
        partial(plots.order, rates=RATES, curves=curves),
    )


def energy_section() -> Section:
    """Relative drift of what must be conserved."""
    rows, curves = [], {}
    for rate in (60, 120, 240):
        hydro = build(load_oracle(ORACLES / "kirchhoff_free_60s.json"))
        hydro.dt = 1.0 / rate
        before = momentum(hydro)[0]
        times, states = record(hydro, 60.0)
        energy = np.array([kinetic_energy(hydro.bodies, row, hydro.currents)[0] for row in states])
        drift = np.abs(energy / energy[0] - 1.0)
        after = momentum(hydro)[0]
        parts = [np.linalg.norm((after - before)[k]) / np.linalg.norm(before[k]) for k in (slice(0, 3), slice(3, 6))]
        rows.append((f"{rate}", number(float(drift.max())), number(float(parts[0])), number(float(parts[1]))))
        curves[rate] = (times, drift)
    return Section(
        "Energy and momentum",
        "The table gives the relative drift for a free body without damping, over 60 s. The bar is 1e-9 at 240 Hz. Coriolis forces come from\n"
        "momenta and do no work by construction, so the drift is the truncation error of the integrator.",
        ("rate Hz", "energy", "momentum", "angular momentum"),
        rows,
        "validation_energy.png",
        partial(plots.energy, curves=curves),
    )


def closed_form_section() -> Section:
    """Motions with a known answer."""
    rows = [(f.name, f.unit, f"{f.expected:.6g}", f"{f.measured:.6g}", number(f.error)) for f in closed_forms()]
    return Section(
        "Closed forms",
        "These are terminal velocities and natural frequencies of the BlueROV2 Heavy of Table A1 (von Benzon et al. 2022), the draft of a\n"
        "floating box and sphere, and the added mass 2/3 pi rho r^3 of a sphere. The bar is 0.1 %.",
        ("motion", "unit", "closed form", "kernel", "relative error"),
        rows,
    )


def contact_section() -> Section:
    """Contacts with a known answer."""
    rows = [(f.name, f.unit, f"{f.expected:.6g}", f"{f.measured:.6g}", number(f.error)) for f in contact_forms()]
    return Section(
        "Contact",
        "The body is a small ROV with a full 6x6 M_A, and the contact solver is ours. The bar of a hit is 1e-6, of the load 0.1 %, of the\n"
        "break-away force 2 % (it counts as loose at 1 mm/s, so a rising force finds it a little late).",
        ("contact", "unit", "closed form", "solver", "relative error"),
        rows,
    )


def stability_section(bodies: list[BodyParams]) -> Section:
    """The energy criterion for each vehicle and time step."""
    columns = [energy_excess(bodies, ms / 1000.0, 60.0) for ms in TIME_STEPS_MS]
    columns.append(np.array([decay_rise(body, 0.01, 20.0).max() for body in bodies]))
    rows = [(name, *(number(float(column[k])) for column in columns)) for k, name in enumerate(VEHICLES)]
    return Section(
        "Stability of every vehicle from 1 to 20 ms",
        "Each vehicle gets random wrenches up to half its weight, and random commands to fins, propellers, ballast and moving masses, for 60 s.\n"
        "The table gives the largest rise of kinetic energy in one step beyond the work done in it, divided by the kinetic energy. The bar is\n"
        "+1e-6. A negative number means that damping took more energy than any integration error added. Derivatives of a hull are no input:\n"
        "they must not add energy. The last column is the same for kinetic and potential energy in free decay from 100 random velocities of up\n"
        "to 3 m/s, also astern, sideways and turning, at 10 ms.",
        ("vehicle", *(f"{ms} ms" for ms in TIME_STEPS_MS), "free decay"),
        rows,
    )


def manoeuvre_section() -> Section:
    """REMUS 100 under the step inputs of the Python Vehicle Simulator, beside two other solutions."""
    rows = []
    ours = remus_track(240.0)
    for (_, end, _), got, wanted in zip(STEPS, ours, Remus().run(STEPS), strict=True):
        error = float(np.linalg.norm(got[:3] - wanted[:3]))
        rows.append((f"{end:g}", "same equations, DOP853", "1e-03", number(error)))
    extrapolated = 2.0 * np.array(SIMULATED[0.00125]) - np.array(SIMULATED[0.0025])
    for name, figures in (
        ("Python Vehicle Simulator, Euler 1.25 ms", np.array(SIMULATED[0.00125])),
        ("the same, extrapolated to 0", extrapolated),
    ):
        rows.append(("100", name, "2e-02", number(float(np.linalg.norm(ours[-1][:3] - figures)))))
    return Section(
        "REMUS 100: rudder, stern planes and propeller",
        "The inputs are steps of the Python Vehicle Simulator (Fossen; commit c717e07), without current: rudder and planes 5 degrees, 1525 rpm,\n"
        "planes to zero at 50 s; 245 m of path. Our kernel runs at 240 Hz with the file remus100_pvs, but neutral in the source's water, and\n"
        "with inflow by the whole speed as in the source. Like the source, the file takes the Munk moments out of C_A; the tests also compare\n"
        "the whole of C_A. The source's current turns with the heading alone and not with pitch and roll, so we do not compare its runs with\n"
        "current.",
        ("at s", "against", "bar m", "position m"),
        rows,
    )


def surface_section(bodies: list[BodyParams]) -> Section:
    """Vehicles let go 1.5 m deep, tilted, until they float."""
    floating = [
        (name, body) for name, body in zip(VEHICLES, bodies, strict=True) if body.buoyancy > 1.001 * body.weight
    ]
    names = [name for name, _ in floating]
    hydro = Hydrodynamics([body for _, body in floating], 0.01)
    hydro.state[:, 2] = 1.5
    hydro.state[:, Q : Q + 4] = quat_from_rpy(0.2, -0.1, 0.5)
    times, states = record(hydro, 240.0)
    rows = []
    for k, name in enumerate(names):
        moving = np.abs(states[:, k, NU : NU + 3]).max(axis=1) > 0.01
        settled = times[int(np.max(np.flatnonzero(moving)))]
        body, end = hydro.bodies[k], states[-1, k]
        share = float(body["weight"] / body["buoyancy"])
        rest = (f"{_submerged(hydro, end, k):.5f}", f"{end[2]:.4f}", f"{deg(tilt(end)):.2f}")
        rows.append((name, f"{share:.5f}", *rest, f"{settled:.0f}"))
    return Section(
        "At the surface",
        "Each vehicle that floats in sea water is released 1.5 m deep, tilted by 13 degrees. At rest the submerged part of the displaced volume\n"
        "must be weight over buoyancy. Settled means below 1 cm/s from then on.",
        ("vehicle", "weight / buoyancy", "submerged part", "origin at m", "tilt deg", "settled after s"),
        rows,
        "validation_surface.png",
        partial(plots.surface, times=times, states=states, names=names),
    )


def _submerged(hydro: Hydrodynamics, state: FloatArray, row: int) -> float:
    R = rotations(state[None, :])[0]
    return float(immersion(hydro.bodies[row], hydro.shapes, state[2], np.empty(3), np.stack([-R[2], R[0]])))


def number(value: float) -> str:
    """Three digits; what is only rounding is said to be so, as it differs from machine to machine."""
    return "< 1e-11" if abs(value) < 1e-11 else f"{value:.2e}"


def markdown(sections: Iterable[Section]) -> str:
    """The whole document."""
    parts = ["# Validation of the physics\n", INTRODUCTION]
    for section in sections:
        parts.append(f"## {section.title}\n\n{section.text}\n")
        lines = ["| " + " | ".join(section.head) + " |", "|" + "---|" * len(section.head)]
        lines += ["| " + " | ".join(row) + " |" for row in section.rows]
        parts.append("\n".join(lines) + "\n")
        if section.image:
            parts.append(f"![{section.title}](images/{section.image})\n")
    return "\n".join(parts)


def made() -> str:
    """Hash of all that the document is made of, and of its own text."""
    files = [*made_of.code(), *PROOFS.glob("*.py"), *ORACLES.glob("*.json"), TOOL]
    files += [path for name in VEHICLES for path in made_of.vehicle_files(name)]
    return made_of.digest(sorted(set(files)), DOCUMENT.read_text(encoding="utf-8"))


def document() -> tuple[str, list[Section]]:
    """Its text, and the sections that have pictures to draw; half a minute."""
    bodies = [vehicle_params(name) for name in VEHICLES]
    sections = [
        oracle_section(), order_section(), energy_section(), closed_form_section(), contact_section(),
        manoeuvre_section(),
        stability_section(bodies), surface_section(bodies),
    ]  # fmt: skip
    return markdown(sections), sections


def write() -> int:
    """The document, its pictures, and the hash."""
    text, sections = document()
    for section in sections:
        if section.draw:
            section.draw(IMAGES / section.image)
    DOCUMENT.write_text(text, encoding="utf-8")
    made_of.keep({made_of.named(DOCUMENT): made()})
    return 0


def check(everything: bool = False) -> int:
    """Exit status; nothing is run where the hash is the old one, unless `everything` is."""
    remedy = f"{made_of.named(DOCUMENT)} is stale: run python tools/validation_report.py"
    if not DOCUMENT.is_file():
        return made_of.outcome(made_of.missing(DOCUMENT), (), remedy)
    old = DOCUMENT.read_text(encoding="utf-8")
    same = made_of.kept().get(made_of.named(DOCUMENT)) == made()
    new = old if same and not everything else document()[0]
    images = [IMAGES / name for name in re.findall(r"images/(\w+\.png)", new)]
    return made_of.outcome(
        made_of.differences(old, new) + made_of.missing(*images), [] if same else [made_of.named(DOCUMENT)], remedy
    )


def main() -> int:
    """Exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare with the document instead of writing it")
    parser.add_argument("--all", action="store_true", help="check even if nothing has changed")
    chosen = parser.parse_args()
    return check(chosen.all) if chosen.check else write()


if __name__ == "__main__":
    sys.exit(main())

"""The files that `uwserver new` writes: a scenario with comments, or a vehicle file.

The vehicle file is a copy of a shipped one, with a hull from a mesh if there is one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.authoring.hull import (
    AT_REST,
    DRAG_ACROSS,
    DRAG_SLENDER,
    RIGHTING,
    TURNING,
    MeshHull,
    slenderness,
)

_TEXT = """\
# {name}: a scenario for uwserver.
#   uwserver check {name}.toml              is it right?
#   uwserver check --explain {name}.toml    what does it resolve to, with every default?
#   uwserver run {name}.toml                start it
# `uwserver list` shows what else there is; numbers are SI, keys end in their unit, angles here are in degrees.
schema = 1
title = {title}
seed = 1                                # of all noise: the same seed gives the same run

[world]
rate_hz = 240                           # physics; every sensor rate divides it

[environment]
density_kgpm3 = 1025                    # sea water; fresh water is 1000
temperature_degc = 10

[environment.current]
velocity_ned_mps = [0.0, 0.0, 0.0]      # north, east, down

# The name of this table is the name of the vehicle on every connection: rov/...
[vehicles.rov]
model = {vehicle}
position_ned_m = [0.0, 0.0, 2.0]        # 2 m below the surface
attitude_rpy_deg = [0.0, 0.0, 0.0]

# Change any number of the vehicle file for this vehicle alone:
# [vehicles.rov.override.rigid_body]
# mass_kg = 14.0

# Ground truth under rov/truth/: served only by adapters with truth = true.
[vehicles.rov.truth]
rate_hz = 20

# A sensor more than the vehicle file has.
[vehicles.rov.sensors.mocap]
kind = "motion_capture"
rate_hz = 30
latency_s = 0.01

# Its errors, applied in this order.
[vehicles.rov.sensors.mocap.modifiers.noise]
kind = "white_noise"
field = "p_NS"
sigma = 0.002                           # m

# Programs connect here: uwclient, or `nc localhost 7600`.
[adapters.tcp]
kind = "sockets"
port = 7600
"""
SEA_WATER = 1025.0
"""Density in which a vehicle of unknown mass is assumed to be neutral, kg/m3."""
_HULL_TABLES = ("rigid_body", "buoyancy", "collision", "added_mass", "damping", "hull")
_DROPPED_TABLES = ("published",)
"""Figures of the real vehicle that the file is copied from; they are not true of a new one."""
_RIGHTING = (
    f"the centre of gravity is taken to lie {RIGHTING:g} of the height below: find it by hanging the vehicle up, or by its "
    "roll period"
)
_SHAPES = "# The form near the surface: the box around the mesh. Several that resemble floats and frame are better."
_ELLIPSOID = (
    "that of the ellipsoid with the second moments of {mesh} (Lamb, Hydrodynamics, 114 and 115); edges and enclosed "
    "water add to it"
)
_AT_REST = f"{AT_REST:g} of the quadratic at 1 m/s and 1 rad/s, as BlueROV2's"
_PLATES = (
    "lift of a hull at a small angle to the flow: half that of flat plates of low aspect ratio (Jones, NACA 835) of its "
    "side and plan; turning: the same spread evenly over length and width"
)
_MUNK = (
    "nine tenths of the terms of C_A taken out, in whole pairs, which do no work: behind a blunt body the flow separates "
    "and carries little Munk moment"
)
_HEADER = re.compile(r"^\[\[?\s*\"?([\w-]+)")


def starter(name: str, vehicle: str) -> str:
    """Return the TOML text of a scenario with one vehicle.

    Args:
        name: stem of the file name.
        vehicle: name of a shipped vehicle, or path of a vehicle file.
    """
    # A JSON string without line breaks is a TOML basic string.
    return _TEXT.format(name=name, title=json.dumps(name), vehicle=json.dumps(vehicle, ensure_ascii=False))


# -- vehicle files ----------------------------------------------------------------------------------------------------------------------


def vehicle_starter(
    name: str, base: str, text: str, hull: MeshHull | None = None, mesh: str = "", mass_kg: float | None = None,
    reading: str = "",
) -> str:  # fmt: skip
    """Return the TOML text of a vehicle file.

    Args:
        name: name of the new vehicle.
        base: name of the vehicle that it is copied from.
        text: text of that vehicle's file.
        hull: replaces the hull of that vehicle.
        mesh: file of the hull, relative to the new file.
        mass_kg: from a data sheet or scales; None: that of neutral buoyancy in sea water.
        reading: keys for reading the mesh file, as TOML lines (`up`, `scale`).
    """
    dropped = (*_DROPPED_TABLES, *(_HULL_TABLES if hull else ()))
    kept = [block for top, block in _blocks(text) if top and top not in dropped]
    head = _head(name, base, hull, mesh)
    body = [] if hull is None else list(_hull(hull, mesh, mass_kg, reading))
    return "\n\n".join(block.strip() for block in (head, *body, *kept)) + "\n"


def _blocks(text: str) -> Iterator[tuple[str, str]]:
    """Yield each table with the comments above it, by its top name; "" for the text before the first table."""
    top, lines, above = "", list[str](), list[str]()
    for line in text.splitlines():
        if found := _HEADER.match(line):
            yield top, "\n".join(lines)
            top, lines, above = found[1], [*above, line], []
        elif not line.strip() or line.startswith("#"):
            above.append(line)
        else:
            lines, above = [*lines, *above, line], []
    yield top, "\n".join([*lines, *above])


def _head(name: str, base: str, hull: MeshHull | None, mesh: str) -> str:
    what = f"begun as {base}" + (f", with the hull of {mesh}" if hull else "")
    lines = [
        f"# {name}: a vehicle of your own. Each number has its source and a status; change both when you know better.",
        f"#   uwserver manoeuvres {name}.toml          what does it do?",
        f"#   uwserver plot vehicle {name}.toml        what does it look like? (needs the extra plot)",
        f"#   uwserver new tank --vehicle {name}.toml  a scenario with it",
        "# B is forward, right, down; its origin is the centre of gravity.",
    ]
    if hull:
        at = ", ".join(_number(x) for x in hull.cad_origin)
        lines += [
            f"# The origin of {mesh} lies at [{at}] in B: add this to places from CAD, once they are forward, right, down.",
            f"# Thrusters, mounts and sensors are still those of {base}: put in your own.",
        ]
    return "\n".join(
        [*lines, "schema = 1", f"name = {json.dumps(name)}", f"description = {json.dumps(what, ensure_ascii=False)}"]
    )


def _hull(hull: MeshHull, mesh: str, mass_kg: float | None, reading: str) -> Iterator[str]:
    mass = SEA_WATER * hull.volume if mass_kg is None else mass_kg
    neutral = f"mass that is neutral in sea water ({SEA_WATER:g} kg/m3): weigh the vehicle"
    even = f"inertia of that mass spread evenly over the volume of {mesh}, without the water inside an open frame"
    body = (f"mass_kg = {_number(mass)}", f"inertia_matrix_kgm2 = {_matrix(hull.inertia(mass))}")
    if mass_kg is None:
        yield _table("rigid_body", f"{neutral}; {even}", "guess", *body)
    else:
        yield _table("rigid_body", f"mass as given; {even}", "derived", *body)
    place = f"volume_m3 = {_number(hull.volume)}", f"center_frd_m = {_row(hull.center_of_buoyancy)}"
    yield _table("buoyancy", f"volume of {mesh}; {_RIGHTING}", "guess", *place)
    box = ("[buoyancy.shapes.hull]", 'kind = "box"', f"size_m = {_row(hull.size)}")
    yield "\n".join((_SHAPES, *box, f"center_frd_m = {_row(hull.box_center)}"))
    solid = ("[collision.hull]", 'kind = "hull"', f"file = {json.dumps(mesh, ensure_ascii=False)}")
    yield "\n".join(("# The convex hull of the mesh.", *solid, f"{reading}center_frd_m = {_row(hull.cad_origin)}"))
    yield from _water(hull, mesh)


def _water(hull: MeshHull, mesh: str) -> Iterator[str]:
    """Yield added mass, damping and hull derivatives from formulas, all with status "guess"."""
    slender = slenderness(np.array(hull.size))
    ahead, times = DRAG_ACROSS + slender * (DRAG_SLENDER - DRAG_ACROSS), TURNING + slender * (1.0 - TURNING)
    drag = f"C_D {ahead:.2g} ahead and {DRAG_ACROSS:g} across on the silhouette of the convex hull"
    turning = f"turning: {times:.2g} times that of bare strips, as frame and thrusters of small ROVs add"
    density = "reference_density_kgpm3 = 1000.0"
    ellipsoid = _ELLIPSOID.format(mesh=mesh)
    yield _table("added_mass", ellipsoid, "guess", density, f"diagonal = {_row(hull.added_mass)}")
    yield f"[damping]\n{density}"
    yield _table("damping.quadratic", f"{drag}; {turning}", "guess", f"diagonal = {_row(hull.quadratic)}")
    yield _table("damping.linear", _AT_REST, "guess", f"diagonal = {_row(hull.linear)}")
    yield _table("damping.speed", _PLATES, "guess", f"diagonal = {_row(hull.lift)}")
    yield _table("hull.derivatives", _MUNK, "guess", density)
    x, y, z = (0.9 * float(a) for a in hull.added_mass[:3])
    terms = {"Xwq": z, "Xvr": -y, "Ywp": -z, "Yur": x, "Zvp": y, "Zuq": -x, "Kvw": z - y, "Muw": x - z, "Nuv": y - x}
    yield "\n".join(["[hull.derivatives.terms]", *(f"{key} = {_number(value)}" for key, value in terms.items())])


def _table(name: str, source: str, status: str, *lines: str) -> str:
    return "\n".join(
        [f"[{name}]", f"source = {json.dumps(source, ensure_ascii=False)}", f'status = "{status}"', *lines]
    )


def _matrix(matrix: FloatArray) -> str:
    return "[\n" + "".join(f"  {_row(row)},\n" for row in matrix) + "]"


def _row(values: Sequence[float] | FloatArray) -> str:
    return f"[{', '.join(_number(float(value)) for value in values)}]"


def _number(value: float) -> str:
    """Return a number with six digits; below a billionth it is 0.0, without a sign."""
    text = f"{value:.6g}" if abs(value) >= 1e-9 else "0.0"
    return text if set(text) & set(".en") else text + ".0"

"""The pictures of the pages on acoustic sensors in docs/reference/sensors: a sonar picture, an altimeter's profile, DVL and baselines."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import matplotlib
import msgspec
import numpy as np
from msgspec import structs
from PIL import Image

from uwserver.environment.acoustics.boundaries import lambert
from uwserver.environment.acoustics.noise import ambient_db
from uwserver.environment.currents import ProfileConfig, profile_rows
from uwserver.environment.water import Sea, Water
from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Cylinder, Placed, Solid, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import WAVE_SIZE, SeaRows
from uwserver.physics.rays.casting import Rays
from uwserver.physics.rays.raycast import Geometry
from uwserver.ports import Buffer
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.vehicle.devices import check_profile
from uwserver.sensors import (
    AcousticModemConfig,
    AltimeterConfig,
    DvlConfig,
    LblConfig,
    OpticalModemConfig,
    Pose,
    ScanningSonarConfig,
    Scope,
    Sensor,
    SensorConfig,
    UsblConfig,
)
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.sensors.modem import Modem
from uwserver.testing import FakeGeometry
from uwserver.testing.fake_geometry import Plane
from uwserver.units import deg, rad

# Before pyplot is imported: no display.
matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

IMAGES = Path(__file__).parents[1] / "docs/images"
WATER = Water(1025.0, 9.81, 10.0, 101_325.0, (0.2, 0.1, 0.0))
DEPTH = 20.0
GRAINY, WIDTH = ("scanning_sonar", "multibeam"), 1100
"""Pictures that are all speckle, and their width in pixels."""


def main() -> None:
    """Draw all."""
    geometry = harbour()
    for name, draw in (
        ("scanning_sonar", scanning_sonar),
        ("multibeam", multibeam),
        ("side_scan", side_scan),
        ("bathymetry", bathymetry),
        ("profiler", profiler),
        ("altimeter", altimeter),
        ("dvl", dvl),
        ("adcp", adcp),
        ("usbl", usbl),
        ("lbl", lbl),
        ("acoustic_modem", acoustic_modem),
        ("optical_modem", optical_modem),
    ):
        figure = draw(geometry)
        IMAGES.mkdir(parents=True, exist_ok=True)
        file = IMAGES / f"sensor_{name}.png"
        # Without the version of matplotlib in it, the same plot is the same file.
        figure.savefig(file, dpi=110, metadata={"Software": None}, bbox_inches="tight")
        if name in GRAINY:
            made_small(file)
        plt.close(figure)


def made_small(file: Path) -> None:
    """Speckle makes a large file: fewer pixels and colours."""
    with Image.open(file) as whole:
        picture = whole.convert("RGB")
    picture = picture.resize((WIDTH, picture.height * WIDTH // picture.width), Image.Resampling.LANCZOS)
    # The colours that lie farthest apart, so that the few bright echoes keep theirs.
    picture.quantize(48, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(file, optimize=True)


def harbour() -> Geometry:
    """A wavy bottom 20 m deep with piles, a wall and a box."""
    n = 201
    x, y = np.meshgrid(np.linspace(-60.0, 60.0, n), np.linspace(-60.0, 60.0, n), indexing="ij")
    z = DEPTH + 0.4 * np.sin(x / 5.0) * np.cos(y / 7.0) + 0.12 * np.sin(1.9 * x + 0.7 * y)
    corner = np.arange((n - 1) * (n - 1))
    corner = corner // (n - 1) * n + corner % (n - 1)
    lower = np.stack([corner, corner + 1, corner + n], axis=1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n], axis=1)
    bottom = TriangleMesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.concatenate([lower, upper]), False)
    rays = Rays()
    rays.add_static(0, Solid("bottom", (Placed(bottom),), material=0))
    upright = quat_from_rpy(0.0, math.pi / 2.0, 0.0)
    piles = [Placed(Cylinder(0.4, 10.0), (8.0, 4.0 * k - 10.0, 12.0), upright) for k in range(6)]
    rays.add_static(1, Solid("piles", tuple(piles), material=1))
    turned = quat_from_rpy(0.0, 0.0, 0.4)
    rays.add_static(2, Solid("wall", (Placed(Box((0.5, 12.0, 10.0)), (-16.0, 3.0, 12.0), turned),), material=2))
    rays.add_static(3, Solid("box", (Placed(Box((1.0, 2.0, 1.0)), (-2.0, 11.0, 19.0), turned),), material=1))
    return rays.at(np.zeros((1, 13)))


def instant(geometry: Geometry, p: tuple[float, float, float], t: float = 0.0, yaw: float = 0.0) -> Scope:
    """A vehicle there, level, that moves ahead at 0.5 m/s."""
    scope = Scope(
        round(t * 1e9), p, quat_from_rpy(0.0, 0.0, yaw), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0), WATER, geometry=geometry
    )
    scope.lambert = lambert(["sediment", "steel", "concrete"])
    return scope


def device(name: str, mount: Pose | None = None, **keys: object) -> Sensor:
    """The instrument of a shipped device file."""

    def fail(*problem: object) -> None:
        raise ValueError(f"{name}: {problem}")

    given = check_profile(msgspec.toml.decode(shipped("devices")[name].read_bytes()), fail)
    config = msgspec.convert({"rate_hz": 240.0, **(given or {}), **keys}, SensorConfig)
    instrument = config.build(mount or Pose())
    instrument.start(1)
    return instrument


def scanning_sonar(geometry: Geometry) -> Figure:
    """A full turn of the Micron, at rest and while turning, and the paper's picture."""
    figure, axes = plt.subplots(1, 3, figsize=(15.0, 5.2), layout="constrained", subplot_kw={"projection": "polar"})
    still = device("micron_dst", range_m=25.0)
    moving = device("micron_dst", range_m=25.0)
    paper = ScanningSonarConfig(rate_hz=240.0, model="paper", range_m=25.0, step_deg=0.9).build(Pose())
    titles = ("Micron DST, sonar equation, at rest", "the same while yawing 5 degrees a second", 'model = "paper"')
    for axis, sonar, rate, title in zip(axes, (still, moving, paper), (0.0, rad(5.0), 0.0), titles, strict=True):
        angles, rows = turn_of(sonar, geometry, rate, (0.0, 0.0, DEPTH - 2.5), (0, 3))
        edges = np.linspace(0.0, 25.0, rows.shape[1] + 1)
        ring = np.append(angles, angles[-1] + rad(0.9))
        axis.pcolormesh(ring, edges, rows.T, cmap="copper", vmin=0, vmax=max(60.0, float(np.quantile(rows, 0.999))))
        axis.set_theta_zero_location("N")
        axis.set_theta_direction(-1)
        axis.set_title(title, fontsize=10)
        axis.grid(visible=False)
    return figure


def multibeam(geometry: Geometry) -> Figure:
    """The harbour as an Oculus M750d sees it, and with an array without taper, whose side lobes draw arcs."""
    figure, axes = plt.subplots(1, 2, figsize=(11.0, 4.4), layout="constrained", subplot_kw={"projection": "polar"})
    titles = ("Oculus M750d, low mode", 'taper = "none": side lobes of 13 dB')
    for axis, taper, title in zip(axes, ("hamming", "none"), titles, strict=True):
        sonar = device("oculus_m750d", range_m=25.0, taper=taper)
        scope = instant(geometry, (-6.0, 0.0, DEPTH - 4.0))
        scope.q_NB = quat_from_rpy(0.0, rad(-8.0), 0.0)
        _, values = sonar.measure(scope)
        azimuth, image = values[-2], values[-1]
        assert isinstance(azimuth, Buffer)
        assert isinstance(image, Buffer)
        edges = np.linspace(0.0, 25.0, image.shape[0] + 1)
        angles = np.append(azimuth.array(), 2.0 * azimuth.array()[-1] - azimuth.array()[-2])
        axis.pcolormesh(angles, edges, image.array(), cmap="copper", vmin=0, vmax=200)
        axis.set_theta_zero_location("N")
        axis.set_theta_direction(-1)
        axis.set_thetamin(-65)
        axis.set_thetamax(65)
        axis.set_title(title, fontsize=10)
        axis.grid(visible=False)
    return figure


def turn_of(
    sonar: Sensor, geometry: Geometry, yaw_rate: float, p: tuple[float, float, float], columns: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """(400) head angles and (400, ...) echoes of one turn, of these columns of the readings, pings as fast as the device allows."""
    angles, echoes, t = [], [], 0.0
    while len(echoes) < 400:
        reading = sonar.sense(instant(geometry, p, t, yaw_rate * t))
        t += 1.0 / 240.0
        if reading is not None:
            angle, echo = (reading.values[k] for k in columns)
            angles.append(angle)
            echoes.append(math.nan if echo is None else echo)
    return np.unwrap(np.array(angles, dtype=float)), np.array(echoes, dtype=float)


def side_scan(geometry: Geometry) -> Figure:
    """A waterfall of the StarFish along the piles and the wall, 6 m above the bottom."""
    sonar, ahead = device("starfish_452f", range_m=30.0), np.linspace(-40.0, 40.0, 600)
    rows = []
    for k, x in enumerate(ahead):
        sonar.begin(k)
        _, values = sonar.measure(instant(geometry, (float(x), -16.0, DEPTH - 6.0), 0.2 * k))
        port, starboard = (value.array() for value in values[-2:] if isinstance(value, Buffer))
        rows.append(np.concatenate([port[::-1], starboard]))
    figure, axis = plt.subplots(figsize=(5.8, 4.4), layout="constrained")
    # Few colours and the mean of neighbours, for grain makes a large file.
    shown = np.array(rows, dtype=float).reshape(-1, 2, 400, 5).mean(axis=(1, 3))
    axis.imshow(
        shown, cmap=plt.get_cmap("copper", 32), extent=(-30.0, 30.0, -40.0, 40.0), origin="lower", aspect="auto",
        vmin=0, vmax=255, interpolation="nearest",
    )  # fmt: skip
    axis.set(xlabel="slant range, port and starboard (m)", ylabel="north (m)")
    return figure


def bathymetry(geometry: Geometry) -> Figure:
    """A survey line of the NORBIT over the harbour, and one of its swaths, over the box."""
    sonar, ahead = device("norbit_wbms", range_m=30.0), np.arange(-30.0, 30.0, 0.5)
    height, east, over = DEPTH - 10.0, 6.0, -2.0
    lines = [swath_of(sonar, geometry, (float(x), east, height), k) for k, x in enumerate(ahead)]
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8.0, 7.6), layout="constrained", height_ratios=(2.4, 1.0))
    # Each sounding as a cell as long as the way between pings.
    edges = np.arange(-22.0, 34.5, 0.5)
    depths = np.full((len(ahead), len(edges) - 1), np.nan)
    for row, (a, r) in zip(depths, lines, strict=True):
        cell = np.searchsorted(edges, east + r * np.sin(a)) - 1
        heard = np.isfinite(r) & (cell >= 0) & (cell < len(row))
        row[cell[heard]] = (height + r * np.cos(a))[heard]
    colours = plt.get_cmap("viridis_r", 32)
    shown = top.imshow(
        depths, cmap=colours, extent=(edges[0], edges[-1], -30.0, 30.0), origin="lower", vmin=17.0, vmax=21.0,
        interpolation="nearest",
    )  # fmt: skip
    top.axvline(east, color="k", lw=0.6, ls=":")
    top.axhline(over, color="k", lw=0.6, ls="--")
    title = "NORBIT WBMS at 10 m: a box, a wall and a row of piles, with their shadows"
    top.set(xlabel="east (m)", ylabel="north (m)", title=title)
    figure.colorbar(shown, ax=top, label="depth (m)", extend="min")
    angle, found = lines[int(np.abs(ahead - over).argmin())]
    true = seen_by(geometry, (over, east, height), np.stack([0.0 * angle, np.sin(angle), np.cos(angle)], axis=1))
    bottom.plot(
        east + true * np.sin(angle),
        height + true * np.cos(angle),
        "k-",
        lw=0.8,
        label="what the axis of each beam meets",
    )
    bottom.plot(
        east + found * np.sin(angle),
        height + found * np.cos(angle),
        ".",
        ms=3,
        label="soundings of the ping at the dashed line",
    )
    bottom.set(xlabel="east (m)", ylabel="depth (m)", ylim=(21.5, 14.5), xlim=(-22.0, 34.0))
    bottom.legend(fontsize=8, loc="upper left")
    bottom.grid(visible=True, alpha=0.3)
    return figure


def swath_of(sonar: Sensor, geometry: Geometry, p: tuple[float, float, float], k: int) -> tuple[FloatArray, FloatArray]:
    """Angles and ranges of the k-th ping."""
    sonar.begin(k)
    _, values = sonar.measure(instant(geometry, p, 0.2 * k))
    angle, found = (value.array().astype(float) for value in values[4:6] if isinstance(value, Buffer))
    return angle, found


def seen_by(geometry: Geometry, p: tuple[float, float, float], direction: FloatArray) -> FloatArray:
    """(n) distances straight on."""
    origin = np.tile(np.array(p), (len(direction), 1))
    return geometry.raycast(origin, np.ascontiguousarray(direction), 200.0).distance


def profiler(geometry: Geometry) -> Figure:
    """Full turns of two heads across the way, past the wall."""
    figure, axes = plt.subplots(1, 2, figsize=(11.0, 4.9), layout="constrained", sharey=True)
    p, across, names = (
        (-16.5, -6.0, DEPTH - 6.0),
        Pose.from_degrees((0.0, -90.0, 0.0)),
        ("imagenex_881", "super_seaking"),
    )
    for axis, name in zip(axes, names, strict=True):
        sonar = device(f"{name}_profiler", across, range_m=20.0, sector_width_deg=360.0, step_deg=0.9)
        angle, found = turn_of(sonar, geometry, 0.0, p, (4, 5))
        rays = np.linspace(-math.pi, math.pi, 1440)
        true = seen_by(geometry, p, np.stack([0.0 * rays, np.sin(rays), np.cos(rays)], axis=1))
        true[true > 20.0] = math.nan
        axis.plot(p[1] + true * np.sin(rays), p[2] + true * np.cos(rays), "k-", lw=0.8, label="what a thin ray meets")
        axis.plot(p[1] + found * np.sin(angle), p[2] + found * np.cos(angle), ".", ms=3, label="echoes of one turn")
        axis.plot(p[1], p[2], "kx", ms=7)
        axis.axhline(0.0, color="C0", lw=0.8, alpha=0.5, label="surface")
        axis.set(xlabel="east (m)", title=f"{name}_profiler", aspect="equal", ylim=(22.0, -2.0))
        axis.grid(visible=True, alpha=0.3)
    axes[0].set_ylabel("depth (m)")
    axes[0].legend(fontsize=8, loc=(0.12, 0.45))
    return figure


def altimeter(geometry: Geometry) -> Figure:
    """A flight over the bottom and a box: Ping1D, Micron Echosounder, truth below."""
    figure, axis = plt.subplots(figsize=(9.0, 3.8), layout="constrained")
    ahead = np.arange(-12.0, 12.0, 0.05)
    for name in ("ping1d", "micron_echosounder"):
        sounder = device(name, multiple_probability=0.01)
        found = [sounded(sounder, geometry, x) for x in ahead]
        axis.plot(ahead, found, ".", ms=3, label=name)
    ray = AltimeterConfig(rate_hz=240.0, ideal=True, beam_width_deg=0.1, rings=0).build(Pose())
    axis.plot(ahead, [sounded(ray, geometry, x) for x in ahead], "k-", lw=0.8, label="straight below")
    axis.set(
        xlabel="north (m)", ylabel="range (m)", title="first echo in the cone, over a box at 8 m", ylim=(12.0, 0.0)
    )
    axis.legend(fontsize=8)
    axis.grid(visible=True, alpha=0.3)
    return figure


def sounded(sounder: Sensor, geometry: Geometry, x: float) -> float:
    """Range (m) over a place of the flight; NaN without echo."""
    sounder.memory = structs.replace(sounder.memory, ready=0.0)
    valid, values = sounder.measure(instant(geometry, (x, 11.0, DEPTH - 8.0)))
    return float(values[0]) if valid and isinstance(values[0], float) else math.nan


def dvl(geometry: Geometry) -> Figure:
    """Scatter of the velocity, and locks while the vehicle rises."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.0), layout="constrained")
    for name in ("dvl1000", "a50"):
        log = device(name)
        v = []
        for _ in range(1500):
            log.memory = structs.replace(log.memory, ready=0.0)
            v.append(log.measure(instant(geometry, (0.0, 0.0, DEPTH - 10.0)))[1][0])
        east = np.array([[a, b] for a, b, _ in (x for x in v if x[0] is not None)], dtype=float)
        left.plot(1e3 * east[:, 0], 1e3 * east[:, 1], ".", ms=2, label=name)
    left.set(xlabel="surge (mm/s)", ylabel="sway (mm/s)", title="true velocity 500, 0 mm/s; scale error of this run")
    log = DvlConfig(rate_hz=240.0, max_altitude_m=25.0).build(Pose())
    heights = np.linspace(0.5, 19.0, 150)
    for tilt, colour in ((0.0, "C0"), (20.0, "C1"), (35.0, "C2")):
        locks = []
        for height in heights:
            scope = instant(geometry, (20.0, 0.0, DEPTH - height))
            scope.q_NB = quat_from_rpy(0.0, rad(tilt), 0.0)
            seen = log.measure(scope)[1][6]
            locks.append(sum(bool(lock) for lock in seen) if isinstance(seen, tuple) else 0)
        right.plot(heights, locks, color=colour, label=f"pitch {tilt:g} degrees")
    right.set(xlabel="height (m)", ylabel="beams in lock", title="a device for 25 m over sediment")
    for axis in (left, right):
        axis.legend(fontsize=8)
        axis.grid(visible=True, alpha=0.3)
    return figure


def jet(z: float) -> tuple[float, float, float]:
    """Velocity (m/s, N) at a depth (m) of water that flows faster towards the surface, and across in a layer."""
    return 0.4 * (1.0 - z / 40.0), 0.25 * math.exp(-(((z - 20.0) / 4.0) ** 2)), 0.0


def adcp(geometry: Geometry) -> Figure:
    """One ensemble of a profiler that moves, over ground, against the truth; and what it does to the last cells above the bottom."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.5), layout="constrained")
    depth = np.linspace(0.0, 40.0, 401)
    truth = np.array([jet(z) for z in depth])
    profile = ProfileConfig(depth_m=tuple(depth.tolist()), velocity_ned_mps=tuple(map(jet, depth.tolist())))
    sea = Sea(SeaRows(np.zeros(7), profile_rows(profile), np.zeros((0, WAVE_SIZE))))
    flat = FakeGeometry([Plane((0.0, 0.0, 40.0), (0.0, 0.0, -1.0))])
    scope = instant(flat, (0.0, 0.0, 3.0))
    scope.water = Water(1025.0, 9.81, 10.0, 101_325.0, (0.0, 0.0, 0.0), sea)
    for axis, pings, title in ((left, 1, "one ping"), (right, 64, "64 pings")):
        profiler = device(
            "workhorse600", cell_size_m=1.0, cells=40, pings=pings, heading_sigma_deg=0.0, tilt_sigma_deg=0.0
        )
        values = profiler.measure(scope)[1]
        z = 3.0 + np.array(values[0], float)
        over_ground = np.array(values[2], float).reshape(-1, 3)
        for i, name in enumerate(("north", "east")):
            axis.plot(truth[depth >= 3.0, i], depth[depth >= 3.0], color=f"C{i}", lw=1, alpha=0.6)
            axis.plot(over_ground[:, i], z, ".", color=f"C{i}", label=name)
        axis.axhline(3.0 + 37.0 * math.cos(rad(20.0)), color="k", lw=0.8, ls=":", label="side lobes meet the bottom")
        axis.axhline(40.0, color="k", lw=0.8)
        axis.set(
            xlabel="velocity of the water over ground (m/s)",
            ylabel="depth (m)",
            ylim=(41.0, 0.0),
            xlim=(-0.4, 0.8),
            title=title,
        )
        axis.legend(fontsize=8)
        axis.grid(visible=True, alpha=0.3)
    return figure


def tracked(instrument: Sensor, geometry: Geometry, n: int) -> tuple[FloatArray, list[list[object]]]:
    """(n) times at which questions went out, s, and the values of the readings, along a straight run."""
    times, values, t = [], [], 0.0
    while len(times) < n:
        reading = instrument.sense(instant(geometry, (-25.0 + 0.5 * t, -20.0, 10.0), t))
        if reading is not None:
            times.append(t)
            values.append(list(reading.values))
        t += 1.0 / 20.0
    return np.array(times), values


def usbl(geometry: Geometry) -> Figure:
    """Positions of one beacon as heard along a run, and the error of the bearing over range."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.0), layout="constrained")
    beacon = {"b": Beacon(position_ned_m=(15.0, 25.0, 19.0))}
    config = UsblConfig(rate_hz=5.0, beacons=beacon, source_level_db=165.0, multipath_probability=0.03)
    instrument = config.build(Pose())
    times, values = tracked(instrument, geometry, 250)
    heard = np.array(
        [[-25.0 + 0.5 * t + v[4][0], -20.0 + v[4][1]] for t, v in zip(times, values, strict=True) if v[1] is not None]
    )  # type: ignore[index]
    left.plot(heard[:, 1], heard[:, 0], ".", ms=3, label="beacon as heard")
    left.plot([25.0], [15.0], "k+", ms=12, label="beacon")
    left.plot([-20.0, -20.0], [-25.0, -25.0 + 0.5 * times[-1]], "k-", lw=0.8, label="vehicle")
    left.set(
        xlabel="east (m)", ylabel="north (m)", title="one beacon; reflections are late, gaps are hidden", aspect="equal"
    )
    for d in (0.01, 0.03, 0.1):
        signal = np.linspace(5.0, 40.0, 50)
        sigma = 1485.0 / (2.0 * math.pi * 26e3 * d) / np.sqrt(10.0 ** (0.1 * signal))
        right.semilogy(signal, [deg(s) for s in sigma], label=f"{1e3 * d:g} mm between hydrophones")
    right.set(xlabel="signal over noise (dB)", ylabel="error of bearing (degrees)", title="on the axis, 26 kHz")
    for axis in (left, right):
        axis.legend(fontsize=8)
        axis.grid(visible=True, alpha=0.3)
    return figure


def lbl(geometry: Geometry) -> Figure:
    """Ranges of three beacons along a run, at the time of their delivery."""
    figure, axis = plt.subplots(figsize=(9.0, 3.8), layout="constrained")
    beacons = {
        "north": Beacon(position_ned_m=(55.0, 0.0, 19.0)),
        "east": Beacon(position_ned_m=(0.0, 50.0, 19.0)),
        "ship": Beacon(position_ned_m=(-50.0, -30.0, 3.0), velocity_ned_mps=(1.0, 0.0, 0.0)),
    }
    config = LblConfig(rate_hz=5.0, beacons=beacons, source_level_db=165.0, multipath_probability=0.05)
    times, values = tracked(config.build(Pose()), geometry, 360)
    for name in beacons:
        chosen = [(t, v[1]) for t, v in zip(times, values, strict=True) if v[0] == name]
        axis.plot(*zip(*((t, math.nan if r is None else r) for t, r in chosen), strict=True), ".", ms=3, label=name)
    axis.set(xlabel="time (s)", ylabel="range (m)", title="three beacons in turn; gaps: hidden behind wall and piles")
    axis.legend(fontsize=8)
    axis.grid(visible=True, alpha=0.3)
    return figure


def modem(name: str, **keys: object) -> Modem:
    """A shipped one."""
    given = check_profile(read(shipped("devices")[name]).raw, lambda *problem: None)
    assert given is not None
    kind = {"acoustic_modem": AcousticModemConfig, "optical_modem": OpticalModemConfig}[given.pop("kind")]
    return msgspec.convert({**given, "rate_hz": 1.0, **keys}, kind).build(Pose())


def acoustic_modem(geometry: Geometry) -> Figure:
    """How often a full packet is understood over range, in a calm and in a rough sea."""
    figure, axis = plt.subplots(figsize=(9.0, 3.8), layout="constrained")
    scope, level = instant(geometry, (0.0, 0.0, 10.0)), (1.0, 0.0, 0.0, 0.0)
    ranges = np.geomspace(50.0, 40_000.0, 140)
    for k, name in enumerate(("m64", "seatrac_x150_modem", "micromodem", "s2cr_18_34", "janus")):
        for wind, style in ((0.0, "-"), (10.0, "--")):
            device = modem(name, propagation="straight")
            device = modem(
                name, propagation="straight", noise_level_db=ambient_db(device.signal(level).frequency, wind)
            )
            understood = []
            for r in ranges:
                c = device.crossing(scope, device.signal(level), (0.0, 0.0, 10.0), (r, 0.0, 10.0), level, 0.0)
                assert c is not None
                snr = c.signal / c.noise
                understood.append(
                    1.0 - device.error_rate(snr, min(device.table.max_bytes, 64)) if device.notices(snr) else 0.0
                )
            axis.semilogx(ranges, understood, style, color=f"C{k}", label=name if wind == 0.0 else None)
    axis.set(
        xlabel="range (m)",
        ylabel="packets understood",
        title="full packets (janus: 64 bytes) in still water; dashed: a wind of 10 m/s",
    )
    axis.legend(fontsize=8)
    axis.grid(visible=True, alpha=0.3)
    return figure


def optical_modem(geometry: Geometry) -> Figure:
    """The same of light, in each type of water."""
    figure, axis = plt.subplots(figsize=(9.0, 3.8), layout="constrained")
    device, level, back = modem("luma"), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    ranges = np.linspace(1.0, 80.0, 200)
    for jerlov in ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "9C"):
        scope = replace(instant(geometry, (0.0, 0.0, 10.0)), water=replace(WATER, jerlov=jerlov))
        understood = []
        for r in ranges:
            c = device.crossing(scope, device.signal(level), (0.0, 0.0, 10.0), (r, 0.0, 10.0), back, 0.0)
            understood.append(
                0.0 if c is None or not device.notices(c.signal) else 1.0 - device.error_rate(c.signal, 1000)
            )
        axis.plot(ranges, understood, label=jerlov)
    axis.set(xlabel="range (m)", ylabel="packets understood", title="luma, 1000 bytes, on the axis, by type of water")
    axis.legend(fontsize=8, ncols=3)
    axis.grid(visible=True, alpha=0.3)
    return figure


if __name__ == "__main__":
    main()

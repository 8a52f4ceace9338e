"""What the scenarios with solid things promise: walls stop, structures are touched and seen, a slope is as deep as its grid says, a pushed
crate moves, an AUV flies its line, a hundred vehicles come and go."""

from __future__ import annotations

import itertools
import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import uwserver
from uwserver.adapter import installed_adapters
from uwserver.environment.earth import north_east
from uwserver.frames import matrix
from uwserver.physics.geometry.shapes import Box
from uwserver.ports import Port
from uwserver.scenario.load.scenario import load
from uwserver.units import rad
from uwserver.world import World

G = 9.81
SOLID = ("pool_inspection", "subsea_template", "slope", "push_the_crate", "remus_survey", "swarm_100")
AHEAD = (-1.0, -1.0, 1.0, 1.0)
ASIDE = (1.0, -1.0, 1.0, -1.0)
"""Signs of the horizontal thrusters of a BlueROV2 that drive it ahead, and to starboard."""


def state_of(world: World, name: str) -> np.ndarray:
    return world.hydro.state[world.vehicles[name].row]


def corners(world: World, name: str) -> np.ndarray:
    """Corners (n, 3) in N of the boxes that a body is made of."""
    solid, row = world.members[name].solid, state_of(world, name)
    assert solid is not None
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    placed = [(s.shape, s.p, s.R) for s in solid.shapes]
    assert all(isinstance(shape, Box) for shape, _, _ in placed)
    local = np.concatenate([(signs * shape.half) @ R.T + p for shape, p, R in placed])
    return local @ np.array(matrix(row[3:7])).T + row[:3]


def forces_on(world: World, name: str) -> np.ndarray:
    """Mean contact force (3) of the last tick on a body, N, from everything it touches."""
    row, touched = world.vehicles[name].row, world.hydro.touched
    sign = 1.0 * (touched.contacts.body_a == row) - 1.0 * (touched.contacts.body_b == row)
    return (sign[:, None] * touched.impulse).sum(axis=0) / world.hydro.dt


def level(world: World, name: str) -> list[float]:
    """The four vertical thrusters of a BlueROV2 Heavy, which keep it level: surge alone would pitch it over."""
    roll, pitch, _ = world.vehicles[name].pose.rpy
    p, q = world.vehicles[name].nu[3:5]
    across, along = 0.5 * roll + 0.2 * p, 0.5 * pitch + 0.2 * q
    return [float(np.clip(a * along - b * across, -0.4, 0.4)) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]


def drawn(port: Port, rng: np.random.Generator) -> dict[str, object]:
    """A random command within the limits of a port."""
    return {
        f.name: rng.uniform(
            -1e5 if f.minimum is None else f.minimum, 1e5 if f.maximum is None else f.maximum, f.shape or None
        )
        for f in port.fields
    }


@pytest.mark.parametrize("name", SOLID)
def test_it_loads_without_warnings(name: str) -> None:
    """But that of RexROV, whose published added mass is not symmetric."""
    assert all("M_A is not symmetric" in problem.text for problem in load(name, adapters=installed_adapters()).warnings)


@pytest.mark.parametrize("name", SOLID)
def test_nothing_diverges(name: str) -> None:
    """With random commands at the limits once a second."""
    live(name, 1 if name == "swarm_100" else 8, True)


@pytest.mark.slow
@pytest.mark.parametrize("commanded", [False, True])
@pytest.mark.parametrize("name", SOLID)
def test_nothing_diverges_for_long(name: str, commanded: bool) -> None:
    """With nobody there too."""
    live(name, 5 if name == "swarm_100" else 60, commanded)


def live(name: str, seconds: int, commanded: bool) -> None:
    world, rng = uwserver.load(name).core, np.random.default_rng(7)
    for _ in range(seconds):
        for path, port in world.ports.items() if commanded else ():
            if port.direction == "actuator":
                world.command(path, **{k: np.asarray(v).tolist() for k, v in drawn(port, rng).items()})
        world.step(240)
    assert np.isfinite(world.hydro.state).all()
    floor = world.scene.raycast(np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.0, 1.0]]), 1e3).distance[0] + 20.0  # type: ignore[union-attr]
    for each in world.vehicles.values():
        assert np.linalg.norm(each.nu[:3]) < 6.0
        assert -3.0 < each.p_NB[2] < floor


# -- pool_inspection ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "wall", "u"), [(0, 5.0, AHEAD), (1, 3.0, ASIDE)])
def test_a_wall_of_the_pool_stops_the_vehicle(axis: int, wall: float, u: tuple[float, ...]) -> None:
    """To the north and to the east: its foremost corner gets as far as the wall and no further."""
    world = uwserver.load("pool_inspection").core
    fastest = 0.0
    for _ in range(720):
        world.command("bluerov2/thrusters", u=[*(0.35 * sign for sign in u), *level(world, "bluerov2")])
        world.step(12)
        fastest = max(fastest, state_of(world, "bluerov2")[7 + axis])
        assert corners(world, "bluerov2")[:, axis].max() < wall + 2e-3
    assert fastest > 0.2
    assert corners(world, "bluerov2")[:, axis].max() > wall - 2e-3
    assert forces_on(world, "bluerov2")[axis] < -5.0


def test_on_the_floor_of_the_pool_it_rests_with_its_weight() -> None:
    """Nobody commands: the vehicle is 1 N heavier than fresh water. It sinks, and lies still."""
    world = uwserver.load("pool_inspection").core
    world.call("world/let_go")
    state_of(world, "bluerov2")[2] = 2.3
    assert corners(world, "bluerov2")[:, 2].max() < 2.8
    world.step(240 * 30)
    low = corners(world, "bluerov2")[:, 2].max()
    assert abs(low - 3.0) < 1e-3
    assert np.abs(state_of(world, "bluerov2")[7:]).max() < 1e-5
    weight = (13.5 - 0.0134 * 1000.0) * 9.82
    np.testing.assert_allclose(forces_on(world, "bluerov2"), [0.0, 0.0, -weight], atol=1e-3 * weight)


# -- subsea_template ----------------------------------------------------------------------------------------------------------------------


def test_the_template_stops_a_vehicle_that_is_driven_into_it() -> None:
    """RexROV ahead at the height of the south beam (radius 0.25 m, axis at 5 m south and 113 m deep)."""
    world = uwserver.load("subsea_template").core
    touched = 0.0
    for _ in range(60):
        p, q = state_of(world, "rexrov")[:3], state_of(world, "rexrov")[3:7]
        nu = state_of(world, "rexrov")[7:]
        yaw = math.atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] ** 2 + q[3] ** 2))
        force = [1500.0, -2000.0 * (p[1] - 1.0) - 1500.0 * nu[1], 1500.0 * (113.6 - p[2]) - 3000.0 * nu[2]]
        world.command("rexrov/wrench", force_B=force, torque_B=[0.0, 0.0, -2000.0 * yaw - 2000.0 * nu[5]])
        world.step(120)
        touched = min(touched, forces_on(world, "rexrov")[0])
        # A corner may pass above or below the middle of the beam, but not through it.
        assert world.hydro.touched.contacts.gap.min(initial=0.0) > -0.01
        assert corners(world, "rexrov")[:, 0].max() < -4.75
    assert touched < -500.0


def test_rays_see_the_template() -> None:
    world = uwserver.load("subsea_template").core
    materials = load("subsea_template", adapters=installed_adapters()).materials
    origin = np.array(
        [[-12.0, 0.3, 117.3], [-12.0, 0.0, 113.0], [3.2, 3.2, 100.0], [-40.0, 30.0, 100.0], [0.0, 0.0, 50.0]]
    )
    direction = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 0, 1.0], [0, 0, 1.0], [0, 0, -1.0]])
    assert world.scene is not None
    hits = world.scene.raycast(origin, direction, 100.0)
    # valve panel at 1.58 m south, south beam, tree (top at 115.8 m), seabed, nothing
    np.testing.assert_allclose(hits.distance[[0, 2, 3]], [10.42, 15.8, 20.0], atol=1e-6)
    assert hits.distance[1] == pytest.approx(6.75, abs=1e-3)  # a cylinder of 64 sides
    assert hits.distance[4] == np.inf
    assert [materials[m] for m in hits.material[:4]] == ["panel", "steel", "paint", "clay"]


# -- slope --------------------------------------------------------------------------------------------------------------------------------


def test_the_slope_is_as_deep_as_its_grid() -> None:
    world = uwserver.load("slope").core
    depth = np.load(Path(str(resources.files("uwserver_scenarios"))) / "assets" / "slope.npy")
    rows, columns = np.random.default_rng(1).integers(1, 80, (2, 200))
    origin = np.stack([(rows - 40) * 5.0, (columns - 40) * 5.0, np.ones(200)], axis=1)
    assert world.scene is not None
    hits = world.scene.raycast(origin, np.tile([0.0, 0.0, 1.0], (200, 1)), 100.0)
    np.testing.assert_allclose(hits.distance + 1.0, depth[rows, columns], atol=1e-6)
    under = world.scene.raycast(np.array([world.vehicles["rov"].p_NB]), np.array([[0.0, 0.0, 1.0]]), 100.0)
    assert under.distance[0] == pytest.approx(2.0, abs=1e-6)
    assert under.normal[0] == pytest.approx(np.array([0.3, 0.0, -1.0]) / math.hypot(1.0, 0.3), abs=1e-6)


def test_the_slope_has_its_place_on_earth(tmp_path: Path) -> None:
    """The same depths in latitude and longitude about the scenario's datum give the same seabed."""
    import h5netcdf.legacyapi

    home = Path(str(resources.files("uwserver_scenarios")))
    datum = load("slope", adapters=installed_adapters()).scenario.world
    lat0, lon0 = float(datum.origin_lat_deg), float(datum.origin_lon_deg)  # type: ignore[arg-type]
    assert (lat0, lon0) == (63.46, 10.38)
    latitude, longitude = lat0 + np.linspace(-4e-4, 4e-4, 41), lon0 + np.linspace(-8e-4, 8e-4, 41)
    north, _ = north_east(*np.radians(np.meshgrid(latitude, longitude, indexing="ij")), rad(lat0), rad(lon0))
    with h5netcdf.legacyapi.Dataset(tmp_path / "slope.nc", "w") as file:
        for name, values in (("lat", latitude), ("lon", longitude)):
            file.createDimension(name, 41)
            file.createVariable(name, "f8", (name,))[:] = values
        file.createVariable("elevation", "f8", ("lat", "lon"))[:] = -(40.0 + 0.3 * north)
    text = (home / "slope.toml").read_text()
    text = text.replace('"assets/slope.npy"', '"slope.nc"').replace("spacing_m = [5.0, 5.0]\nfriction", "friction")
    (tmp_path / "slope.toml").write_text(text.replace("port = 7600", "port = 0"))
    down = np.tile([0.0, 0.0, 1.0], (3, 1))
    origin = np.array([[-30.0, 10.0, 0.0], [0.0, 0.0, 0.0], [25.0, -20.0, 0.0]])
    worlds = uwserver.load(tmp_path / "slope.toml").core, uwserver.load("slope").core
    npy, nc = (world.scene.raycast(origin, down, 100.0).distance for world in worlds)  # type: ignore[union-attr]
    np.testing.assert_allclose(npy, nc, atol=1e-3)


def test_on_the_slope_friction_holds_the_lander_and_not_the_sled() -> None:
    """tan of the slope is 0.3: the lander's friction is sqrt(0.5 0.6) = 0.55, the sled's sqrt(0.5 0.02) = 0.1, so it gathers speed until its
    drag takes the rest: D v + Q v^2 = W (sin - 0.1 cos)."""
    world = uwserver.load("slope").core
    params = world.hydro.params[world.vehicles["sled"].row]
    world.step(240)
    lander = state_of(world, "lander")[:3].copy()
    speeds = []
    for _ in range(40):
        world.step(60)
        speeds.append(np.linalg.norm(state_of(world, "sled")[7:10]))
    np.testing.assert_allclose(state_of(world, "lander")[:3], lander, atol=1e-5)
    slope = math.atan(0.3)
    pull = (params.weight - params.buoyancy) * (math.sin(slope) - 0.1 * math.cos(slope))
    D, Q = params.D_L[0, 0], params.D_Q[0, 0]
    terminal = (-D + math.sqrt(D * D + 4.0 * Q * pull)) / (2.0 * Q)
    assert max(speeds) == pytest.approx(terminal, rel=0.01)
    assert state_of(world, "sled")[2] == pytest.approx(
        40.0 + 0.3 * state_of(world, "sled")[0] - 0.2 / math.cos(slope), abs=2e-3
    )


# -- push_the_crate -----------------------------------------------------------------------------------------------------------------------


def test_the_crate_moves_with_the_rov_and_stays_where_it_is_left() -> None:
    world = uwserver.load("push_the_crate").core
    start = state_of(world, "crate")[:3].copy()
    on_crate, from_ground, speeds = [], [], []
    rov, crate = (world.vehicles[name].row for name in ("rov", "crate"))
    for k in range(200):
        world.command("rov/thrusters", u=[*(0.4 * a for a in AHEAD), 0.3, 0.3, 0.3, 0.3])
        world.step(12)
        assert abs(corners(world, "crate")[:, 2].max() - 10.0) < 5e-3
        if k >= 160:
            touched = world.hydro.touched
            ground = (touched.contacts.body_a == crate) & (touched.contacts.body_b == -1)
            assert np.isin(rov, touched.contacts.body_a) or np.isin(rov, touched.contacts.body_b)
            speeds.append(state_of(world, "crate")[7])
            on_crate.append(forces_on(world, "crate"))
            from_ground.append(touched.impulse[ground].sum(axis=0) / world.hydro.dt)
    assert state_of(world, "crate")[0] - start[0] > 0.8
    assert corners(world, "rov")[:, 0].max() == pytest.approx(corners(world, "crate")[:, 0].min(), abs=0.02)
    # What touches the crate carries its weight, its drag and what still gathers speed; the ground alone rubs by Coulomb's law.
    params, v = world.hydro.params[crate], np.array(speeds)
    drag = float((params.D_L[0, 0] * v + params.D_Q[0, 0] * v * v).mean())
    drag += (params.M_RB + params.M_A)[0, 0] * (v[-1] - v[0]) / (39 * 12 / 240)
    weight = params.weight - params.buoyancy
    np.testing.assert_allclose(np.mean(on_crate, axis=0), [drag, 0.0, -weight], atol=0.02 * weight)
    ground_force = np.mean(from_ground, axis=0)
    assert math.hypot(*ground_force[:2]) == pytest.approx(-0.4 * ground_force[2], rel=1e-3)
    reached = state_of(world, "crate")[0]
    for _ in range(200):
        world.command("rov/thrusters", u=[*(-0.4 * a for a in AHEAD), 0.3, 0.3, 0.3, 0.3])
        world.step(12)
    left = state_of(world, "crate")[:3].copy()
    slid = left[0] - reached
    assert 0.0 < slid < 0.5 * speeds[-1] ** 2 * (params.M_RB + params.M_A)[0, 0] / (0.4 * weight)
    world.step(480)
    np.testing.assert_allclose(state_of(world, "crate")[:3], left, atol=1e-6)
    assert state_of(world, "rov")[0] < left[0] - 1.0


# -- remus_survey -------------------------------------------------------------------------------------------------------------------------


def test_the_remus_flies_a_line_and_turns_to_the_next() -> None:
    """Depth by the stern planes, heading by the rudder, both from what the vehicle's own sensors say."""
    world = uwserver.load("remus_survey").core
    wanted, turned_at, depths, tracks = 90.0, None, [], []
    for k in range(1200):
        world.step(24)
        q, depth = (world.read(f"auv/{name}") for name in ("navigation", "depth"))
        if q is None or depth is None:
            continue
        w, x, y, z = q.value[1]
        yaw, pitch = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), math.asin(2 * (w * y - z * x))
        if k == 600:
            wanted, turned_at = 270.0, world.vehicles["auv"].p_NB
        error = math.remainder(yaw - math.radians(wanted), math.tau)
        dive = float(np.clip(0.1 * (15.0 - depth.value[0]), -0.3, 0.3))
        world.command("auv/propeller", speed_radps=150.0)
        world.command("auv/rudder", angle_rad=float(np.clip(-0.6 * error, -0.26, 0.26)))
        world.command("auv/stern_planes", angle_rad=float(np.clip(1.0 * (dive + pitch), -0.26, 0.26)))
        depths.append(world.vehicles["auv"].p_NB[2])
        tracks.append(error)
    assert turned_at is not None
    assert np.abs(np.array(depths[200:]) - 15.0).max() < 1.5
    assert np.abs(tracks[400:590]).max() < 0.1
    assert np.abs(tracks[-200:]).max() < 0.1
    assert turned_at[1] - (-80.0) > 60.0
    assert world.vehicles["auv"].p_NB[1] < turned_at[1] - 40.0


# -- swarm_100 ----------------------------------------------------------------------------------------------------------------------------


def test_a_hundred_vehicles_come_and_go() -> None:
    world = uwserver.load("swarm_100").core
    assert len(world.vehicles) == 100
    assert len({vehicle.model for vehicle in world.vehicles.values()}) == 6
    places = np.array([vehicle.p_NB for vehicle in world.vehicles.values()])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(100)
    assert apart.min() >= 4.0
    for name in world.vehicles:
        assert {f"{name}/imu", f"{name}/depth"} <= set(world.ports)
    world.command("rov_7/thrusters", u=[0.0] * 4 + [0.5] * 4)
    spoken = {sample.port.split("/")[0] for sample in world.step(24)}
    assert spoken == set(world.vehicles)
    world.call("world/remove", name="rov_3")
    world.call("world/spawn", name="late", like="scout_4", p_NB=[-20.0, 0.0, 5.0])
    world.step(24)
    assert len(world.vehicles) == 100
    assert "late/imu" in world.ports
    assert "rov_3/imu" not in world.ports
    assert state_of(world, "rov_7")[9] > state_of(world, "rov_8")[9] + 0.05

"""What a world looks like, as a whole: every shipped scenario can be described, and says what it holds."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

import uwserver
from uwserver.adapter import installed_adapters
from uwserver.environment.acoustics.boundaries import LAMBERT_DB
from uwserver.environment.light import WATER_TYPES
from uwserver.ports import SceneView
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.scenery import Scenery
from uwserver.scenario.solids.appearance import COATS, MATERIALS
from uwserver.world.state.scene_probe import SceneProbe

SHIPPED = sorted(path.stem for path in (Path(__file__).parents[4] / "scenarios" / "uwserver_scenarios").glob("*.toml"))


@cache
def loaded(name: str) -> Resolved:
    return load(name, adapters=installed_adapters())


@cache
def described(name: str) -> tuple[Scenery, SceneView, Any]:
    world = build(loaded(name))
    scenery, state = Scenery(loaded(name), world), SceneProbe(world).state()
    return scenery, scenery.scene(state.entities), SimpleNamespace(state=state, world=world)


def test_a_scene_names_all_that_is_there() -> None:
    scenery, scene, there = described("pool_inspection")
    resolved = loaded("pool_inspection")
    assert [vehicle.name for vehicle in scene.vehicles] == list(there.world.vehicles)
    assert {solid.name for solid in scene.structures} == set(resolved.static) - {"seabed"}
    assert (scene.seabed is None) == ("seabed" not in resolved.static)
    for solid in (*scene.structures, *scene.vehicles, *scene.objects):
        for shape in solid.shapes:
            assert shape.mesh is None or (shape.mesh in scene.meshes and shape.mesh in scenery.meshes.data)
    assert msgspec.json.decode(msgspec.json.encode(scene), type=SceneView) == scene


def test_shapes_of_a_vehicle_have_the_names_of_its_file() -> None:
    _, scene, _ = described("pool_inspection")
    assert [shape.name for shape in scene.vehicles[0].shapes] == ["frame", "starboard_thrusters", "port_thrusters"]


@pytest.mark.parametrize("name", SHIPPED)
def test_sensors_and_actuators_are_told_by_their_ports(name: str) -> None:
    resolved = loaded(name)
    from uwserver.scenario.scene.fittings import actuator_views, sensor_views
    from uwserver.scenario.vehicle.body import body_params

    for vehicle in list(resolved.vehicles.values())[:8]:
        params = body_params(vehicle.vehicle, vehicle.devices, resolved.scenario.environment)
        views = actuator_views(vehicle.name, vehicle, params)
        kinds = [*(t.name for t in params.thrusters), *(s.name.partition(".")[2] for s in params.appendages.servos)]
        assert [view.name for view in views] == kinds, "in the order of the states"
        for view in views:
            assert view.low < view.high
            if view.port is not None:
                assert view.port.removeprefix(f"{vehicle.name}/") in vehicle.vehicle.actuators
        sensors = {view.path.removeprefix(f"{vehicle.name}/") for view in sensor_views(vehicle.name, vehicle.vehicle)}
        assert sensors == {config.port_of("", key)[1:] for key, config in vehicle.vehicle.sensors.items()}


def test_the_waves_are_those_of_the_physics() -> None:
    begun = ScenarioBuilder("sea").vehicle("rov", "bluerov2").environment(surface_level_m=0.7)
    begun.waves(significant_height_m=1.0, peak_period_s=6.0, spreading=4.0, components=30, depth_m=15.0)
    resolved = load(begun.build(), adapters={})
    world = build(resolved)
    scene, water = Scenery(resolved, world).scene(SceneProbe(world).state().entities), world.water
    assert len(scene.water.waves) == 30, "the tide is no wave"
    for x, y, t in ((0.0, 0.0, 0.0), (12.0, -7.0, 3.5), (-80.0, 40.0, 61.0)):
        summed = scene.water.surface_level + sum(
            w.amplitude * math.cos(w.kx * x + w.ky * y - w.omega * t + w.phase) for w in scene.water.waves
        )
        assert summed == pytest.approx(water.elevation(x, y, t), abs=1e-9)


def test_nothing_is_worked_out_before_somebody_asks() -> None:
    world = uwserver.load("slope").core
    scenery = Scenery(loaded("slope"), world)
    assert scenery.meshes.data == {}
    scene = scenery.scene(SceneProbe(world).state().entities)
    assert scene.seabed is not None
    assert scenery.scene(SceneProbe(world).state().entities) is not None
    assert {shape.kind for shape in scene.seabed.shapes} <= {"mesh", "plane"}


def test_what_was_spawned_is_described_under_its_own_name() -> None:
    world = uwserver.load("pool_inspection").core
    scenery, scene_probe = Scenery(loaded("pool_inspection"), world), SceneProbe(world)
    first = scenery.scene(scene_probe.state().entities)
    like = first.vehicles[0].name
    world.call("world/spawn", name="second", like=like, p_NB=[0.0, 0.0, 1.0])
    again = scenery.scene(scene_probe.state().entities)
    spawned = next(vehicle for vehicle in again.vehicles if vehicle.name == "second")
    assert again.revision == first.revision + 1
    assert spawned.like == like
    assert all(sensor.path.startswith("second/") for sensor in spawned.sensors)
    assert all(view.port is None or view.port.startswith("second/") for view in spawned.actuators)


def test_every_material_that_sonars_know_has_a_colour() -> None:
    assert set(MATERIALS) == set(LAMBERT_DB)
    assert all(0.0 <= c <= 1.0 for colour in MATERIALS.values() for c in colour)


def test_the_water_is_of_the_type_that_the_scenario_names() -> None:
    clear, murky = (
        load(ScenarioBuilder("sea").vehicle("rov", "bluerov2").environment(**keys).build(), adapters={})
        for keys in ({}, {"water_type": "7C"})
    )
    views = []
    for resolved in (clear, murky):
        world = build(resolved)
        views.append(Scenery(resolved, world).scene(SceneProbe(world).state().entities).water)
    assert [view.jerlov for view in views] == ["II", "7C"]
    assert views[1].attenuation == WATER_TYPES["7C"].attenuation > views[0].attenuation
    assert views[0].colour != views[1].colour


def test_lamps_are_where_their_mounts_are() -> None:
    world = uwserver.load("bluerov2_pool").core
    scene = Scenery(loaded("bluerov2_pool"), world).scene(SceneProbe(world).state().entities)
    lamps = scene.vehicles[0].lamps
    assert [lamp.name for lamp in lamps] == ["left", "right"]
    assert lamps[0].p == (0.2, -0.13, 0.06)
    assert lamps[0].cone == pytest.approx(math.radians(135.0))
    half = math.radians(-5.0)
    assert lamps[0].q == pytest.approx((math.cos(half), 0.0, math.sin(half), 0.0))


def test_a_lamp_on_a_mount_that_is_not_there_is_told() -> None:
    lamp = {"mount": "lamp_lef", "lumens": 100.0, "source": "test", "status": "guess"}
    begun = ScenarioBuilder("sea").vehicle("rov", "bluerov2", override={"lamps": {"third": lamp}})
    with pytest.raises(ScenarioError, match=r'no mount "lamp_lef".*lamp_left'):
        load(begun.build(), adapters={})


PAINTS = Path(__file__).parents[4] / "clients/web/scene/materials.js"


@pytest.mark.parametrize("material", [*MATERIALS, *COATS])
def test_the_page_paints_a_material_about_as_cameras_see_it(material: str) -> None:
    """Patterns make sand and rock a little lighter or darker there."""
    found = re.search(rf'^  {material}: {{ colour: "#(\w\w)(\w\w)(\w\w)"', PAINTS.read_text(), re.M)
    assert found is not None
    parts = [int(part, 16) / 255 for part in found.groups()]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    assert linear == pytest.approx({**MATERIALS, **COATS}[material], abs=0.2)

"""What is measured is what the report says: vehicles on their missions, sensors that read, a sample that arrives, and how the figures are made."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from uwserver_bench.report import Row
from uwserver_bench.swarm import swarm, swarm_client, swarm_world
from uwserver_bench.swarm.swarm_client import PORTS
from uwserver_bench.swarm.swarm_scenario import LEG_M, RATE_HZ, SPACING_M, mission, names, place

from uwserver.copies.batch import Batch
from uwserver.ports.sample_batch import SampleBatch
from uwserver.simulation.clock import SystemTime, processor_ns
from uwserver.world.world import World

EFFORT = {"seconds": 0.001, "repeats": 2}


def test_every_vehicle_flies_its_mission_and_nobody_comes_near_another() -> None:
    world = swarm_world.loaded("navigation", 12, True)
    swarm_world.ticks(world, swarm_world.SETTLE_TICKS)
    swarm_world.set_out(world, 12)
    swarm_world.ticks(world, 10 * RATE_HZ)
    for k, name in enumerate(names(12)):
        state = world.read(f"{name}/autopilot/state")
        assert (state.mode, state.armed, state.mission_count) == ("mission", True, len(mission(k)))
        north, east, depth = world.vehicles[name].p_NB
        assert 2.0 < north - place(k)[0] < 5.0
        assert abs(east - place(k)[1]) < 1.0
        assert 4.5 < depth < 8.5
        assert all(f"{name}/{port}" in world.ports for port in PORTS)
        assert world.read(f"{name}/dvl").valid


def test_legs_of_different_vehicles_never_meet() -> None:
    assert all(abs(a - b) >= SPACING_M for a, b in [(place(k)[0], place(k + 10)[0]) for k in range(30)])
    first, *_, last = [item["position_ned_m"] for item in mission(13) if item["kind"] == "waypoint"]
    assert first[:2] == [place(13)[0] + LEG_M, place(13)[1]]
    assert last[1] == place(13)[1]


def test_nobody_is_behind_the_last_which_holds_its_place() -> None:
    for vehicles in (1, 10, 12, 100):
        north, east = place(vehicles - 1)
        assert not [k for k in range(vehicles) if place(k)[1] == east and place(k)[0] < north]


def test_of_the_simple_ones_imu_and_depth_read_and_nothing_else() -> None:
    world = swarm_world.loaded("simple", 3, True)
    world.step(48)
    assert {path.partition("/")[2] for path in world.sensors} == {"imu", "depth"}
    assert all(world.read(path) is not None for path in world.sensors)


@pytest.mark.parametrize("kind", ["navigation", "simple"])
def test_a_fleet_is_loaded_sent_out_and_stepped(kind: str) -> None:
    found = swarm_world.fly({"kind": kind, "vehicles": 2, "one_core": True, **EFFORT})
    assert found["load_s"] > 0.0
    assert len(found["of_processor_time"]) == len(found["of_wall_time"]) == 2
    assert min(found["of_processor_time"]) > 0.0


def test_samples_of_many_vehicles_arrive_and_noise_costs_something(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds: list[World] = []
    load = swarm_world.loaded

    def loaded(*args: Any) -> World:
        worlds.append(load(*args))
        return worlds[0]

    monkeypatch.setattr(swarm_world, "loaded", loaded)
    found = swarm_world.read({"vehicles": 4, "seconds": 0.02, "repeats": 3})
    assert min(found["sample_us"]) > 0.0
    assert max(found["noise_us"]) > 0.0, "a difference, which a busy machine may turn round now and then"
    world = worlds[0]
    numbers = world.sensor_arrays.heads.rows["number"]
    counts = [numbers[world.sensors[f"r0000/{name}"].head] for name in ("inertial", "exact", "noisy")]
    assert min(counts) > 100
    assert len(world.sensor_arrays._pending) < 100, "what piles up makes each sample dearer"


@pytest.mark.parametrize("sensors", [(), ("imu", "depth", "dvl", "ahrs")])
def test_copies_are_loaded_commanded_and_stepped(sensors: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    batches: list[Batch] = []
    make = swarm_world.copied

    def copied(*args: Any) -> Batch:
        batches.append(make(*args))
        return batches[-1]

    monkeypatch.setattr(swarm_world, "copied", copied)
    found = swarm_world.copy({"copies": 3, "sensors": sensors, "kind": "over a bottom", **EFFORT})
    assert found["load_s"] > 0.0
    assert len(found["steps_per_s"]) == 2
    assert min(found["steps_per_s"]) > 0.0
    batch = batches[-1]
    assert set(batch.ports) == {f"r0000/{name}" for name in sensors}
    assert batch.ticks.min() >= 3 * 24
    assert np.ptp(batch.states()[:, :3], axis=0).max() > 0.01, "each has commands of its own"


def test_the_bars_of_copies_are_in_vehicle_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def world(task: str, **arguments: Any) -> dict[str, Any]:
        asked.append((arguments["kind"], arguments["copies"], arguments["sensors"]))
        return {"steps_per_s": [1.1e6 if not arguments["sensors"] else 2.9e5], "load_s": 6.5}

    monkeypatch.setattr(swarm, "_world", world)
    rows = swarm._copies(1024, EFFORT, lambda line: None)
    navigation = ("imu", "depth", "dvl", "ahrs")
    assert asked == [("copied", 1024, ()), ("copied", 1024, navigation), ("over a bottom", 1024, navigation)]
    assert [(row.value, row.verdict) for row in rows] == [(1.1e6, "ok"), (2.9e5, "miss"), (1.0, "ok"), (6.5, "info")]


@pytest.mark.parametrize("kind", ["navigation", "bluerov2_qgc"])
def test_samples_that_nobody_looks_at_are_not_made(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in a program nor in a server without clients."""
    made: list[str] = []
    monkeypatch.setattr(SampleBatch, "__iter__", lambda batch: made.append("sample") or iter(()))
    assert len(swarm_world.unread({"kind": kind, "vehicles": 2, **EFFORT})["ratio"]) == 2  # type: ignore[arg-type]
    assert not made


def test_what_is_unread_has_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swarm, "_world", lambda task, kind, vehicles, **_: {"ratio": [0.95 if vehicles < 100 else 0.5]})
    rows = swarm._unread((1, 100), EFFORT, lambda line: None)
    assert [row.verdict for row in rows] == ["ok", "miss"] * 2


def fake(found: dict[tuple[str, int], dict[str, Any]]) -> Any:
    return lambda task, **arguments: found[arguments.get("kind", task), arguments["vehicles"]]


def by_name(rows: list[Row]) -> dict[str, Row]:
    return {row.name: row for row in rows}


def test_the_exponent_tells_how_cost_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = {
        ("simple", n): {"of_processor_time": [2.0 * r, r, r / 2], "of_wall_time": [r], "resident_mb": 100.0 + 2.0 * n**1.3, "load_s": 6.0}
        for n, r in ((10, 1000.0), (500, 30.0), (1000, 1.0), (2000, 0.5))
    }  # fmt: skip
    monkeypatch.setattr(swarm, "_world", fake(worlds))
    monkeypatch.setattr(swarm, "has_threads", lambda: False)
    rows = by_name(swarm._growth((10, 500, 1000), EFFORT, lambda line: None))
    assert rows["exponent of cost from 10 to 1000 vehicles"].value == pytest.approx(1.5)
    assert rows["exponent of cost from 10 to 1000 vehicles"].verdict == "miss"
    assert rows["1000 vehicles with IMU and depth, wall time"].verdict == "ok"
    assert rows["exponent of memory from 500 to 2000 vehicles"].value == pytest.approx(1.3), (
        "what is there without any does not count"
    )
    assert rows["1000 vehicles with IMU and depth: memory"].verdict == "miss"
    quick = by_name(swarm._growth((10, 500), EFFORT, lambda line: None))
    assert list(quick) == ["exponent of cost from 10 to 500 vehicles"]


def test_memory_of_a_vehicle_is_what_ninety_more_take(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = {
        ("navigation", n): {"of_processor_time": [9.0], "of_wall_time": [8.0], "resident_mb": 200.0 + 0.1 * n}
        for n in (1, 10, 100)
    }
    monkeypatch.setattr(swarm, "_world", fake(worlds))
    monkeypatch.setattr(swarm, "has_threads", lambda: True)
    rows = by_name(swarm._fleets(EFFORT, lambda line: None))
    assert rows["memory of a vehicle with sensors and autopilot"].value == pytest.approx(100.0)
    assert rows["100 vehicles, sensors and autopilot, one core"].value == 9.0
    assert rows["100 vehicles, sensors and autopilot, all cores, wall time"].value == 8.0
    worlds["navigation", 100]["resident_mb"] = None
    row = by_name(swarm._fleets(EFFORT, lambda line: None))["memory of a vehicle with sensors and autopilot"]
    assert (row.verdict, row.note) == ("absent", swarm.UNKNOWN)


def test_what_a_client_leaves_stands_beside_what_any_other_work_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    doing = ["nothing"]

    class Client:
        def do(self, task: str, served: Any, vehicles: int) -> None:
            assert (task, vehicles) == ("set_out", 10)

        def begin(self, task: str, **arguments: Any) -> None:
            doing.append(task)

        def result(self) -> dict[str, Any]:
            return {"samples_per_s": 340.0} if doing.pop() == "follow" else {}

    served = SimpleNamespace(pid=1, host="", port=0)
    rates = {"nothing": 100.0, "follow": 60.0, "compute": 80.0}
    monkeypatch.setattr(swarm, "loading", lambda module: contextlib.nullcontext(Client()))
    monkeypatch.setattr(swarm, "serving", lambda file, options: contextlib.nullcontext(served))
    monkeypatch.setattr(swarm, "_rate", lambda served, seconds: rates[doing[-1]])
    monkeypatch.setattr(swarm, "Bystanders", lambda pid: SimpleNamespace(cores=lambda: 0.0))
    monkeypatch.setattr(swarm.SystemTime, "wait", lambda *_: None)
    rows = by_name(swarm._with_a_client((10,), 2, 1.0, lambda line: None))
    left = rows["server of 10 vehicles: what the client leaves of the rate"]
    others = rows["server of 10 vehicles: what a process that only computes leaves of it"]
    assert (left.values, left.verdict) == ((0.6, 0.6), "miss")
    assert (others.values, others.verdict) == ((0.8, 0.8), "info")


def test_who_only_computes_does_so_for_as_long_as_asked() -> None:
    begin, wall = processor_ns(), SystemTime().now_ns()
    assert swarm_client.compute({"seconds": 0.05}) == {}
    assert SystemTime().now_ns() - wall >= 50_000_000
    assert processor_ns() > begin


@pytest.mark.parametrize("one_core", [True, False])
def test_bare_vehicles_are_stepped_by_a_world_with_the_threads_it_chooses(
    one_core: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []

    class Watched(swarm_world.OpenWater):
        def __init__(self, vehicles: int, **given: Any) -> None:
            made.append((vehicles, given["threads"]))
            super().__init__(vehicles, **given)

    monkeypatch.setattr(swarm_world, "OpenWater", Watched)
    found = swarm_world.thrust({"vehicles": 2, "one_core": one_core, "seconds": 0.001, "repeats": 2})
    assert made == [(2, 1 if one_core else "auto")]
    assert found["threads"] == 1, "two vehicles are too few for another thread"
    assert len(found["of_wall_time"]) == len(found["of_processor_time"]) == 2  # type: ignore[arg-type]


def test_bare_vehicles_have_a_row_for_one_core_and_one_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def world(task: str, **arguments: Any) -> dict[str, Any]:
        one = arguments["one_core"]
        return {"threads": 1, "of_processor_time": [30.0 if one else 24.0], "of_wall_time": [29.0 if one else 46.0]}

    monkeypatch.setattr(swarm, "_world", world)
    one, all_cores = swarm._alone(EFFORT, lambda line: None)
    assert (one.value, one.verdict, all_cores.value, all_cores.verdict) == (30.0, "info", 46.0, "ok")
    assert "one thread" in all_cores.note

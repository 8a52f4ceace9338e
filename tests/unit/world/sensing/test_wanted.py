"""Samples on demand: whoever reads, and whether anybody does, what is measured and delivered is the same bit by bit."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

import pytest

from uwserver.adapter import installed_adapters
from uwserver.modifiers import Delay, Dropout, GaussMarkov, WhiteNoise
from uwserver.ports import Sample
from uwserver.ports.decimation import Decimation
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import CompoundConfig, ImuConfig, PressureConfig
from uwserver.sensors.base import StreamTable
from uwserver.world import World
from uwserver.world.sensing import sensor_arrays
from uwserver.world.state import snapshot

TICKS = 240


def small() -> Resolved:
    """Noise, drift, delay, jitter and loss; a stream without errors; and one that repeats the others."""
    link = {
        "noise": WhiteNoise(field="f_S", sigma=0.1),
        "drift": GaussMarkov(field="w_S", sigma=0.1, tau_s=1.0),
        "link": Delay(latency_s=0.03, jitter_s=0.02),
        "loss": Dropout(probability=0.3),
    }
    sensors = {
        "far": ImuConfig(rate_hz=60.0, modifiers=link, streams={"raw": StreamTable(ideal=True)}),
        "near": PressureConfig(rate_hz=120.0, modifiers={"link": Delay(latency_s=0.004, jitter_s=0.004)}),
        "both": CompoundConfig(rate_hz=30.0, members=("far", "near")),
    }
    entry = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 10.0), sensors=sensors)
    return load(Scenario(schema=1, seed=7, world=WorldTable(rate_hz=240.0), vehicles={"rov": entry}), adapters={})


@cache
def resolved(name: str) -> Resolved:
    return small() if name == "small" else load(name, adapters=installed_adapters())


def world_of(name: str) -> World:
    return build(resolved(name))


@cache
def whole(name: str) -> tuple[list[list[Sample]], str]:
    """All samples by tick where everybody reads everything, and the state at the end."""
    world = world_of(name)
    return [world.step() for _ in range(TICKS)], snapshot.take(world).hash()


def some(samples: list[Sample], ports: Collection[str]) -> list[Sample]:
    return [sample for sample in samples if sample.port in ports]


def heard(world: World) -> set[str]:
    """Ports that parts of the world hear, as an autopilot that of a beacon: their samples are always made."""
    return {port for part in world.parts.values() for port in part.listens_to}


NAMES = ("small", "one_of_everything")


@pytest.mark.parametrize("name", NAMES)
def test_all_of_it_is_worth_comparing(name: str) -> None:
    """Some are lost, some come late and out of order, and some ports have values that are no numbers."""
    everything = [sample for samples in whole(name)[0] for sample in samples]
    ports = {sample.port for sample in everything}
    assert len(everything) > 300
    if name == "small":
        numbers = [sample.seq for sample in everything if sample.port == "rov/far"]
        assert len(numbers) < max(numbers), "none was lost"
        assert any(sample.t_sent_ns > sample.t_ns for sample in everything)
        assert {"rov/far", "rov/far/raw", "rov/near", "rov/both"} <= ports
    else:
        kinds = {field.type for port in world_of(name).ports.values() for field in port.fields if port.path in ports}
        assert {"float", "int", "bool", "str"} <= kinds


@pytest.mark.parametrize("name", NAMES)
def test_nobody_reads_and_the_world_goes_on_alike(name: str) -> None:
    world = world_of(name)
    world.subscribe(())
    assert [world.step() for _ in range(TICKS)] == [some(samples, heard(world)) for samples in whole(name)[0]]
    assert snapshot.take(world).hash() == whole(name)[1]
    newest = {sample.port: sample for samples in whole(name)[0] for sample in samples}
    for port in world.ports.values():
        if port.direction == "sensor":
            reading = world.read(port.path)
            assert (None if reading is None else reading.sample) == newest.get(port.path), port.path


@pytest.mark.parametrize("name", NAMES)
def test_samples_are_the_same_however_often_another_log_begins(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was told before stays."""
    monkeypatch.setattr(sensor_arrays, "_LOGGED", 1)
    begun: list[int] = []
    begin = sensor_arrays.SensorArrays._begin_log

    def counted(self: sensor_arrays.SensorArrays, needed: int) -> None:
        begun.append(needed)
        begin(self, needed)

    monkeypatch.setattr(sensor_arrays.SensorArrays, "_begin_log", counted)
    world, told = world_of(name), []
    for _ in range(TICKS):
        told.append(world.advance())
    assert [output.samples for output in told] == whole(name)[0]
    assert len(begun) > 10


@pytest.mark.parametrize("name", NAMES)
def test_each_port_tells_the_same_to_who_reads_it_alone(name: str) -> None:
    """They take turns of some ticks, so that each is begun and given up while samples are on their way."""
    world, expected = world_of(name), whole(name)[0]
    ports = sorted({sample.port for samples in expected for sample in samples})
    seen = set()
    for n in range(TICKS):
        wanted = {ports[(n // 5 + 7 * k) % len(ports)] for k in range(2)}
        world.subscribe(wanted)
        told = world.step()
        assert told == some(expected[n], wanted | heard(world))
        seen |= {sample.port for sample in told}
    assert len(seen) > 0.5 * len(ports)
    assert snapshot.take(world).hash() == whole(name)[1]


@pytest.mark.parametrize("name", NAMES)
def test_a_port_that_is_decimated_changes_nothing_else(name: str) -> None:
    """Each sample that a reader of 10 Hz takes is made, of all ports; the state, and what is newest, are as if everybody read all."""
    world, expected = world_of(name), whole(name)[0]
    ports = sorted({sample.port for samples in expected for sample in samples})
    first = {sample.port: sample.t_ns for samples in reversed(expected) for sample in reversed(samples)}
    decimations = {port: (Decimation(10.0, first[port]),) for port in ports}
    world.subscribe(ports, decimations)
    told = [world.step() for _ in range(TICKS)]
    newest: dict[str, int] = {}
    for n, samples in enumerate(expected):
        for sample in samples:
            interval = decimations[sample.port][0].interval(sample.t_ns)
            if interval > newest.get(sample.port, -1):
                newest[sample.port] = interval
                assert sample in told[n]
        assert [sample for sample in samples if sample in told[n]] == told[n]
    assert sum(map(len, told)) < 0.8 * sum(map(len, expected))
    assert snapshot.take(world).hash() == whole(name)[1]
    for sample in {sample.port: sample for samples in expected for sample in samples}.values():
        reading = world.read(sample.port)
        assert reading is not None
        assert reading.sample == sample


@pytest.mark.parametrize("name", NAMES)
def test_who_comes_later_gets_what_was_on_its_way_to_nobody(name: str) -> None:
    world, expected = world_of(name), whole(name)[0]
    world.subscribe(())
    world.step(TICKS // 2)
    world.subscribe(None)
    assert [world.step() for _ in range(TICKS // 2)] == expected[TICKS // 2 :]


@pytest.mark.parametrize("name", NAMES)
def test_a_state_holds_what_is_on_its_way_to_nobody(name: str) -> None:
    """Saved where nobody reads, and put back where somebody does; and in the same world, where what was wanted stays so."""
    world, other, expected = world_of(name), world_of(name), whole(name)[0]
    world.subscribe(())
    world.step(TICKS // 2)
    kept = snapshot.take(world)
    assert kept.parts["world/samples"].entries, "nothing is on its way"  # type: ignore[attr-defined]
    snapshot.from_bytes(other, snapshot.to_bytes(world, kept))
    assert [other.step() for _ in range(TICKS // 2)] == expected[TICKS // 2 :]
    world.step(30)
    snapshot.restore(world, kept)
    assert world.step(10) == [
        sample for samples in expected[TICKS // 2 :][:10] for sample in some(samples, heard(world))
    ]
    world.subscribe(None)
    assert [world.step() for _ in range(30)] == expected[TICKS // 2 + 10 :][:30]

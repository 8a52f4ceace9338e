"""Several streams of one sensor: one measurement, with its number and time, told with different errors."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from msgspec import structs

from uwserver.modifiers import Bias, ClockDrift, Delay, Dropout, WhiteNoise
from uwserver.physics.geometry.shapes import HalfSpace, Placed, Solid, Sphere
from uwserver.physics.scene import Scene
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import ImuConfig, MotionCaptureConfig, PressureConfig, StreamTable

NOISE = WhiteNoise(field="p_NS", sigma=0.1)
IDEAL = {"ideal": StreamTable(ideal=True)}


def world_of(seed=7, **sensors):
    entry = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 5.0), sensors=sensors)
    return build(load(Scenario(schema=1, seed=seed, vehicles={"rov": entry}), adapters={}))


def told(world, ticks=120):
    """Samples by port."""
    found = {}
    for sample in world.step(ticks):
        found.setdefault(sample.port, []).append(sample)
    return found


def test_a_noisy_and_an_ideal_stream_of_one_measurement():
    sensor = MotionCaptureConfig(rate_hz=60, modifiers={"noise": NOISE}, streams={"ideal": StreamTable()})
    world = world_of(x=sensor)
    world.command("rov/thrusters", u=[0.4] * 8)
    found = told(world)
    noisy, ideal = found["rov/x"], found["rov/x/ideal"]
    assert len(noisy) == 30
    assert [(s.seq, s.t_ns, s.t_sent_ns) for s in noisy] == [(s.seq, s.t_ns, s.t_sent_ns) for s in ideal]
    assert ideal[-1].value[0] == pytest.approx(world.vehicles["rov"].p_NB, abs=1e-9)
    error = np.array([a.value[0] for a in noisy]) - np.array([b.value[0] for b in ideal])
    assert 0.07 < error.std() < 0.13


def test_streams_do_not_change_what_the_sensor_tells():
    alone = MotionCaptureConfig(rate_hz=60, modifiers={"noise": NOISE})
    both = structs.replace(alone, streams={"a": StreamTable(modifiers={"noise": NOISE}), "b": StreamTable(ideal=True)})
    first, second = told(world_of(x=alone)), told(world_of(x=both))
    assert first["rov/x"] == second["rov/x"]
    noise = [np.subtract(s.value[0], t.value[0]) for s, t in zip(second["rov/x/a"], second["rov/x/b"], strict=True)]
    other = [np.subtract(s.value[0], t.value[0]) for s, t in zip(second["rov/x"], second["rov/x/b"], strict=True)]
    assert abs(np.corrcoef(np.ravel(noise), np.ravel(other))[0, 1]) < 0.5  # a stream has random numbers of its own


def test_each_stream_loses_delays_and_stamps_its_own_samples():
    sensor = PressureConfig(
        rate_hz=60,
        modifiers={"loss": Dropout(probability=0.5)},
        streams={
            "late": StreamTable(modifiers={"link": Delay(latency_s=0.1)}),
            "lost": StreamTable(modifiers={"loss": Dropout(probability=1.0)}),
            "fast": StreamTable(modifiers={"clock": ClockDrift(offset_s=2.0)}),
        },
    )
    found = told(world_of(x=sensor), ticks=240)
    assert 15 < len(found["rov/x"]) < 45
    assert len(found["rov/x/fast"]) == 60
    assert {s.t_ns - s.t_sent_ns for s in found["rov/x/fast"]} == {2_000_000_000}
    assert {s.t_sent_ns - s.t_ns for s in found["rov/x/late"]} == {100_000_000}
    assert "rov/x/lost" not in found
    values = {s.seq: s.value for s in found["rov/x/fast"]}
    assert all(s.value == values[s.seq] for port in ("rov/x", "rov/x/late") for s in found[port])


def test_a_clock_is_never_before_the_start():
    found = told(world_of(x=PressureConfig(rate_hz=60, modifiers={"clock": ClockDrift(offset_s=-0.25)})))
    stamps = [s.t_ns for s in found["rov/x"]]
    assert min(stamps) == 0
    assert stamps[-1] == found["rov/x"][-1].t_sent_ns - 250_000_000


# -- ideal streams of instruments -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def everything():
    return load("one_of_everything", adapters=_adapters())


def _adapters():
    from uwserver.adapter import installed_adapters

    return installed_adapters()


def heavy(resolved, change):
    """A world with the sensors of "heavy" changed."""
    vehicle = resolved.vehicles["heavy"]
    sensors = {name: change(sensor) for name, sensor in vehicle.vehicle.sensors.items()}
    file = structs.replace(vehicle.vehicle, sensors=sensors)
    vehicles = {
        **resolved.vehicles,
        "heavy": type(vehicle)("heavy", vehicle.entry, file, vehicle.devices, vehicle.solid),
    }
    world = build(type(resolved)(resolved.name, resolved.scenario, vehicles, None, ()))
    scene = Scene(lambda: world.hydro.state)
    scene.add_static(Solid("bottom", (Placed(HalfSpace(), p=(0.0, 0.0, 20.0)),)))
    scene.add_static(Solid("ball", (Placed(Sphere(2.0), p=(8.0, 3.0, 5.0)),)))
    world.set_scene(scene)
    world.command("heavy/thrusters", u=[0.3] * 8)
    return world


def with_ideal(sensor):
    return structs.replace(sensor, streams={**sensor.streams, **IDEAL})


def perfect(sensor):
    changes = {"ideal": True} if "ideal" in sensor.__struct_fields__ else {}
    return structs.replace(sensor, modifiers={}, streams={}, **changes)


def test_an_ideal_stream_is_what_an_ideal_device_reads(everything):
    """For all kinds at once; devices that pace themselves by what they see may do so at other instants, which are left out."""
    streams, exact = told(heavy(everything, with_ideal), 240), told(heavy(everything, perfect), 240)
    compared = set()
    for port, samples in exact.items():
        side = {sample.t_ns: sample for sample in streams.get(f"{port}/ideal", ())}
        kind = everything.vehicles["heavy"].vehicle.sensors.get(port.removeprefix("heavy/"))
        if not port.startswith("heavy/") or kind is None or port == "heavy/navigation":
            continue
        for sample in samples:
            if sample.t_ns not in side:
                continue
            same = side[sample.t_ns]
            if port == "heavy/battery":  # its charge is that of the device
                assert same.value == pytest.approx(sample.value, rel=1e-9)
            else:
                assert (same.valid, same.value) == (sample.valid, sample.value), port
            compared.add(port)
    wanted = {f"heavy/{name}" for name in everything.vehicles["heavy"].vehicle.sensors} - {"heavy/navigation"}
    assert compared == wanted & exact.keys()
    assert len(compared) > 20


def test_ideal_streams_do_not_change_what_the_devices_tell(everything):
    alone = told(heavy(everything, lambda sensor: sensor), 120)
    both = told(heavy(everything, with_ideal), 120)
    assert {port: both[port] for port in alone} == alone
    plain = [name for name, sensor in everything.vehicles["heavy"].vehicle.sensors.items() if not sensor.modifiers]
    assert len(plain) > 15
    for name in plain:
        sides = [(s.seq, s.t_ns, s.t_sent_ns) for s in both.get(f"heavy/{name}/ideal", ())]
        assert sides == [(s.seq, s.t_ns, s.t_sent_ns) for s in both.get(f"heavy/{name}", ())], name


def test_streams_are_part_of_a_snapshot(everything):
    world = heavy(
        everything,
        lambda s: structs.replace(
            s, streams={**IDEAL, "odd": StreamTable(modifiers={"loss": Dropout(probability=0.3)})}
        ),
    )
    world.step(100)
    world.call("world/snapshot")
    digest = world.call("world/state_hash")["hash"]
    first = world.step(150)
    world.call("world/restore")
    assert world.call("world/state_hash")["hash"] == digest
    assert world.step(150) == first
    assert any(s.port.endswith("/ideal") for s in first)


def test_settings_are_of_the_sensor_and_hold_for_all_its_streams():
    world = world_of(x=ImuConfig(rate_hz=60, streams={"ideal": StreamTable(ideal=True)}))
    assert not [path for path in world.services if path.startswith("rov/x/ideal/")]
    world.call("rov/x/set", rate_hz=30.0)
    assert world.ports["rov/x/ideal"].rate_hz == world.ports["rov/x"].rate_hz == 30.0
    assert world.sensors["rov/x"].sensor.dt == float(Fraction(1, 30))
    assert len(told(world)["rov/x/ideal"]) == 15
    world.call("rov/x/deactivate")
    assert "rov/x/ideal" not in told(world)


def test_a_fault_hits_all_streams():
    world = world_of(x=PressureConfig(rate_hz=60, streams=IDEAL))
    world.step(60)
    world.command("rov/thrusters", u=[0.0] * 4 + [1.0] * 4)
    for kind, streams in (("sensor_frozen", 2), ("sensor_silent", 0)):
        world.call("world/set_fault", name="f", kind=kind, target="rov/x")
        world.step(60)
        found = [samples for port, samples in told(world).items() if port.startswith("rov/x")]
        assert len(found) == streams
        assert all(len({s.value for s in samples}) == 1 for samples in found)


# -- files ------------------------------------------------------------------------------------------------------------------------------

HEAD = 'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\n'
SENSOR = '[vehicles.rov.sensors.x]\nkind = "pressure"\nrate_hz = 60\n'


def loaded(tmp_path, text):
    path = tmp_path / "x.toml"
    path.write_text(HEAD + text)
    return load(path, adapters={})


def test_a_file(tmp_path):
    text = f'{SENSOR}[vehicles.rov.sensors.x.streams.odd.modifiers.b]\nkind = "bias"\nfield = "pressure"\nvalue = 5\n'
    sensor = loaded(tmp_path, text).vehicles["rov"].vehicle.sensors["x"]
    assert sensor.streams == {"odd": StreamTable(modifiers={"b": Bias(field="pressure", value=5)})}


def test_a_sensor_of_the_vehicle_file(tmp_path):
    world = build(loaded(tmp_path, "[vehicles.rov.override.sensors.imu.streams.ideal]\nideal = true\n"))
    assert "rov/imu/ideal" in world.ports


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[vehicles.rov.sensors.x.streams.set]\n", 'x.toml:7:33: vehicles.rov.sensors.x.streams.set: a service of the sensor is named "set"'),
        ("[vehicles.rov.sensors.x.streams.a]\nidel = true\n", 'unknown key "idel" (did you mean "ideal"?)'),
        ('[vehicles.rov.sensors.x.streams.a.modifiers.b]\nkind = "bias"\nfield = "depth"\n', 'no field "depth" to modify here'),
        ('[vehicles.rov.sensors.x.streams."a b"]\n', "cannot be a name"),
    ],
)  # fmt: skip
def test_faults_are_told_at_their_place(tmp_path, text, told):
    with pytest.raises(ScenarioError) as refused:
        loaded(tmp_path, SENSOR + text)
    assert told in str(refused.value)


def test_there_is_no_such_stream():
    world = world_of(x=PressureConfig(rate_hz=60))
    with pytest.raises(Refused, match="rov/x/ideal"):
        world.read("rov/x/ideal")

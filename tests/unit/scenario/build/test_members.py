"""From resolved vehicles and objects to bodies with their components: paths, mounts, rates, random streams and rows."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from uwserver.adapter import installed_adapters
from uwserver.frames import quat_from_rpy
from uwserver.physics.warm import solid_kernels
from uwserver.scenario.build.members import build_scene, mount_of, physics_rate, stream_of
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.tables import Mount
from uwserver.sensors import ImuConfig
from uwserver.world.world import World

Built = Callable[..., World]


@pytest.fixture
def built(write, files, adapters) -> Built:
    """The tank with the tiny vehicle, and more text for either file."""

    def make(scenario: str = "", vehicle: str = "", seed: int | None = None) -> World:
        text = files["tank"].replace("[adapters", scenario + "\n[adapters")
        return build(load(write(text, files["tiny"] + vehicle), adapters=adapters), seed)

    return make


# -- rates and streams ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "exact"), [(240.0, Fraction(240)), (0.1, Fraction(1, 10)), (33.3, Fraction(333, 10)), (1e-3, Fraction(1, 1000))]
)  # fmt: skip
def test_a_rate_is_the_decimal_that_was_written(rate: float, exact: Fraction) -> None:
    assert physics_rate(rate) == exact


def test_a_stream_depends_on_seed_and_path_alone() -> None:
    def first(seed: int, path: str) -> list[float]:
        return stream_of(seed, path).random(4).tolist()

    assert first(1, "rov/imu") == first(1, "rov/imu")
    paths = ["rov/imu", "rov/imv", "rov/im", "rov/imu/noise", "", "ov/imur"]
    draws = {tuple(first(seed, path)) for seed in (0, 1) for path in paths}
    assert len(draws) == 2 * len(paths)


def test_streams_are_not_correlated() -> None:
    one, two = (stream_of(3, path).standard_normal(20_000) for path in ("rov/a", "rov/b"))
    assert abs(float(np.corrcoef(one, two)[0, 1])) < 0.03


# -- mounts -----------------------------------------------------------------------------------------------------------------------------


def test_a_sensor_sits_on_its_mount_or_where_it_says(tiny) -> None:
    vehicle = replace(tiny, mounts={"nose": Mount(position_frd_m=(0.2, 0.0, 0.1), rpy_deg=(0.0, 90.0, 0.0))})
    on_mount = mount_of(ImuConfig(rate_hz=60, mount="nose"), vehicle)
    assert on_mount.p == (0.2, 0.0, 0.1)
    assert on_mount.q == pytest.approx(quat_from_rpy(0.0, np.pi / 2, 0.0))
    own = mount_of(ImuConfig(rate_hz=60, position_frd_m=(1.0, 2.0, 3.0), rpy_deg=(180.0, 0.0, 0.0)), vehicle)
    assert own.p == (1.0, 2.0, 3.0)
    assert own.q == pytest.approx(quat_from_rpy(np.pi, 0.0, 0.0))


def test_the_mount_counts_in_what_is_measured(built: Built) -> None:
    """Depth at a mount 0.5 m below the origin."""
    sensor = (
        '[vehicles.rov.sensors.{0}]\nkind = "pressure"\noutput = "depth"\nrate_hz = 240\nposition_frd_m = [0, 0, {1}]\n'
    )
    world = built(sensor.format("low", 0.5) + sensor.format("high", 0.0))
    world.step(1)
    low, high = (world.read(f"rov/{name}") for name in ("low", "high"))
    assert low is not None
    assert high is not None
    assert low.value[0] - high.value[0] == pytest.approx(0.5, abs=1e-6)  # type: ignore[operator]


# -- ports ------------------------------------------------------------------------------------------------------------------------------


def test_ports_have_the_paths_kinds_and_rates_of_their_tables(built: Built) -> None:
    more = '[vehicles.rov.truth]\nrate_hz = 20\n[vehicles.rov.sensors.depth]\nkind = "pressure"\nrate_hz = 10\n'
    world = built(more + "[vehicles.rov.sensors.depth.streams.clean]\n")
    ports = world.ports
    assert {path for path in ports if "truth" not in path} == {
        "rov/imu",
        "rov/depth",
        "rov/depth/clean",
        "rov/thrusters",
    }
    assert ports["rov/depth"].kind == ports["rov/depth/clean"].kind == "pressure"
    assert (ports["rov/depth"].rate_hz, ports["rov/imu"].rate_hz) == (10.0, 120.0)
    truths = [port for path, port in ports.items() if path.startswith("rov/truth/")]
    assert truths
    assert all(port.rate_hz == 20.0 and port.kind.startswith("truth_") for port in truths)
    assert ports["rov/thrusters"].direction == "actuator"
    assert ports["rov/thrusters"].timeout_s == 1.0


def test_samples_come_at_the_rate_of_the_table(built: Built) -> None:
    world = built('[vehicles.rov.sensors.slow]\nkind = "pressure"\nrate_hz = 7.5\n')
    samples = [sample for sample in world.step(240) if sample.port == "rov/slow"]
    assert [sample.t_ns for sample in samples] == [round(k * 1e9 / 7.5) for k in range(1, 8)]
    assert [sample.seq for sample in samples] == list(range(7))


def test_a_latency_delays_the_delivery_only(built: Built) -> None:
    world = built('[vehicles.rov.sensors.late]\nkind = "pressure"\nrate_hz = 240\nlatency_s = 0.05\n')
    assert not [s for s in world.step(12) if s.port == "rov/late"]
    (first,) = [s for s in world.step(1) if s.port == "rov/late"]
    assert first.t_ns == round(1e9 / 240)


def test_a_watchdog_of_none_is_none(built: Built) -> None:
    never = "[vehicles.rov.override.actuators.thrusters]\ntimeout_s = 0\n"
    assert built(never).ports["rov/thrusters"].timeout_s is None


# -- errors and streams -----------------------------------------------------------------------------------------------------------------

NOISY = """
[vehicles.rov.sensors.depth]
kind = "pressure"
output = "depth"
rate_hz = 240
[vehicles.rov.sensors.depth.modifiers.noise]
kind = "white_noise"
field = "depth"
sigma = 0.1
[vehicles.rov.sensors.depth.streams.other.modifiers.noise]
kind = "white_noise"
field = "depth"
sigma = 0.1
[vehicles.rov.sensors.depth.streams.ideal]
ideal = true
"""


def depths(world: World, port: str, ticks: int = 50) -> list[Any]:
    return [sample.value[0] for sample in world.step(ticks) if sample.port == port]


def test_each_stream_has_errors_of_its_own_stream_of_numbers(built: Built) -> None:
    first, other, ideal = (
        np.array(depths(built(NOISY), f"rov/{name}")) for name in ("depth", "depth/other", "depth/ideal")
    )
    assert np.std(first - ideal) == pytest.approx(0.1, rel=0.5)
    assert np.std(other - ideal) == pytest.approx(0.1, rel=0.5)
    assert abs(float(np.corrcoef(first - ideal, other - ideal)[0, 1])) < 0.5
    assert np.abs(first - other).min() > 0.0


def test_another_sensor_does_not_change_the_noise_of_this_one(built: Built) -> None:
    more = '[vehicles.rov.sensors.another]\nkind = "imu"\nrate_hz = 240\n'
    assert depths(built(NOISY), "rov/depth") == depths(built(more + NOISY), "rov/depth")


def test_the_seed_of_the_run_counts_before_that_of_the_scenario(built: Built) -> None:
    one, same, other = (depths(built(NOISY, seed=seed), "rov/depth") for seed in (5, 5, 6))
    assert one == same
    assert one != other
    assert depths(built(NOISY), "rov/depth") == depths(built(NOISY, seed=0), "rov/depth")


def test_two_vehicles_alike_have_noise_of_their_own(built: Built) -> None:
    world = built(NOISY + '[vehicles.two]\nmodel = "./tiny.toml"\n[vehicles.two.sensors.depth]\nkind = "pressure"\nrate_hz = 240\n'
                  'output = "depth"\nmodifiers.noise = {kind = "white_noise", field = "depth", sigma = 0.1}\n')  # fmt: skip
    samples = world.step(5)
    one, two = ([s.value[0] for s in samples if s.port == f"{name}/depth"] for name in ("rov", "two"))
    assert one != two


# -- compound and objects ---------------------------------------------------------------------------------------------------------------


def test_a_compound_joins_sensors_that_stand_after_it(built: Built) -> None:
    both = '[vehicles.rov.sensors.a_both]\nkind = "compound"\nrate_hz = 120\nmembers = ["imu", "z_depth"]\n'
    world = built(both + '[vehicles.rov.sensors.z_depth]\nkind = "pressure"\nrate_hz = 120\n')
    names = [field.name for field in world.ports["rov/a_both"].fields]
    assert names[:3] == ["age", "imu_valid", "imu_f_S"]
    assert "z_depth_pressure" in names
    world.step(4)
    sample = world.read("rov/a_both")
    depth = world.read("rov/z_depth")
    assert sample is not None
    assert depth is not None
    assert sample.value[names.index("z_depth_pressure")] == depth.value[0]


def test_objects_have_truth_and_no_other_ports(built: Built) -> None:
    crate = '[objects.crate]\nkind = "box"\nsize_m = [1, 1, 1]\nmass_kg = 900\nposition_ned_m = [9, 0, 5]\n'
    assert not [path for path in built(crate).ports if path.startswith("crate")]
    world = built(crate + "[objects.crate.truth]\nrate_hz = 240\n")
    paths = [path for path in world.ports if path.startswith("crate")]
    assert paths
    assert all(path.startswith("crate/truth/") for path in paths)
    assert world.vehicles["crate"].p_NB == (9.0, 0.0, 5.0)


@pytest.mark.parametrize(("there", "lines"), [(True, 0), (False, 1)])
def test_a_world_of_solids_says_once_that_its_rays_are_slow(
    built: Built, there: bool, lines: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("embreex")
    solid_kernels()  # before, as the tree need not be compiled here
    monkeypatch.setattr("uwserver.physics.rays.surfaces.has_embree", lambda: there)
    caplog.set_level("INFO")
    world = built()
    build_scene(world, load("slope", adapters=installed_adapters()))
    assert sum("slower tree" in record.message for record in caplog.records) == lines

"""Checks of rates, epoch and clock, and of water, currents and waves across their keys."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
import pytest

from uwserver.environment.currents import CurrentTable, ProfileConfig, UniformConfig
from uwserver.scenario.files.convert import Converter
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.world.checks import check_density, check_environment, check_rate, check_time
from uwserver.scenario.world.tables import WorldTable

PATH = ("sensors", "imu", "rate_hz")


def world(**keys: Any) -> WorldTable:
    return msgspec.convert(keys, WorldTable)


@pytest.mark.parametrize(
    ("rate", "physics"),
    [
        (240.0, 240.0),
        (120.0, 240.0),
        (1.0, 240.0),
        (0.1, 240.0),
        (240.0 / 7.0, 240.0),
        (34.285714285714285, 240.0),
        (1e-6, 240.0),
        (33.3, 333.0),
        (0.3, 0.9),
    ],
)
def test_a_rate_that_divides_passes(rate: float, physics: float, report) -> None:
    check_rate(rate, physics, PATH, report)
    assert report.lines == []


@pytest.mark.parametrize(
    ("rate", "physics", "text"),
    [
        (241.0, 240.0, "241 Hz is above the physics rate of 240 Hz: use at most 240"),
        (1e9, 240.0, "1e+09 Hz is above the physics rate of 240 Hz"),
        (7.0, 240.0, "7 Hz does not divide the physics rate of 240 Hz: the nearest rates that do are 6 and 8"),
        (100.0, 240.0, "the nearest rates that do are 80 and 120"),
        (239.0, 240.0, "the nearest rates that do are 120 and 240"),
        (120.001, 240.0, "does not divide"),
        (1e-320, 240.0, "Hz is far too low"),
    ],
)  # fmt: skip
def test_a_rate_that_does_not_divide_is_told_with_its_neighbours(
    rate: float, physics: float, text: str, report
) -> None:
    check_rate(rate, physics, PATH, report)
    (line,) = report.lines
    assert line.startswith("sensors.imu.rate_hz: ")
    assert text in line


def test_the_neighbours_that_are_named_divide(report) -> None:
    for rate in (7.0, 11.3, 99.0, 0.7):
        report.lines.clear()
        check_rate(rate, 240.0, PATH, report)
        (line,) = report.lines
        low, high = (float(word) for word in line.rsplit(" are ", 1)[1].split(" and "))
        assert low < rate < high
        report.lines.clear()
        for neighbour in (low, high):
            check_rate(neighbour, 240.0, PATH, report)
        assert report.lines == []


def test_time_as_it_is_by_default_passes(report) -> None:
    check_time(WorldTable(), report)
    check_time(world(clock={"mode": "lockstep", "lockstep_clients": ["a", "b"], "max_speed": 2.0}), report)
    check_time(world(clock={"mode": "freerun"}), report)
    assert report.lines == []


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"epoch_utc": "today"}, 'world.epoch_utc: "today" is not an instant: write it as "2026-01-01T00:00:00Z"'),
        ({"epoch_utc": "2026-02-30T00:00:00Z"}, 'world.epoch_utc: "2026-02-30T00:00:00Z" is not an instant: day is out of range for month'),
        ({"clock": {"mode": "lockstep"}}, 'world.clock: mode "lockstep" needs lockstep_clients: name the clients that grant each tick'),
        ({"clock": {"max_speed": 2.0}}, 'world.clock.max_speed: max_speed is for mode "lockstep": remove it, or use speed in mode "realtime"'),
        (
            {"clock": {"mode": "freerun", "max_speed": 2.0}},
            'world.clock.max_speed: max_speed is for mode "lockstep": remove it, or use speed in mode "realtime"',
        ),
        ({"clock": {"mode": "lockstep", "lockstep_clients": ["a", "b", "a"]}}, "world.clock.lockstep_clients: a client is named twice: remove one"),
    ],
)  # fmt: skip
def test_faults_of_time_are_told_at_their_key(keys: dict[str, Any], line: str, report) -> None:
    check_time(world(**keys), report)
    assert report.lines == [line]


def test_all_faults_of_time_are_told(report) -> None:
    clock = {"mode": "realtime", "max_speed": 2.0, "lockstep_clients": ["a", "a"]}
    check_time(world(epoch_utc="x", clock=clock), report)
    assert len(report.lines) == 3


LAYERS = {"kind": "profile", "depth_m": [0, 5, 10], "velocity_ned_mps": [[1, 0, 0], [0.5, 0, 0], [0, 0, 0]]}
SEA = {"kind": "constant", "temperature_degc": 10, "salinity_psu": 35}
WAVES = {"spectrum": "jonswap", "significant_height_m": 1.0, "peak_period_s": 8.0, "direction_deg": 0.0}


@pytest.fixture
def environment(tree_of, report, warn):
    """Checks a table `environment`."""

    def check(**keys: Any) -> None:
        tree = tree_of({"schema": 1, "environment": keys})
        report.lines.clear()  # what conversion tells has tests of its own
        check_environment(tree.at("environment"), report, warn)

    return check


@pytest.fixture
def density(tree_of, report, warn):
    """Checks the density of a scenario."""

    def check(environment: dict[str, Any], **tables: Any) -> None:
        tree = tree_of({"schema": 1, "environment": environment, **tables})
        report.lines.clear()
        check_density(tree, report, warn)

    return check


# -- currents ---------------------------------------------------------------------------------------------------------------------------


def test_good_currents_and_waves_pass(environment, report, warn) -> None:
    drift = {"kind": "gauss_markov", "sigma_ned_mps": [0.1, 0.1, 0], "tau_s": 10}
    environment(currents={"layers": LAYERS, "drift": drift}, waves=WAVES)
    environment()
    assert report.lines == warn.lines == []


@pytest.mark.parametrize(
    ("keys", "lines"),
    [
        ({"depth_m": [0, 5, 5]}, ["depth_m[2]: 5 m is not below 5 m: each depth must be greater than the one before"]),
        ({"depth_m": [9, 5, 1]}, ["depth_m[1]: 5 m is not below 9 m: each depth must be greater than the one before", "depth_m[2]: 1 m is not below 5 m: each depth must be greater than the one before"]),
        ({"depth_m": [0, 5]}, ["velocity_ned_mps: 3 velocities for 2 depths: give one for each depth"]),
        ({"depth_m": [5, 0]}, ["velocity_ned_mps: 3 velocities for 2 depths: give one for each depth", "depth_m[1]: 0 m is not below 5 m: each depth must be greater than the one before"]),
    ],
)  # fmt: skip
def test_depths_of_a_profile(keys: dict[str, Any], lines: list[str], environment, report) -> None:
    environment(currents={"layers": {**LAYERS, **keys}})
    assert report.lines == [f"environment.currents.layers.{line}" for line in lines]


def test_a_faulty_current_does_not_hide_another(environment, report) -> None:
    environment(currents={"odd": {"kind": "nothing"}, "layers": {**LAYERS, "depth_m": [0, 5, 4]}})
    assert len(report.lines) == 1
    assert "layers" in report.lines[0]


class Made(CurrentTable, tag="made", kw_only=True, frozen=True):
    """Comes to what a test says."""

    flow: ClassVar[Any] = None

    def build(self) -> Any:
        return self.flow() if callable(self.flow) else self.flow


@pytest.mark.parametrize(
    ("flow", "told"),
    [
        (UniformConfig(velocity_ned_mps=(1.0, 0.0, 0.0)), None),
        (ProfileConfig(depth_m=(0.0, 1.0), velocity_ned_mps=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))), None),
        (
            ProfileConfig(depth_m=(2.0, 1.0), velocity_ned_mps=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))),
            "made.depth_m[1]: 1 m",
        ),
        (None, "cannot be built"),
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_what_a_kind_of_an_extension_comes_to_is_checked(
    flow: Any, told: str | None, monkeypatch, report, warn
) -> None:
    monkeypatch.setattr(Made, "flow", staticmethod(flow) if callable(flow) else flow)
    more = {CurrentTable: {"made": Made}}
    raw = {"schema": 1, "environment": {"currents": {"made": {"kind": "made"}}}}
    tree = Converter(report, more).tree(raw, Scenario)
    check_environment(tree.at("environment"), report, warn)
    assert len(report.lines) == (told is not None)
    assert told is None or told in report.lines[0]


# -- waves ------------------------------------------------------------------------------------------------------------------------------


def test_waves_need_gravity(environment, report) -> None:
    environment(waves=WAVES, gravity_mps2=0)
    text = "environment.waves: waves need gravity: set environment.gravity_mps2 above 0, or remove [environment.waves]"
    assert report.lines == [text]


@pytest.mark.parametrize("gravity", ["fast", -3, [9.81]])
def test_a_faulty_gravity_is_told_by_its_type_alone(gravity: Any, environment, report, warn) -> None:
    environment(waves={**WAVES, "significant_height_m": 90.0}, gravity_mps2=gravity)
    assert report.lines == warn.lines == []


@pytest.mark.parametrize(
    ("height", "period", "gravity", "steep"),
    [(6.2, 8.0, 9.81, False), (6.3, 8.0, 9.81, True), (6.3, 8.1, 9.81, False), (1.2, 8.0, 1.62, True), (1.0, 8.0, 1.62, False)],
)  # fmt: skip
def test_seas_that_would_break_are_doubted(
    height: float, period: float, gravity: float, steep: bool, environment, report, warn
) -> None:
    """Steeper than one in sixteen of the deep-water length g T^2 / 2 pi: 6.245 m for 8 s on Earth."""
    environment(waves={**WAVES, "significant_height_m": height, "peak_period_s": period}, gravity_mps2=gravity)
    assert report.lines == []
    assert len(warn.lines) == steep
    if steep:
        assert warn.lines[0].startswith(f"environment.waves.significant_height_m: waves {height:g} m high and ")
        assert warn.lines[0].endswith(" m long are steeper than 1/16: a real sea would break")


# -- density ----------------------------------------------------------------------------------------------------------------------------


def test_without_water_over_depth_nothing_is_to_be_checked(density, report, warn) -> None:
    density({"density_kgpm3": 600})
    density({"density_kgpm3": 600, "water": {**SEA, "hydrostatics": "uniform"}})
    assert report.lines == warn.lines == []


@pytest.mark.parametrize(("given", "fits"), [(1000, False), (1021, False), (1023, True), (1027, True), (1100, False)])
def test_forces_act_with_a_density_that_the_water_has(given: float, fits: bool, density, report, warn) -> None:
    """Sea water of 10 degC and 35: 1027 kg/m3 at the surface, and 5 in a thousand to spare."""
    density({"density_kgpm3": given, "water": SEA})
    assert bool(report.lines) != fits
    assert all(line.startswith("environment.density_kgpm3: forces would act with") for line in report.lines)
    assert all(line.endswith(": remove density_kgpm3, or change the water") for line in report.lines)


def test_the_default_fits_its_own_water(density, report, warn) -> None:
    for salinity in (0, 10, 40):
        density(
            {"water": {**SEA, "salinity_psu": salinity}}, vehicles={"a": {"model": "x", "position_ned_m": [0, 0, 5]}}
        )
    assert report.lines == warn.lines == []


@pytest.mark.parametrize(
    ("table", "depth", "doubted"), [("vehicles", 5, False), ("vehicles", 3000, True), ("objects", 3000, True)]
)
def test_where_it_starts_the_water_should_be_as_dense(
    table: str, depth: float, doubted: bool, density, report, warn
) -> None:
    shape = {"kind": "sphere", "radius_m": 1.0} if table == "objects" else {}
    places = {"it": {**shape, "position_ned_m": [0, 0, depth]}, "shallow": {**shape, "position_ned_m": [0, 0, 1]}}
    density({"water": SEA}, **{table: places})
    assert report.lines == []
    assert len(warn.lines) == doubted
    if doubted:
        line = warn.lines[0]
        assert line.startswith("environment.water: forces act with 1027.0 kg/m3 at every depth, but at 3000 m, where ")
        assert f"where {table}.it starts" in line
        told = float(line.rsplit("set density_kgpm3 = ", 1)[1].split()[0])
        assert 1039.0 < told < 1042.0


def test_the_worst_start_is_named(density, warn) -> None:
    density({"water": SEA}, vehicles={"a": {"position_ned_m": [0, 0, 3000]}, "b": {"position_ned_m": [0, 0, 6000]}})
    (line,) = warn.lines
    assert "at 6000 m, where vehicles.b starts" in line


@pytest.mark.parametrize("place", ["deep", [0, 0], [0, 0, "x"], 7])
def test_a_faulty_place_is_left_out(place: Any, density, report, warn) -> None:
    density({"water": SEA}, vehicles={"a": {"position_ned_m": place}, "b": 3})
    assert report.lines == warn.lines == []


def test_a_faulty_environment_is_left_out(density, report, warn) -> None:
    density({"water": SEA, "density_kgpm3": "heavy"})
    assert report.lines == warn.lines == []

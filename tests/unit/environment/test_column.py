"""The water column against gsw and closed forms, its tables in a scenario, and the absorption of sound."""

from __future__ import annotations

import math

import gsw
import numpy as np
import pytest

from uwserver.environment.column import (
    ColumnConfig,
    ConstantColumn,
    TableColumn,
    ThermoclineColumn,
    WaterColumn,
    absorption,
    uniform_column,
)
from uwserver.environment.earth import GRAVITY_GROWTH
from uwserver.environment.water import Water
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.export import explain
from uwserver.scenario.load.scenario import load

STANDARD = {"salinity_psu": 35.0}
COLUMNS: dict[str, ColumnConfig] = {
    "sea": ConstantColumn(temperature_degc=8.0, salinity_psu=35.0),
    "lake": ConstantColumn(temperature_degc=10.0, salinity_psu=0.05),
    "thermocline": ThermoclineColumn(
        surface_temperature_degc=22.0,
        deep_temperature_degc=6.0,
        surface_salinity_psu=33.0,
        deep_salinity_psu=35.0,
        depth_m=25.3,
        thickness_m=6.0,
    ),
    "cast": TableColumn(
        depth_m=(0.0, 12.3, 80.0, 1000.0, 5000.0),
        temperature_degc=(18.0, 17.0, 9.0, 4.0, 2.0),
        salinity_psu=(33.0, 33.5, 34.9, 35.0, 34.7),
    ),
}


@pytest.mark.parametrize("name", COLUMNS)
def test_agrees_with_gsw_between_the_points_of_the_tables(name):
    """c within 0.01 m/s and rho within 0.001 kg/m3 of gsw, asked with the temperature and salinity that the scenario means."""
    config = COLUMNS[name]
    column = WaterColumn(config, 9.81, 1025.0)
    depth = np.random.default_rng(1).uniform(0.0, 6000.0, 4000)
    depth[:2000] /= 60.0
    temperature, salinity = config.water_at(depth)
    absolute = gsw.SR_from_SP(salinity)
    sea = np.array([column.pressure_at(d) for d in depth]) / 1e4
    conservative = gsw.CT_from_t(absolute, temperature, sea)
    c = gsw.sound_speed(absolute, conservative, sea)
    rho = gsw.rho(absolute, conservative, sea)
    assert np.abs([column.sound_speed_at(d) for d in depth] - c).max() < 0.01
    steep = 5e-3 if name == "thermocline" else 1e-3
    assert np.abs([column.density_at(d) for d in depth] - rho).max() < steep


@pytest.mark.parametrize("latitude", [0.0, 45.0, 70.0])
@pytest.mark.parametrize(("depth", "within"), [(100.0, 0.001), (1000.0, 0.01), (6000.0, 0.1)])
def test_pressure_of_the_standard_ocean(latitude, depth, within):
    """gsw.p_from_z integrates the standard ocean (35.16504 g/kg, conservative temperature 0 degC) by a closed form of its own; in metres of water."""
    depths = np.linspace(0.0, 7000.0, 200)
    sea = -gsw.p_from_z(-depths, latitude)
    in_situ = gsw.t_from_CT(35.16504, 0.0, np.abs(sea))
    config = TableColumn(depth_m=tuple(depths), temperature_degc=tuple(in_situ), salinity_psu=(35.0,) * len(depths))
    column = WaterColumn(config, float(gsw.grav(latitude, 0.0)), 1025.0, GRAVITY_GROWTH)
    expected = float(gsw.p_from_z(-depth, latitude)) * 1e4
    assert abs(column.pressure_at(depth) - expected) / (1050.0 * 9.83) < within


def test_depth_is_the_inverse_of_pressure():
    column = WaterColumn(COLUMNS["cast"], 9.81, 1025.0)
    for depth in (0.0, 0.25, 12.3, 99.9, 3456.7, 11_999.0, 13_000.0):
        assert column.depth_of(column.pressure_at(depth)) == pytest.approx(depth, abs=1e-9)


def test_rho_g_h_as_the_paper_has_it():
    uniform = WaterColumn(ConstantColumn(hydrostatics="uniform"), 9.81, 1027.0)
    for depth in (0.0, 3.3, 1000.0, 6000.0):
        assert uniform.pressure_at(depth) == pytest.approx(1027.0 * 9.81 * depth, rel=1e-14)
        assert uniform.density_at(depth) == 1027.0


@pytest.mark.parametrize("kind", ["uniform", "teos10"])
def test_gravity_that_grows_is_that_of_the_pressure(kind):
    """dp/dz = rho g(z): what the weight of a body grows by, its buoyancy does too."""
    column = WaterColumn(ConstantColumn(hydrostatics=kind), 9.8, 1025.0, GRAVITY_GROWTH)
    for depth in (100.25, 1002.5, 4012.5):
        slope = (column.pressure_at(depth + 2.0) - column.pressure_at(depth - 2.0)) / 4.0
        g = 9.8 * (1.0 + GRAVITY_GROWTH * depth)
        assert slope == pytest.approx(column.density_at(depth) * g, rel=2e-8)


def test_what_rho_g_h_leaves_out():
    """At 1000 m the paper's equation, with the density of the surface, errs by metres."""
    sea = WaterColumn(ConstantColumn(temperature_degc=4.0), 9.81, 1025.0)
    wrong = sea.pressure_at(1000.0) / (sea.density_at(0.0) * 9.81) - 1000.0
    assert 2.0 < wrong < 3.0


def test_above_the_surface_there_is_no_pressure_and_the_water_of_the_surface():
    column = WaterColumn(COLUMNS["cast"], 9.81, 1025.0)
    assert column.pressure_at(-3.0) == 0.0
    assert column.temperature_at(-3.0) == 18.0
    assert column.sound_speed_at(-3.0) == column.sound_speed_at(0.0)


@pytest.mark.parametrize(("density", "salinity"), [(1025.0, 32.56), (1000.0, 0.355), (900.0, 0.0), (1200.0, 41.8)])
def test_uniform_water_has_the_salinity_of_its_density(density, salinity):
    column = uniform_column(density, 10.0, 9.81)
    assert column.salinity_at(5.0) == pytest.approx(salinity, abs=0.01)
    assert column.pressure_at(10.0) == pytest.approx(density * 98.1)
    assert math.isfinite(column.sound_speed_at(50.0))


def test_water_asks_its_column():
    column = WaterColumn(COLUMNS["cast"], 9.81, 1025.0)
    water = Water(1025.0, 9.81, 10.0, 1e5, (0.0, 0.0, 0.0), given=column)
    assert water.pressure((1.0, 2.0, 80.0), 0.0) == 1e5 + column.pressure_at(80.0)
    assert water.sound_speed(80.0) == column.sound_speed_at(80.0)
    assert water.absorption(7e5, 80.0) == column.absorption_at(7e5, 80.0)
    assert (water.temperature_at(80.0), water.salinity_at(80.0)) == (9.0, 34.9)
    assert water.density_at(80.0) == column.density_at(80.0)


# -- files ------------------------------------------------------------------------------------------------------------------------------

FILE = 'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n[environment.water]\n'


def test_a_scenario_with_a_cast(tmp_path):
    path = tmp_path / "sea.toml"
    path.write_text(
        FILE
        + 'kind = "table"\ndepth_m = [0, 20, 100]\ntemperature_degc = [18, 16, 8]\nsalinity_psu = [33, 34, 35]\n'
        + "[environment]\ndensity_kgpm3 = 1023.7\n"
    )
    world = build(load(path, adapters={}))
    assert world.water.temperature_at(60.0) == 12.0
    assert world.water.sound_speed(0.0) == pytest.approx(
        float(gsw.sound_speed(gsw.SR_from_SP(33.0), gsw.CT_from_t(gsw.SR_from_SP(33.0), 18.0, 0.0), 0.0)), abs=1e-9
    )


CONSTANT = 'kind = "constant"\ntemperature_degc = 10\nsalinity_psu = 35\n'
THERMOCLINE = (
    'kind = "thermocline"\nsurface_temperature_degc = 14\ndeep_temperature_degc = 7\n'
    "surface_salinity_psu = 29\ndeep_salinity_psu = 35\ndepth_m = 12\nthickness_m = 6\n"
)
TWO_LAYERS = ThermoclineColumn(
    surface_temperature_degc=14.0, deep_temperature_degc=7.0, surface_salinity_psu=29.0, deep_salinity_psu=35.0, depth_m=12.0,
    thickness_m=6.0,
)  # fmt: skip


def loaded(tmp_path, water, rest=""):
    path = tmp_path / "sea.toml"
    path.write_text(FILE + water + rest)
    return load(path, adapters={})


def test_forces_act_with_the_density_of_the_column(tmp_path):
    """Nothing else is said: buoyancy, displaced mass, added mass and drag are those of the column's water; a number given goes before it."""
    rho = float(gsw.rho(gsw.SR_from_SP(35.0), gsw.CT_from_t(gsw.SR_from_SP(35.0), 10.0, 0.0), 0.0))
    by_column, by_number, plain = (
        build(loaded(tmp_path, water, rest))
        for water, rest in (
            (CONSTANT, ""),
            (CONSTANT, "[environment]\ndensity_kgpm3 = 1027.5\n"),
            (CONSTANT + 'hydrostatics = "uniform"\n', ""),
        )
    )
    for world, density in ((by_column, rho), (by_number, 1027.5), (plain, 1025.0)):
        (body,) = world.hydro.params
        assert world.water.density == pytest.approx(density, abs=1e-9)
        assert body.buoyancy == pytest.approx(density * 9.81 * 0.0134, rel=1e-12)
        assert body.displaced == pytest.approx(density * 0.0134, rel=1e-12)
        assert body.M_A[0, 0] == pytest.approx(6.36 * density / 1000.0, rel=1e-12)
        assert body.D_Q[0, 0] == pytest.approx(34.6 * density / 1000.0, rel=1e-12)
    assert by_column.water.density == pytest.approx(by_column.water.density_at(0.0), abs=1e-9)


def test_forces_with_water_that_the_column_does_not_have_are_refused(tmp_path):
    with pytest.raises(
        ScenarioError, match=r"density_kgpm3: forces would act with 1000 kg/m3, but .* has 1027.0 to 10"
    ):
        loaded(tmp_path, CONSTANT, "[environment]\ndensity_kgpm3 = 1000\n")


def test_a_vehicle_that_starts_in_denser_water_is_told(tmp_path):
    deep = THERMOCLINE + '[vehicles.auv]\nmodel = "lauv"\nposition_ned_m = [0, 0, 40]\n'
    (warning,) = (str(problem) for problem in loaded(tmp_path, deep).warnings)
    column = WaterColumn(TWO_LAYERS, 9.81, 0.0)
    surface, there = (f"{column.density_at(depth):.1f}" for depth in (0.0, 40.0))
    assert f"forces act with {surface} kg/m3 at every depth, but at 40 m, where vehicles.auv starts" in warning
    assert f"set density_kgpm3 = {there}" in warning
    assert not loaded(tmp_path, deep, "[environment]\ndensity_kgpm3 = 1024.6\n").warnings
    assert not loaded(tmp_path, THERMOCLINE).warnings


def test_explain_shows_the_density_that_forces_act_with(tmp_path):
    assert "density_kgpm3 = 1026.95" in explain(loaded(tmp_path, CONSTANT))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('kind = "table"\ndepth_m = [0, 20]\ntemperature_degc = [18]\nsalinity_psu = [33, 34]', "same number"),
        (
            'kind = "table"\ndepth_m = [20, 0]\ntemperature_degc = [18, 8]\nsalinity_psu = [33, 34]',
            "rise from value to value",
        ),
        ('kind = "constant"\nsalinity_psu = 350', "salinity_psu"),
        ('kind = "constant"\nsalinity = 35', 'did you mean "salinity_psu"'),
    ],
)
def test_a_faulty_column_is_refused_with_its_place(tmp_path, text, said):
    path = tmp_path / "sea.toml"
    path.write_text(FILE + text + "\n")
    with pytest.raises(ScenarioError, match=said) as refused:
        load(path, adapters={})
    assert "environment.water" in str(refused.value)


def test_the_tide_raises_the_surface_for_sensors_and_forces_alike(tmp_path):
    """A light vehicle comes to rest afloat at the raised surface, and the pressure counts from there."""
    path = tmp_path / "tide.toml"
    path.write_text(
        'schema = 1\n[environment]\nsurface_level_m = 1.5\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, -1.3]\n'
        "[vehicles.rov.override.rigid_body]\nmass_kg = 13.0\n"
    )
    world = build(load(path, adapters={}))
    assert world.water.elevation(5.0, 6.0, 1.0) == pytest.approx(1.5)
    assert world.water.pressure((0.0, 0.0, 3.0), 1.0) == pytest.approx(101_325.0 + 1025.0 * 9.81 * 4.5)
    world.step(2400)
    assert -1.5 < world.vehicles["rov"].p_NB[2] < -1.35


# dB/km; Francois and Garrison 1982 as two public implementations have it (SonarDocsBuilder, jfa-octave).
SEA = {10: 1.01, 25: 5.23, 115: 34.9, 375: 87, 700: 205, 750: 230, 1000: 377, 1200: 525, 2100: 1525}
LAKE = {10: 0.033, 25: 0.20, 115: 4.2, 375: 44, 700: 152, 750: 175, 1000: 311, 1200: 447, 2100: 1370}


@pytest.mark.parametrize(("kilohertz", "expected"), SEA.items())
def test_sea(kilohertz, expected):
    assert absorption(kilohertz * 1e3, 8.0, 35.0, 50.0) * 1e3 == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("kilohertz", "expected"), LAKE.items())
def test_lake(kilohertz, expected):
    assert absorption(kilohertz * 1e3, 10.0, 0.05, 50.0, 7.0) * 1e3 == pytest.approx(expected, rel=0.02)


def ainslie_mccolm(f: float, t: float, s: float, z: float, ph: float) -> float:
    """J. Acoust. Soc. Am. 103 (1998), dB/km; f in kHz, z in km. Claims 10 % of Francois and Garrison in the ranges of its validity."""
    f1 = 0.78 * math.sqrt(s / 35.0) * math.exp(t / 26.0)
    f2 = 42.0 * math.exp(t / 17.0)
    boric = 0.106 * f1 * f * f / (f1 * f1 + f * f) * math.exp((ph - 8.0) / 0.56)
    sulphate = 0.52 * (1.0 + t / 43.0) * (s / 35.0) * f2 * f * f / (f2 * f2 + f * f) * math.exp(-z / 6.0)
    return boric + sulphate + 0.00049 * f * f * math.exp(-(t / 27.0 + z / 17.0))


# Its four ranges: (pH, salinity, temperature, depth in km), each varied about standard water.
@pytest.mark.parametrize("ph", [7.7, 8.3])
@pytest.mark.parametrize("kilohertz", [1, 3, 10, 30, 100, 300, 1000])
@pytest.mark.parametrize(
    ("t", "s", "z"), [(10, 35, 0.0), (10, 35, 1.0), (-1, 35, 0.0), (20, 35, 0.0), (4, 34, 3.0), (10, 30, 0.0)]
)
def test_ainslie_and_mccolm_agree(kilohertz, t, s, z, ph):
    mine = absorption(kilohertz * 1e3, t, s, z * 1e3, ph) * 1e3
    assert mine == pytest.approx(ainslie_mccolm(kilohertz, t, s, z, ph), rel=0.10)


def test_above_the_surface_it_is_that_of_the_surface():
    assert absorption(2e5, 10.0, 35.0, -5.0) == absorption(2e5, 10.0, 35.0, 0.0)

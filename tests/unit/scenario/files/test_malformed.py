"""Each malformed file gives exactly one fault, at its place, with its key path and its remedy."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load

Write = Callable[..., Path]
SENSOR = '[vehicles.rov.sensors.s0]\nkind = "imu"\nrate_hz = 60\n'
NOISE = SENSOR + "[vehicles.rov.sensors.s0.modifiers.noise]\n"


class Case(NamedTuple):
    """`new` replaces `old` in the file ("" appends); `place` is file:line:column: path."""

    file: str
    old: str
    new: str
    place: str
    phrase: str


# Lines of the good files (conftest.py): tank has 9, tiny has 42, motor has 27.
CASES = {
    # syntax and encoding
    "no value": Case("tank", "schema = 1", "schema =", "tank.toml:1:9", "not valid TOML: invalid value"),
    "key twice": Case("tank", 'title = "tank"', "schema = 1", "tank.toml:2:11", "cannot overwrite a value"),
    "open string": Case("tank", "port = 7600\n", 'port = "7600', "tank.toml:9:13", "not valid TOML: unterminated string"),
    "nested deeply": Case("tank", "", "x = " + "[" * 5000, "tank.toml:1:1", "nested too deeply"),
    "vehicle syntax": Case("tiny", "mass_kg = 10.0", "mass_kg = 10,0", "tiny.toml:8:13", "not valid TOML"),
    # keys
    "unknown top table": Case("tank", "[adapters.tcp]", "[adapter.tcp]", "tank.toml:7:2", 'unknown key "adapter" (did you mean "adapters"?)'),
    "unknown key, list": Case("tank", 'title = "tank"', "xyzzy = 1", "tank.toml:2:1", "allowed: schema, title, start, extensions, seed, world"),
    "misspelt key": Case("tank", "", "[world]\nrate_hs = 100", "tank.toml:11:1: world", '(did you mean "rate_hz"?)'),
    "key in capitals": Case("tank", "", "[server]\nNAME = 'x'", "tank.toml:11:1: server", '(did you mean "name"?)'),
    "inline table": Case("tank", "", "[world]\nclock = {mode = 'freerun', sped = 2}", "tank.toml:11:28: world.clock", '(did you mean "speed"?)'),
    "dotted key": Case("tank", "", "[world]\nclock.pause = true", "tank.toml:11:7: world.clock", '(did you mean "paused"?)'),
    "missing schema": Case("tank", "schema = 1\n", "", "tank.toml:1:1", 'missing key "schema"'),
    "missing model": Case("tank", 'model = "./tiny.toml"\n', "", "tank.toml:4:11: vehicles.rov", 'missing key "model"'),
    "missing source": Case("tiny", 'status = "guess"\nmass', "mass", "tiny.toml:5:2: rigid_body", 'missing key "status"'),
    "missing table": Case("tiny", '[buoyancy]\nsource = "test"\nstatus = "guess"\nvolume_m3 = 0.0098\n', "", "tiny.toml:1:1", 'missing key "buoyancy"'),
    # values
    "wrong schema": Case("tank", "schema = 1", "schema = 2", "tank.toml:1:1: schema", "expected 1, found 2"),
    "string for number": Case("tank", "", "[world]\nrate_hz = '240'", "tank.toml:11:1: world.rate_hz", 'expected a number from 1 to 10000, found the string "240"'),
    "boolean for number": Case("tank", "", "[world]\nrate_hz = true", "tank.toml:11:1: world.rate_hz", "found the boolean true"),
    "number for boolean": Case("tank", "", "[world.clock]\npaused = 1", "tank.toml:11:1: world.clock.paused", "expected true or false, found 1"),
    "float for integer": Case("tank", "schema = 1", "schema = 1\nseed = 1.5", "tank.toml:2:1: seed", "expected a whole number of at least 0, found 1.5"),
    "out of range": Case("tank", "", "[environment]\ndensity_kgpm3 = 1.025", "tank.toml:11:1: environment.density_kgpm3", "from 500 to 1500, found 1.025"),
    "huge integer": Case("tank", "", "[world]\nrate_hz = 1" + "0" * 400, "tank.toml:11:1: world.rate_hz", "found an integer of 1329 bits"),
    "infinite": Case("tank", 'model = "./tiny.toml"', 'model = "./tiny.toml"\nposition_ned_m = [0, 0, inf]', "tank.toml:6:25: vehicles.rov.position_ned_m[2]", "it must be finite"),
    "not a number": Case("tiny", "mass_kg = 10.0", "mass_kg = nan", "tiny.toml:8:1: rigid_body.mass_kg", "it must be finite"),
    "array too short": Case("tank", 'model = "./tiny.toml"', 'model = "./tiny.toml"\nposition_ned_m = [0, 1]', "tank.toml:6:1: vehicles.rov.position_ned_m", "expected an array of 3 (a number each), found an array of 2"),
    "array element": Case("tank", 'model = "./tiny.toml"', 'model = "./tiny.toml"\nposition_ned_m = [0,\n  "x", 2]', "tank.toml:7:3: vehicles.rov.position_ned_m[1]", 'expected a number, found the string "x"'),
    "number for array": Case("tank", 'model = "./tiny.toml"', 'model = "./tiny.toml"\nposition_ned_m = 2', "tank.toml:6:1: vehicles.rov.position_ned_m", "expected an array of 3"),
    "value for table": Case("tank", "schema = 1", "schema = 1\nworld = 240", "tank.toml:2:1: world", "expected a table, found 240"),
    "literal": Case("tank", "", "[world.clock]\nmode = 'free_run'", "tank.toml:11:1: world.clock.mode", '(did you mean "freerun"?)'),
    "empty string": Case("tank", '"./tiny.toml"', '""', "tank.toml:5:1: vehicles.rov.model", "a string that is not empty"),
    # kinds and names
    "unknown sensor kind": Case("tank", "", SENSOR.replace('"imu"', '"imuu"'), "tank.toml:11:1: vehicles.rov.sensors.s0.kind", 'unknown kind "imuu" (did you mean "imu"?); allowed: imu, pressure, motion_capture'),
    "missing kind": Case("tank", "", "[vehicles.rov.sensors.s0]\nrate_hz = 60", "tank.toml:10:23: vehicles.rov.sensors.s0", 'missing key "kind"; allowed: imu'),
    "kind is a number": Case("tank", "", "[vehicles.rov.sensors.s0]\nkind = 3", "tank.toml:11:1: vehicles.rov.sensors.s0.kind", "expected a string, found 3"),
    "key of another kind": Case("tank", "", SENSOR + 'output = "depth"', "tank.toml:13:1: vehicles.rov.sensors.s0", 'unknown key "output"'),
    "unknown adapter": Case("tank", '"sockets"', '"socket"', "tank.toml:8:1: adapters.tcp.kind", '(did you mean "sockets"?); allowed: '),
    "adapter key": Case("tank", "port = 7600", "prt = 7600", "tank.toml:9:1: adapters.tcp", '(did you mean "port"?)'),
    "adapter is a value": Case("tank", "[adapters.tcp]\nkind = \"sockets\"\nport", "[adapters]\ntcp", "tank.toml:8:1: adapters.tcp", "expected a table, found 7600"),
    "bad name": Case("tank", "", SENSOR.replace("s0", '"s/0"'), 'tank.toml:10:23: vehicles.rov.sensors."s/0"', '"s/0" cannot be a name'),
    "bad adapter name": Case("tank", "[adapters.tcp]", '[adapters."1"]', "tank.toml:7:11: adapters.1", "cannot be a name"),
    "vehicle named world": Case("tank", "[vehicles.rov]", "[vehicles.world]", "tank.toml:4:11: vehicles.world", "a vehicle cannot be named"),
    # references
    "unknown vehicle": Case("tank", "./tiny.toml", "bluerov2_havy", "tank.toml:5:1: vehicles.rov.model", 'unknown vehicle "bluerov2_havy" (did you mean "bluerov2_heavy"?)'),
    "no vehicle file": Case("tank", "./tiny.toml", "./tinny.toml", "tank.toml:5:1: vehicles.rov.model", 'there is no vehicle file "tinny.toml"'),
    "unknown device": Case("tiny", "./motor.toml", "t2000", "tiny.toml:32:1: thrusters.left.device", 'unknown device "t2000" (did you mean "t200"?)'),
    # time
    "rate": Case("tank", "", SENSOR.replace("60", "100"), "tank.toml:12:1: vehicles.rov.sensors.s0.rate_hz", "100 Hz does not divide the physics rate of 240 Hz: the nearest rates that do are 80 and 120"),
    "rate too high": Case("tank", "", SENSOR.replace("60", "480"), "tank.toml:12:1: vehicles.rov.sensors.s0.rate_hz", "above the physics rate of 240 Hz: use at most 240"),
    "rate in the vehicle": Case("tiny", "rate_hz = 120", "rate_hz = 7", "tiny.toml:41:1: sensors.imu.rate_hz", "6 and 8"),
    "truth rate": Case("tank", "", "[vehicles.rov.truth]\nrate_hz = 50", "tank.toml:11:1: vehicles.rov.truth.rate_hz", "the nearest rates that do are 48 and 60"),
    "epoch": Case("tank", "", "[world]\nepoch_utc = '2026-01-01'", "tank.toml:11:1: world.epoch_utc", 'write it as "2026-01-01T00:00:00Z"'),
    "epoch in no month": Case("tank", "", "[world]\nepoch_utc = '2026-13-01T00:00:00Z'", "tank.toml:11:1: world.epoch_utc", "month must be in 1..12"),
    "epoch in no zone": Case("tank", "", "[world]\nepoch_utc = '2026-01-01T00:00:00.5+24:30'", "tank.toml:11:1: world.epoch_utc", "is not an instant"),
    "lockstep": Case("tank", "", "[world.clock]\nmode = 'lockstep'", "tank.toml:10:8: world.clock", "needs lockstep_clients"),
    "lockstep twice": Case("tank", "", "[world.clock]\nlockstep_clients = ['a', 'a']", "tank.toml:11:1: world.clock.lockstep_clients", "named twice"),
    "max_speed": Case("tank", "", "[world.clock]\nmax_speed = 1.0", "tank.toml:11:1: world.clock.max_speed", "for mode \"lockstep\""),
    # across the tables of a vehicle
    "unknown mount": Case("tank", "", SENSOR + 'mount = "nos"', "tank.toml:13:1: vehicles.rov.sensors.s0.mount", 'no mount "nos" (did you mean "nose"?)'),
    "mount and position": Case("tiny", 'mount = "nose"', 'mount = "nose"\nrpy_deg = [0, 0, 0]', "tiny.toml:43:1: sensors.imu.rpy_deg", "remove either mount or rpy_deg"),
    "unknown member": Case("tiny", 'kind = "thrusters"', 'kind = "thrusters"\nmembers = ["left", "right"]', "tiny.toml:38:20: actuators.thrusters.members[1]", 'no thruster "right"; there are: left'),
    "member twice": Case("tiny", 'kind = "thrusters"', 'kind = "thrusters"\nmembers = ["left", "left"]', "tiny.toml:38:20: actuators.thrusters.members[1]", "named twice"),
    "single member": Case("tiny", 'kind = "thrusters"', 'kind = "thruster"\nmember = "lift"', "tiny.toml:38:1: actuators.thrusters.member", '(did you mean "left"?)'),
    "modifier field": Case("tank", "", NOISE + 'kind = "white_noise"\nfield = "f_s"', "tank.toml:15:1: vehicles.rov.sensors.s0.modifiers.noise.field", 'no field "f_s" to modify here, there are: f_S, w_S, temperature'),
    "modifier size": Case("tank", "", NOISE + 'kind = "bias"\nfield = "f_S"\nvalue = [1, 2]', "tank.toml:13:36: vehicles.rov.sensors.s0.modifiers.noise", "needs one number or 3"),
    "modifier element": Case("tank", "", NOISE + 'kind = "bias"\nfield = "f_S"\nvalue = [1, 2, true]', "tank.toml:16:16: vehicles.rov.sensors.s0.modifiers.noise.value[2]", "expected a number, found the boolean true"),
    "one name, two parts": Case("tiny", "[sensors.imu]", "[sensors.thrusters]", "tiny.toml:36:12: actuators.thrusters", 'a sensor is named "thrusters" too'),
    "sensor named truth": Case("tank", "", SENSOR.replace("s0", "truth"), "tank.toml:10:23: vehicles.rov.sensors.truth", 'the server itself uses paths with "truth"'),
    "two inertias": Case("tiny", "inertia_kgm2 =", "inertia_matrix_kgm2 = [[1,0,0],[0,1,0],[0,0,1]]\ninertia_kgm2 =", "tiny.toml:5:2: rigid_body", "exactly one of inertia_kgm2 and inertia_matrix_kgm2: both are given"),
    "no diagonal": Case("tiny", "diagonal = [5, 6, 7, 0.1, 0.1, 0.1]\n\n[damping", "\n[damping", "tiny.toml:16:2: added_mass", "exactly one of diagonal and matrix: none is given"),
    "no damping form": Case("tiny", "diagonal = [5, 6, 7, 0.1, 0.1, 0.1]\n\n[mounts", "\n[mounts", "tiny.toml:21:10: damping.linear", "none is given"),
    "M_RB": Case("tiny", "[0.1, 0.2, 0.3]", "[0.1, -0.2, 0.3]", "tiny.toml:5:2: rigid_body", "M_RB is not positive definite (smallest eigenvalue -0.2)"),
    "M_RB by override": Case("tank", "", "[vehicles.rov.override.rigid_body]\ncenter_of_mass_frd_m = [0, 0, 1]\ninertia_about = 'origin'", "tank.toml:10:24: vehicles.rov.override.rigid_body", "not positive definite"),
    "inertia asymmetric": Case("tiny", "inertia_kgm2 = [0.1, 0.2, 0.3]", "inertia_matrix_kgm2 = [[1,0.1,0],[0,1,0],[0,0,1]]", "tiny.toml:9:1: rigid_body.inertia_matrix_kgm2", "(4,5) is 0.1 but (5,4) is 0"),
    "M_A asymmetric": Case("tiny", "diagonal = [5, 6, 7, 0.1, 0.1, 0.1]\n\n[damping", "matrix = [[5,0,0,0,0.5,0],[0,6,0,0,0,0],[0,0,7,0,0,0],[0,0,0,1,0,0],[0,0,0,0,1,0],[0,0,0,0,0,1]]\n\n[damping", "tiny.toml:16:2: added_mass", "(1,5) is 0.5 but (5,1) is 0; correct it, or take its symmetric part by symmetrise = true"),
    "M_A negative": Case("tiny", "diagonal = [5, 6, 7, 0.1, 0.1, 0.1]\n\n[damping", "diagonal = [-5, 6, 7, 0.1, 0.1, 0.1]\n\n[damping", "tiny.toml:16:2: added_mass", "M_A is not positive semi-definite (smallest eigenvalue -5)"),
    "matrix row": Case("tiny", "diagonal = [5, 6, 7, 0.1, 0.1, 0.1]\n\n[damping", "matrix = [[5,0,0,0,0.5,0],[0,6]]\n\n[damping", "tiny.toml:19:1: added_mass.matrix", "expected an array of 6 (an array of 6 (a number each) each), found an array of 2"),
    "axis": Case("tiny", "axis_frd = [1.0, 0.0, 0.0]", "axis_frd = [0, 0, 0]", "tiny.toml:34:1: thrusters.left.axis_frd", "the axis has no direction"),
    "override key": Case("tank", "", "[vehicles.rov.override.rigid_body]\nmas_kg = 11", "tank.toml:11:1: vehicles.rov.override.rigid_body", '(did you mean "mass_kg"?)'),
    "override value": Case("tank", "", "[vehicles.rov.override.sensors.imu]\nrate_hz = -1", "tank.toml:11:1: vehicles.rov.override.sensors.imu.rate_hz", "greater than 0, found -1"),
    # devices
    "dead band": Case("motor", "[-0.07, 0.07]", "[0.01, 0.07]", "motor.toml:17:1: curves.v16.dead_band", "(0.01, 0.07) must lie inside (-1, 1) and hold 0"),
    "two lags": Case("motor", "time_constant_s = 0.1", "time_constant_s = 0.1\nnumerator = [1]\ndenominator = [1, 1]", "motor.toml:19:2: lag", "exactly one form"),
    "half a lag": Case("motor", "time_constant_s = 0.1", "numerator = [1]", "motor.toml:19:2: lag", "exactly one form"),
    "order of the lag": Case("motor", "time_constant_s = 0.1", "numerator = [1]\ndenominator = [1, 1]", "motor.toml:19:2: lag", "needs 4 denominator"),
    "unstable lag": Case("motor", "time_constant_s = 0.1", "numerator = [1]\ndenominator = [1, 1, 1, -1]", "motor.toml:23:1: lag.denominator", "unstable"),
    "shape": Case("motor", "[1.0, 2.0]", "[1.0, -2.0]", "motor.toml:9:1: shape.coefficients", "must be greater than 0"),
    "device key": Case("motor", "diameter_m", "diameter_mm", "motor.toml:27:1: propeller", '(did you mean "diameter_m"?)'),
    "voltage twice": Case("motor", "", "[curves.b]\nsource='x'\nstatus='guess'\nvoltage_V=16\nmax_forward_N=1\nmax_reverse_N=1\ndead_band=[0,0]", "motor.toml:31:1: curves.b.voltage_V", 'the curve "v16" is for 16 V too: remove one of the two'),
}  # fmt: skip


def problems(path: Path, adapters: Mapping[str, type]) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        load(path, adapters=adapters)
    assert str(caught.value).splitlines()[:-1] == [str(problem) for problem in caught.value.problems]
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize("name", CASES)
def test_one_fault_at_its_place(name: str, write: Write, files: dict[str, str], adapters: Mapping[str, type]) -> None:
    case = CASES[name]
    good = files[case.file]
    assert case.old in good
    files[case.file] = good.replace(case.old, case.new, 1) if case.old else good + case.new
    (only,) = problems(write(files["tank"], files["tiny"], files["motor"]), adapters)
    assert only.startswith(case.place + ": ")
    assert case.phrase in only


def test_there_are_enough_cases() -> None:
    assert len(CASES) >= 40


def test_the_good_files_are_good(write: Write, adapters: Mapping[str, type]) -> None:
    resolved = load(write(), adapters=adapters)
    assert resolved.warnings == ()
    assert resolved.name == "tank"
    assert list(resolved.vehicles["rov"].devices) == ["left"]


def test_all_faults_of_all_files_at_once_in_order(
    write: Write, files: dict[str, str], adapters: Mapping[str, type]
) -> None:
    tank = files["tank"].replace("port", "prt") + SENSOR.replace("rate_hz = 60", 'rate_hz = 100\nmount = "n"')
    tiny = files["tiny"].replace("mass_kg", "mas_kg").replace('kind = "thrusters"', 'kind = "thruster"\nmember = "r"')
    motor = files["motor"].replace('"guess"', '"guessed"', 1)
    lines = problems(write(tank + "[vehicles.two]\nmodel = './tiny.toml'\n", tiny, motor), adapters)
    assert [line.split(": ")[0] for line in lines] == [
        "tank.toml:9:1", "tank.toml:12:1", "tank.toml:13:1", "tiny.toml:8:1", "tiny.toml:38:1", "motor.toml:8:1",
    ]  # fmt: skip


def test_the_count_follows_the_faults(write: Write, files: dict[str, str], adapters: Mapping[str, type]) -> None:
    with pytest.raises(ScenarioError, match=r"\n2 errors$"):
        load(write(files["tank"].replace("title", "titel").replace("kind", "knd")), adapters=adapters)


def test_a_file_that_is_no_text(write: Write, adapters: Mapping[str, type]) -> None:
    path = write()
    path.write_bytes(b'schema = 1\ntitle = "\xc3\xa4\xff"\n')
    assert problems(path, adapters) == ["tank.toml:2:11: byte 0xff is not valid UTF-8: save the file as UTF-8"]


def test_windows_line_ends_and_byte_order_mark_change_no_position(
    write: Write, files: dict[str, str], adapters: Mapping[str, type]
) -> None:
    path = write()
    path.write_bytes(b"\xef\xbb\xbf" + files["tank"].replace("port", "prt").replace("\n", "\r\n").encode())
    assert [line.split(": ")[0] for line in problems(path, adapters)] == ["tank.toml:9:1"]


def test_unknown_scenario_lists_the_shipped_ones(adapters: Mapping[str, type]) -> None:
    with pytest.raises(
        ScenarioError, match=r'unknown scenario "bluerov2_pol" \(did you mean "bluerov2_pool"\?\); shipped: .*one_of'
    ):
        load("bluerov2_pol", adapters=adapters)


def test_missing_scenario_file(write: Write, adapters: Mapping[str, type]) -> None:
    write()
    with pytest.raises(ScenarioError, match=r'there is no scenario file "nothing.toml"'):
        load(Path("nothing.toml"), adapters=adapters)


@pytest.mark.parametrize(
    ("file", "old", "new", "warning"),
    [
        ("tiny", "volume_m3 = 0.0098", "volume_m3 = 0.011",
         "tiny.toml:11:2: buoyancy: warning: the vehicle floats up with 12.51 N (buoyancy 110.6 N, weight 98.1 N)"),
        ("tiny", "volume_m3 = 0.0098", "volume_m3 = 0.009",
         "tiny.toml:11:2: buoyancy: warning: the vehicle sinks with 7.603 N (buoyancy 90.5 N, weight 98.1 N)"),
        ("tank", "port = 7600", 'port = 9600',
         "tank.toml:9:1: adapters.tcp.port: warning: server.metrics_port uses port 9600 too: unless one is TCP and the other UDP, only one of them can start"),
        ("tank", "[adapters.tcp]", "[adapters.b]\nkind = 'sockets'\nport = 7600\n[adapters.tcp]",
         "tank.toml:12:1: adapters.tcp.port: warning: adapters.b uses port 7600 too: unless one is TCP and the other UDP, only one of them can start"),
        ("tiny", "diagonal = [5, 6, 7, 0.1, 0.1, 0.1]\n\n[damping",
         "matrix = [[5,0,0,0,0.5,0],[0,6,0,0,0,0],[0,0,7,0,0,0],[0,0,0,1,0,0],[0.3,0,0,0,1,0],[0,0,0,0,0,1]]\nsymmetrise = true\n\n[damping",
         "tiny.toml:16:2: added_mass: warning: M_A is not symmetric, its symmetric part is used: (1,5) is 0.5 but (5,1) is 0.3"),
    ],
)  # fmt: skip
def test_warnings_let_the_scenario_run(
    file: str, old: str, new: str, warning: str, write: Write, files: dict[str, str], adapters: Mapping[str, type]
) -> None:
    assert old in files[file]
    files[file] = files[file].replace(old, new, 1)
    resolved = load(write(files["tank"], files["tiny"], files["motor"]), adapters=adapters)
    assert [str(problem) for problem in resolved.warnings] == [warning]

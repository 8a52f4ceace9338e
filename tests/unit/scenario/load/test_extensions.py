"""Kinds from a Python file beside the scenario: the example of the how-to page, and every way to get it wrong."""

from __future__ import annotations

import math
import statistics
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from run_rig import recorded_run

from uwserver.cli.recordings.replay import replay as replay_command
from uwserver.recording.replay import NotReplayable, replay
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.sensors.compiled import loops_of


@pytest.fixture
def tank(beside: Path) -> Path:
    return beside / "tank.toml"


def test_the_example_measures(tank):
    world = build(load(tank, adapters={}))
    assert world.ports["rov/turbidity"].kind == "turbidity"
    samples = world.step(240)
    fouled, clean = ([s for s in samples if s.port == p] for p in ("rov/turbidity", "rov/turbidity/clean"))
    assert len(fouled) == len(clean) == 10
    depth = world.vehicles["rov"].p_NB[2]
    assert clean[-1].value[0] == pytest.approx(40.0 * math.exp(-(10.0 - depth) / 3.0), abs=1e-9)
    assert fouled[-1].value[0] == pytest.approx(clean[-1].value[0] * (1.0 + 1e-4), rel=1e-12)


def test_the_example_is_part_of_a_snapshot(tank):
    world = build(load(tank, adapters={}))
    world.step(60)
    world.call("world/snapshot")
    first = world.step(60)
    world.call("world/restore")
    assert world.step(60) == first


def test_the_example_in_compiled_code_measures_and_is_part_of_a_snapshot(beside):
    """Its kernel is there before the first tick: one that compiles would hold up all the others for seconds."""
    world = build(load(beside / "pond.toml", adapters={}))
    (kernel,) = loops_of(world.sensors["rov/oxygen"].sensor.kernel)
    assert len(kernel.signatures) == 1
    samples = world.step(480)
    assert len(kernel.signatures) == 1
    noisy, ideal = ([s for s in samples if s.port == p] for p in ("rov/oxygen", "rov/oxygen/ideal"))
    assert len(noisy) == len(ideal) == 120
    depth = world.vehicles["rov"].p_NB[2]
    assert ideal[-1].value[0] == pytest.approx(0.28 * math.exp(-depth / 20.0), abs=1e-9)
    errors = [n.value[0] - i.value[0] for n, i in zip(noisy, ideal, strict=True)]
    assert len(set(errors)) == 120
    assert statistics.stdev(errors) == pytest.approx(0.002, rel=0.3)
    world.call("world/snapshot")
    first = world.step(60)
    world.call("world/restore")
    assert world.step(60) == first


def test_a_kernel_that_cannot_be_compiled_is_told_with_its_place(beside):
    path = beside / "oxygen.py"
    path.write_text(path.read_text().replace("math.exp(-max(0.0", "math.expo(-max(0.0"))
    line = path.read_text().splitlines().index("@compiled") + 1
    with pytest.raises(RuntimeError, match=rf'oxygen\.py:{line}: numba cannot compile "measure" .*expo'):
        build(load(beside / "pond.toml", adapters={}))


def test_the_tests_of_the_examples_pass(beside, listings, monkeypatch):
    monkeypatch.syspath_prepend(beside)
    for module in ("turbidity", "oxygen", "jet", "river"):
        monkeypatch.setitem(sys.modules, module, sys)
        del sys.modules[module]
    names: dict[str, object] = {}
    exec(compile(listings["tests"], "extend.md", "exec"), names)
    tests = [call for name, call in names.items() if name.startswith("test_")]
    assert len(tests) == 5
    for test in tests:
        test()  # type: ignore[operator]


def test_nothing_runs_unless_it_is_named(tank):
    (tank.parent / "turbidity.py").write_text("raise SystemExit('it ran')\n")
    other = tank.parent / "other.toml"
    other.write_text('schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\n')
    load(other, adapters={})


def test_each_load_runs_the_file_as_it_is_now(tank):
    load(tank, adapters={})
    path = tank.parent / "turbidity.py"
    path.write_text(path.read_text().replace("layer_m: Positive = 3.0", "layer_m: Positive = 6.0"))
    assert load(tank, adapters={}).vehicles["rov"].vehicle.sensors["turbidity"].layer_m == 6.0
    assert not (tank.parent / "__pycache__").exists()


def test_the_builder_takes_it_too(tank):
    builder = (
        ScenarioBuilder("built", adapters={})
        .extension(tank.parent / "turbidity.py")
        .vehicle("rov", "bluerov2_heavy")
        .sensor("rov", "x", "turbidity", rate_hz=10, bottom_ntu=1.0)
        .modifier("rov", "x", "old", "fouling", field="turbidity", growth_ps=0.1)
    )
    with pytest.raises(ScenarioError, match=r'did you mean "bottom_ntu"'):
        builder.sensor("rov", "x", "turbidity", rate_hz=10, bottom_ntus=1.0)
    world = build(load(builder.build(), adapters={}))
    world.step(24)
    assert world.read("rov/x") is not None


def test_a_vehicle_file_and_a_device_file_may_use_it(tank):
    device = 'schema = 1\nkind = "turbidity"\nname = "probe"\ntitle = "Probe"\n[properties.a]\nlayer_m = 9.0\n'
    device += 'source = "made up for the test"\nstatus = "guess"\n'
    (tank.parent / "probe.toml").write_text(device)
    tank.write_text(tank.read_text().replace('kind = "turbidity"', 'profile = "probe.toml"'))
    assert load(tank, adapters={}).vehicles["rov"].vehicle.sensors["turbidity"].layer_m == 9.0


def test_a_sensor_is_converted_once_and_built_once_for_its_fields(tank):
    """Its table stands in the scenario and in the merged vehicle: both are one. Each new vehicle builds its own sensor."""
    path = tank.parent / "turbidity.py"
    lines = path.read_text().replace("import math\n", "import math\n\nCONVERTED, BUILT = [], []\n", 1)
    lines = lines.replace(
        "    def build(self, mount",
        "    def __post_init__(self):\n        CONVERTED.append(self)\n\n    def build(self, mount",
        1,
    )
    path.write_text(lines.replace("return Turbidity(mount", "BUILT.append(mount)\n        return Turbidity(mount"))
    resolved = load(tank, adapters={})
    sensor = resolved.vehicles["rov"].vehicle.sensors["turbidity"]
    module = sys.modules[type(sensor).__module__]
    assert [sensor] == module.CONVERTED
    assert len(module.BUILT) == 1
    build(resolved)
    assert len(module.BUILT) == 2


# -- faults -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("SENSORS = (", "SENSORS = (int, ", "turbidity.py:64:1: SENSORS: <class 'int'> does not derive from uwserver.sensors.SensorTable"),
        ("import math\n", "import math, nowhere_at_all\n", "turbidity.py:3:1: running it failed: ModuleNotFoundError: No module named"),
        ("import math\n", "import math\n1 / 0\n", "turbidity.py:4:1: running it failed: ZeroDivisionError: division by zero"),
        ("import math\n", "import math math\n", "turbidity.py:3:13: not valid Python: invalid syntax"),
        ('tag="turbidity"', 'tag="imu"', 'turbidity.py:11:1: SENSORS: there is a kind "imu" already: give the class TurbidityConfig another tag'),
        ("SENSORS = (TurbidityConfig,)\nMODIFIERS = (FoulingConfig,)", "", "1:1: it adds no kinds: list them in SENSORS, MODIFIERS, ACTUATORS, "),
        ("MODIFIERS = (FoulingConfig,)", "MODIFIERS = FoulingConfig", "turbidity.py:65:1: MODIFIERS: expected a list of classes"),
        ("    def build(self, mount", "    def made(self, mount", "turbidity.py:11:1: SENSORS: TurbidityConfig has no method build()"),
        ("return Turbidity(mount, self)", "return Turbidity(mount)", "cannot be built (turbidity.py:25): TypeError"),
        ("return Fouling(self, stream)", "return Fouling(stream)", "cannot be built (turbidity.py:50): TypeError"),
        ('tag="turbidity", ', "", 'turbidity.py:11:1: SENSORS: TurbidityConfig has no tag, which names its kind in files: write class '),
        ("FoulingConfig(ModifierTable", "FoulingConfig(SensorTable", "MODIFIERS: <class 'uwserver_extension_"),
        ("SENSORS = (", "SENSORS = (SensorTable, ", "SENSORS: SensorTable has no method build()"),
        ("return Fouling(self, stream)", "return stream", "it must derive from uwserver.modifiers.Modifier"),
        ("class Turbidity(IdealSensor)", "class Turbidity", "it must derive from uwserver.sensors.Sensor or IdealSensor"),
        ("fields = (Field(", "fields = ((", "its fields must be a tuple of uwserver.ports.Field"),
    ],
)  # fmt: skip
def test_faults_of_the_file_are_told_with_its_line(tank, monkeypatch, old, new, told):
    monkeypatch.chdir(tank.parent)
    path = tank.parent / "turbidity.py"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ScenarioError) as refused:
        load(tank, adapters={})
    assert told in str(refused.value), str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("turbidity.py", "turbid.py", 'tank.toml:2:15: extensions[0]: there is no Python file "turbid.py"'),
        ('["turbidity.py"]', '["tank.toml"]', 'extensions[0]: there is no Python file "tank.toml"'),
        ('["turbidity.py"]', "[3]", "tank.toml:2:15: extensions[0]: expected a string that is not empty, found 3"),
        ("bottom_ntu = 40", "bottom_ntus = 40", 'unknown key "bottom_ntus" (did you mean "bottom_ntu"?)'),
        ("bottom_ntu = 40", "bottom_ntu = -4", "expected a number of at least 0, found -4"),
        ('kind = "fouling"', 'kind = "foul"', 'unknown kind "foul"'),
        ('field = "turbidity"', 'field = "x"', 'no field "x" to modify here, there are: turbidity'),
    ],
)
def test_faults_of_the_scenario_are_told_with_those_of_its_kinds(tank, monkeypatch, old, new, told):
    monkeypatch.chdir(tank.parent)
    assert old in tank.read_text()
    tank.write_text(tank.read_text().replace(old, new, 1))
    with pytest.raises(ScenarioError) as refused:
        load(tank, adapters={})
    assert told in str(refused.value), str(refused.value)


def test_a_component_that_fails_while_it_runs_stops_the_simulation_with_its_place(tank):
    path = tank.parent / "turbidity.py"
    path.write_text(
        path.read_text().replace(
            "        if depth < 0.0:\n", "        if scope.t > 0.2:\n            1 / 0\n        if depth < 0.0:\n"
        )
    )
    command = [sys.executable, "-m", "uwserver", "run", str(tank), "--port", "0", "--mode", "freerun", "--until", "1.5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    line = path.read_text().splitlines().index("            1 / 0") + 1
    assert f"{path}:{line}: division by zero" in done.stderr
    assert done.returncode != 0


def test_a_recording_wants_the_file_again(tank, tmp_path):
    recording = tmp_path / "x.mcap"
    recorded_run(tank, recording, 1.5)
    with pytest.raises(NotReplayable, match=r"turbidity\.py: give --trust-files"):
        replay(recording)
    done = replay(recording, [tank.parent / "turbidity.py"])
    assert done.difference is None
    assert done.hashes > 0


def test_replay_opens_files_that_a_recording_names_only_when_it_is_told_to(tank, tmp_path, monkeypatch):
    """And then beside the recording or in the working folder, nowhere else."""
    recording = tmp_path / "x.mcap"
    recorded_run(tank, recording, 0.5)

    def told(*options: str) -> tuple[int, str]:
        outcome = CliRunner().invoke(replay_command, [str(recording), *options])
        return outcome.exit_code, outcome.output

    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    file = tank.parent / "turbidity.py"
    hidden = file.rename(tmp_path / "hidden.py")
    code, text = told("--trust-files")
    assert (code, "put it there, or go to its folder" in text) == (1, True)
    hidden.rename(tmp_path / "elsewhere" / "turbidity.py")
    code, text = told()
    assert (code, "give --trust-files" in text) == (1, True)
    code, text = told("--trust-files")
    assert (code, "hashes equal" in text) == (0, True)

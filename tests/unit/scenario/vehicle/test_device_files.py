"""Device files of sensors: each shipped one loads, is of use, and is refused when a key of its properties is misspelt."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest

from uwserver.environment.water import Water
from uwserver.scenario.build.world import build
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.devices import check_profile
from uwserver.sensors import LblConfig, Pose, Scope, UsblConfig

_RAW = {name: read(path).raw for name, path in shipped("devices").items()}
DEVICES = {name: path for name, path in shipped("devices").items() if _RAW[name]["kind"] != "thruster"}
_LENGTHS = {name: sum(map(len, _RAW[name]["properties"].values())) for name in DEVICES}
_LONGEST = {_RAW[name]["kind"]: name for name in sorted(DEVICES, key=_LENGTHS.__getitem__)}
"""Of each kind the device with most properties."""
HEAD = """schema = 1
[world]
origin_lat_deg = 63.4
origin_lon_deg = 10.4
[vehicles.rov]
model = "bluerov2_heavy_von_benzon"
position_ned_m = [0, 0, 5]
"""


BEACON = "[vehicles.rov.sensors.device.beacons.a]\nposition_ned_m = [80.0, 30.0, 20.0]\n"
USES = {"lbl": BEACON, "usbl": BEACON, "rpm": 'members = ["t1", "t2"]\n'}


def scenario(folder: Path, profile: str, rest: str = "") -> Path:
    path = folder / "x.toml"
    path.write_text(f'{HEAD}[vehicles.rov.sensors.device]\nprofile = "{profile}"\nrate_hz = 8\n{rest}')
    return path


def use_of(name: str) -> str:
    """What a scenario must say of a device beside its profile."""
    return USES.get(_RAW[name]["kind"], "")


def test_all_devices_measure(tmp_path):
    """On one vehicle, which is half a second old."""
    path = tmp_path / "x.toml"
    tables = (
        f'[vehicles.rov.sensors.{name}]\nprofile = "{name}"\nrate_hz = 8\n{use_of(name).replace(".device.", f".{name}.")}'
        for name in DEVICES
    )
    path.write_text(HEAD + "".join(tables))
    world = build(load(path, adapters={}))
    world.step(120)
    for name in DEVICES:
        kind = _RAW[name]["kind"]
        port = f"rov/{name}/received" if kind.endswith("_modem") else f"rov/{name}"
        assert world.ports[port].kind == kind
        assert world.sensors[port].number > 0 or world.sensors[port].held is None, name
        if use_of(name) == BEACON:
            sample = world.read(port)
            assert sample.valid, name
            assert sample.value[1] == pytest.approx(87.0, abs=2.0), name


@pytest.mark.parametrize(
    "name",
    [name if name in _LONGEST.values() else pytest.param(name, marks=pytest.mark.slow) for name in DEVICES],
)
def test_a_misspelt_property_is_refused(name, tmp_path):
    """Those of its head are at once, then those of its properties; and alone those of which nothing is told then."""
    lines, wrong = DEVICES[name].read_text().split("\n"), {}
    for k, line in enumerate(lines):
        key = line.partition(" = ")[0]
        if " = " in line and not line.startswith(("#", "source", "status", "modifiers.")):
            wrong[k] = f"{key[:-1]}qx"

    def told(these):
        changed = [f"{wrong[k]} = {line.partition(' = ')[2]}" if k in these else line for k, line in enumerate(lines)]
        (tmp_path / "device.toml").write_text("\n".join(changed))
        try:
            load(scenario(tmp_path, "device.toml", use_of(name)), adapters={})
        except ScenarioError as error:
            return [problem.text for problem in error.problems]
        return []

    head = next(k for k, line in enumerate(lines) if line.startswith("["))
    kind = [k for k in wrong if lines[k].startswith("kind")]  # which decides what the others mean
    alone = list(kind)
    for group in ([k for k in wrong if k < head and k not in kind], [k for k in wrong if k > head]):
        unknown = Counter(text.partition('"')[2].partition('"')[0] for text in told(group))
        meant = {k: wrong[k].rpartition(".")[2] for k in group}
        alone += [k for k in group if unknown[meant[k]] < list(meant.values()).count(meant[k])]
    assert [lines[k] for k in alone if not told([k])] == []


def spread(name: str, distance: float, n: int = 1500) -> np.ndarray:
    """(n, fields) of readings of a beacon straight below a device at a distance (m), without reflections, fading and misalignment."""
    keys = check_profile(read(DEVICES[name]).raw, lambda *problem: pytest.fail(str(problem)))
    calm = {"fading_sigma_db": 0.0, "multipath_probability": 0.0, "propagation": "straight", "rate_hz": 1.0}
    beacons = {"a": {"position_ned_m": [0.0, 0.0, 5.0 + distance]}}
    kind = {"lbl": LblConfig, "usbl": UsblConfig}[keys.pop("kind")]
    keys.pop("misalignment_rpy_deg", None)
    device = msgspec.convert({**keys, **calm, "beacons": beacons}, kind).build(Pose())
    water = Water(1025.0, 9.81, 10.0, 101_325.0, (0.0, 0.0, 0.0))
    instant = Scope(0, (0.0, 0.0, 5.0), (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, water)
    found = []
    for _ in range(n):
        device.memory.ready = 0.0
        valid, values = device.measure(instant)
        assert valid
        found.append([values[1], *(values[4][:2] if kind is UsblConfig else ())])
    return np.array(found)


def at_snr(name: str, snr_db: float) -> float:
    """Distance (m) at which the device has this signal over noise."""
    from scipy import optimize

    keys = check_profile(read(DEVICES[name]).raw, lambda *problem: pytest.fail(str(problem)))
    water = Water(1025.0, 9.81, 10.0, 101_325.0, (0.0, 0.0, 0.0))
    alpha = lambda r: np.mean([water.absorption(keys["frequency_hz"], 5.0 + k * r / 200) for k in range(201)])  # noqa: E731
    excess = lambda r: (  # noqa: E731
        keys["source_level_db"] - 20.0 * math.log10(r) - alpha(r) * r - keys["noise_level_db"] - 10.0 * math.log10(keys["bandwidth_hz"]) - snr_db
    )  # fmt: skip
    return optimize.brentq(excess, 1.0, 1e5)


def test_a_hipap_101_has_the_errors_of_its_data_sheet():
    """At 20 dB: 0.14 degrees across, 0.02 m along; within 6 %."""
    distance = at_snr("hipap_101", 20.0)
    reach, x, y = spread("hipap_101", distance).T
    assert reach.std() == pytest.approx(0.02, rel=0.06)
    for across in (x, y):  # over the range as measured: so far down sound is faster than the device takes it
        assert np.degrees(across / reach).std() == pytest.approx(0.14, rel=0.06)


def test_a_gaps_m7_has_the_error_of_its_data_sheet():
    """At 20 dB half of the positions lie within 0.1 % of the slant range."""
    distance = at_snr("gaps_m7", 20.0)
    _, x, y = spread("gaps_m7", distance).T
    assert np.median(np.hypot(x, y)) / distance == pytest.approx(0.001, rel=0.06)


def test_an_lbl_has_the_errors_of_its_data_sheet():
    """HiPAP at 20 dB: 0.02 m for each of the two receptions; their mean and the transponder's movement. ROVNav 6+: better than 15 mm."""
    (reach,) = spread("hipap_501_lbl", at_snr("hipap_501_lbl", 20.0)).T
    assert reach.std() == pytest.approx(math.hypot(0.02 / math.sqrt(2.0), 0.01), rel=0.1)
    (reach,) = spread("rovnav_6", 500.0).T
    assert 0.005 < reach.std() < 0.016


def test_parts_of_one_table_add_up_and_the_user_has_the_last_word(tmp_path):
    path = scenario(tmp_path, "tactical_imu")
    path.write_text(path.read_text() + "gyroscope.turn_on = 0.5\n")
    config = load(path, adapters={}).vehicles["rov"].vehicle.sensors["device"]
    assert config.gyroscope.turn_on == 0.5
    assert config.gyroscope.noise_density == pytest.approx(4.36e-5)
    assert config.gyroscope.instability_tau_s == 320.0


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('kind = "gps"\nrate_hz = 8', "origin_lat_deg"),
        ('kind = "magnetometer"\nrate_hz = 8', "origin_lat_deg"),
        ('kind = "rpm"\nrate_hz = 8\nmembers = ["t9"]', 'no thruster "t9"'),
        ('kind = "compound"\nrate_hz = 8\nmembers = ["imo"]', 'did you mean "imu"'),
        ('kind = "compound"\nrate_hz = 8\nmembers = ["imu", "imu"]', "named twice"),
    ],
)
def test_what_a_sensor_lacks_is_told_at_its_place(table, said, tmp_path):
    path = tmp_path / "x.toml"
    path.write_text(f'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\n[vehicles.rov.sensors.device]\n{table}\n')
    with pytest.raises(ScenarioError, match=said) as refused:
        load(path, adapters={})
    assert "vehicles.rov.sensors.device" in str(refused.value)

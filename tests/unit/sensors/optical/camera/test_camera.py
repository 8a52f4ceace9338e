"""Cameras in a world: pictures in time, exposure that follows the light, lamps and tilt, pairs, and states that go on bit for bit.

Also of uwserver.sensors.optical.camera.kernels.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwserver.ports import Buffer
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.sensors.job import whole
from uwserver.world import World
from uwserver.world.state import snapshot

SCENARIO = """schema = 1
seed = 5

[world]
rate_hz = 240

[environment]
water_type = "{water}"
daylight = {{ illuminance_lux = {lux} }}

[seabed]
kind = "flat"
depth_m = 8.0
material = "sand"

[structures.box]
kind = "box"
size_m = [1.0, 1.0, 1.0]
position_ned_m = [3.0, 0.0, 5.0]

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]

[vehicles.rov.sensors.cam]
kind = "camera"
rate_hz = 10
mount = "camera"
{keys}
"""


def make(folder: Path, keys: str = "", lux: float = 40_000.0, water: str = "II") -> World:
    path = folder / "pool.toml"
    keys = keys if "width" in keys else f"width = 64\nheight = 48\n{keys}"
    keys = keys if "latency" in keys else f"latency_s = 0.0\n{keys}"
    path.write_text(SCENARIO.format(keys=keys, lux=lux, water=water), encoding="utf-8")
    return build(load(path, adapters={}))


def pictures(world: World, ticks: int, port: str = "rov/cam") -> list[Any]:
    return [sample for _ in range(ticks) for sample in world.step() if sample.port == port]


def test_pictures_come_at_the_end_of_the_read_out(tmp_path: Path) -> None:
    world = make(tmp_path, "auto_exposure = false\nexposure_s = 0.004\nread_out_s = 0.02\nlatency_s = 0.1")
    first, second = pictures(world, 90)[:2]
    assert (first.valid, first.value[0].shape, first.value[0].dtype) == (True, (48, 64, 3), "uint8")
    assert first.value[1:] == (0.004, 0.0)
    assert second.t_ns - first.t_ns == 100_000_000
    assert first.t_sent_ns - first.t_ns == 122_000_000


@pytest.mark.parametrize("lux", [60_000.0, 600.0])
def test_exposure_follows_the_light(tmp_path: Path, lux: float) -> None:
    samples = pictures(make(tmp_path, "exposure_s = 0.09", lux), 600)
    levels = [np.percentile(sample.value[0].array().max(axis=2), 97) for sample in samples]
    # 0.7 of full scale is 217 in sRGB.
    assert levels[-1] == pytest.approx(217, abs=12)
    assert levels[0] > 40
    assert samples[-1].value[1] < 0.09 or lux < 1000.0


@pytest.mark.parametrize("mode", ["rgb", pytest.param("mono", marks=pytest.mark.slow), "depth", "segmentation"])
def test_a_picture_is_the_same_bits_where_another_camera_works_between_its_pieces(tmp_path: Path, mode: str) -> None:
    world = make(tmp_path, f'mode = "{mode}"\nwidth = 640\nheight = 160\nsnow_pm3 = 50.0\nbaseline_m = 0.2')
    world.command("rov/lights", levels=(1.0, 1.0))
    world.step(2)
    left, right = (
        world.sensors[path].sensor.sense(world.sensor_arrays.scopes(world.t_ns, False)(world.vehicles["rov"].row, None))
        for path in ("rov/cam", "rov/cam/right")
    )
    assert left.job.shared is not right.job.shared
    alone = [part.array().tobytes() for part in left.job.run() if isinstance(part, Buffer)]
    pauses: list[object] = []
    split = whole(left.job.pieces(), lambda: pauses.append(right.job.run()))
    assert [part.array().tobytes() for part in split if isinstance(part, Buffer)] == alone
    assert len(pauses) >= 4


@pytest.mark.parametrize(("keys", "way"), [("", 0.04), ("rolling_shutter = false", 0.0)])
def test_rows_are_read_from_above_down_while_the_vehicle_goes_on(tmp_path: Path, keys: str, way: float) -> None:
    """At 2 m/s to the right, with 20 ms from the first row to the last, and the stamp in the middle."""
    world = make(tmp_path, f"read_out_s = 0.02\n{keys}")
    world.step(1)
    scope = world.sensor_arrays.scopes(world.t_ns, False)(world.vehicles["rov"].row, None)
    moving = replace(scope, q_NB=(1.0, 0.0, 0.0, 0.0), v_NB_B=(0.0, 2.0, 0.0), w_NB_B=(0.0, 0.0, 0.0))
    camera = world.sensors["rov/cam"].sensor
    view = camera.sense(moving).job.view
    middle = moving.position(camera._mount.p)[1]
    assert view.first.p[1] == pytest.approx(middle - 0.5 * way, abs=1e-12)
    assert view.last.p[1] == pytest.approx(middle + 0.5 * way, abs=1e-12)


def test_settings_stop_the_automatic(tmp_path: Path) -> None:
    world = make(tmp_path)
    pictures(world, 100)
    world.sensors["rov/cam"].sensor.change({"exposure": 0.002, "gain": 6.0, "auto_exposure": False})
    assert pictures(world, 60)[-1].value[1:] == (0.002, 6.0)


def test_lamps_light_the_picture_as_their_actuator_has_them(tmp_path: Path) -> None:
    world = make(tmp_path, "auto_exposure = false\nexposure_s = 0.09\ngain_db = 20", lux=0.0)
    dark = pictures(world, 60)[-1].value[0].array()
    world.command("rov/lights", levels=(1.0, 0.5))
    bright = pictures(world, 60)[-1].value[0].array()
    assert dark.max() < 30 < 90 < bright.max()
    # The left one is brighter.
    assert bright[20:30, :20].mean() > bright[20:30, -20:].mean()


def test_the_mount_tilts_at_its_rate(tmp_path: Path) -> None:
    world = make(tmp_path, 'mode = "depth"')

    def rows(samples: list[Any]) -> list[float]:
        """First row of each picture that sees the box, whose middle is ahead."""
        return [float(np.argmax(s.value[0].array()[:, 32] > 0)) for s in samples]

    before = rows(pictures(world, 60))[-1]
    world.command("rov/camera_tilt", tilt=0.5)
    after = rows(pictures(world, 240))
    assert after[0] < after[-1]
    assert after[-1] > before + 10
    assert after[-1] == after[-2]
    # 60 degrees a second: half a radian takes five pictures.
    assert 0.0 < world.sensors["rov/cam"].sensor.memory.tilt == pytest.approx(0.5)


def test_a_pair_sees_from_two_places_at_one_instant(tmp_path: Path) -> None:
    world = make(tmp_path, 'mode = "depth"\nbaseline_m = 0.3\nwidth = 640\nheight = 480')
    samples = [sample for _ in range(60) for sample in world.step() if sample.port.startswith("rov/cam")]
    left, right = samples[0], samples[1]
    assert {left.port, right.port} == {"rov/cam", "rov/cam/right"}
    assert left.t_ns == right.t_ns
    near = [s.value[0].array()[200] for s in sorted((left, right), key=lambda s: s.port)]
    edges = [int(np.argmax((row > 2000) & (row < 2600))) for row in near]
    z = float(near[0][near[0] > 0].min()) / 1e3
    focal = 0.5 * 639 / np.tan(np.radians(40.0))
    assert edges[0] - edges[1] == pytest.approx(focal * 0.3 / z, abs=1.5)


def test_segmentation_names_what_it_shows(tmp_path: Path) -> None:
    sample = pictures(make(tmp_path, 'mode = "segmentation"'), 60)[-1]
    ids, names, shares = sample.value
    table = dict(pair.split(":") for pair in names.split(","))
    assert {"seabed", "box"} <= set(table.values())
    rows = {table[str(int(k))]: (pixels, share) for k, pixels, share in shares.array().tolist()}
    assert rows["box"][1] == 1.0
    assert rows["seabed"][1] < 1.0
    assert rows["box"][0] == np.count_nonzero(ids.array() == int(next(k for k, name in table.items() if name == "box")))


def test_a_restore_goes_on_bit_for_bit(tmp_path: Path) -> None:
    world = make(tmp_path)
    pictures(world, 130)
    kept = snapshot.take(world)
    going = [sample.value for sample in pictures(world, 120)]
    snapshot.restore(world, kept)
    assert [sample.value for sample in pictures(world, 120)] == going
    other = make(tmp_path)
    assert [sample.value for sample in pictures(other, 250)][-4:] == going[-4:]


def test_two_worlds_of_one_seed_and_of_another(tmp_path: Path) -> None:
    one, two = (pictures(make(tmp_path), 60)[-1].value[0] for _ in range(2))
    assert one == two
    path = tmp_path / "pool.toml"
    other = pictures(build(load(path, adapters={}), seed=6), 60)[-1].value[0]
    assert other != one
    assert np.abs(other.array().astype(int) - one.array()).mean() < 10.0


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ("field_of_view_deg = 0.0", "field_of_view_deg"),
        ("field_of_view_deg = 1000.0", "field_of_view_deg"),
        ("field_of_view_deg = 179.0", "fisheye"),
        ("width = 0", "width"),
        ('mode = "x-ray"', "mode"),
    ],
)
def test_absurd_cameras_are_refused_with_the_key(tmp_path: Path, keys: str, text: str) -> None:
    with pytest.raises(ScenarioError, match=text):
        make(tmp_path, keys)

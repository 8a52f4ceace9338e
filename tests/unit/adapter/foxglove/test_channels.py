"""What a world says in Foxglove's messages, from samples, states and events."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
import pytest

from uwserver.adapter.foxglove import Foreign, SceneChannels, shown_as
from uwserver.adapter.foxglove import channels as channels_module
from uwserver.frames import attitude_enu_flu, multiply, rotate
from uwserver.ports import (
    BeamView,
    BodyView,
    Buffer,
    EntityList,
    Event,
    Field,
    Layout,
    Port,
    Present,
    Sample,
    SceneState,
    SceneView,
    SensorView,
    ShapeView,
    WaterView,
)

LEVEL = (1.0, 0.0, 0.0, 0.0)
BEAMS = tuple(BeamView((math.cos(a), math.sin(a), 0.0)) for a in (-0.5, 0.0, 0.5))
SENSORS = (
    SensorView("rov/gps", "gps", (0.0, 0.0, -1.0), LEVEL, message="NavSatFix"),
    SensorView("rov/lasers", "range_array", (0.5, 0.0, 0.0), LEVEL, BEAMS, message="LaserScan"),
    SensorView("rov/sonar", "scanning_sonar", (0.0, 0.0, 0.2), LEVEL, message="SonarPing"),
    SensorView("rov/profiler", "profiler", (0.0, 0.0, 0.2), LEVEL, message="SonarProfile"),
    SensorView("rov/swath", "bathymetry", (0.0, 0.0, 0.2), LEVEL, message="Bathymetry"),
    SensorView("rov/side", "side_scan", (0.0, 0.0, 0.2), LEVEL, message="SideScan"),
    SensorView("rov/camera", "camera", (0.3, 0.0, 0.0), LEVEL, message="Image"),
    SensorView("rov/imu", "imu", (0.0, 0.0, 0.0), LEVEL, message="Imu"),
)
ENTITIES = EntityList(1, (Present("rov", "rov"),), (Present("crate", "crate"),))
WATER = WaterView(1025.0, 1500.0, (), 0.0, (0, 0, 0), (), "II", (0, 0, 0), (0, 0, 0))
GPS = Port(
    "rov/gps", "sensor", "gps",
    tuple(Field(n, "1", "") for n in ("latitude", "longitude", "height", "horizontal_accuracy", "vertical_accuracy")), "", message="NavSatFix",
)  # fmt: skip
LASERS = Port("rov/lasers", "sensor", "range_array", (Field("ranges", "m", "", "", (3,)),), "", message="LaserScan")
SONAR = Port(
    "rov/sonar", "sensor", "scanning_sonar",
    (Field("head_angle", "rad", ""), Field("range", "m", ""), Field("bins", "1", "", "", (4,), "int")), "", message="SonarPing",
)  # fmt: skip
PROFILER = Port(
    "rov/profiler",
    "sensor",
    "profiler",
    tuple(Field(name, "1", "") for name in ("head_angle", "range", "level")),
    "",
    message="SonarProfile",
)
SWATH = Port(
    "rov/swath", "sensor", "bathymetry",
    tuple(Field(name, "1", "", type="buffer", buffer=Layout("float32", (3,))) for name in ("angle", "range", "level")), "", message="Bathymetry",
)  # fmt: skip


CAMERA = Port(
    "rov/camera/noisy", "sensor", "camera",
    (Field("gain", "dB", ""), Field("image", "1", "", type="buffer", buffer=Layout("uint8", (-1, -1, 3)))), "", message="Image",
)  # fmt: skip


@pytest.fixture
def channels() -> SceneChannels:
    found = SceneChannels({}.__getitem__, {}.__getitem__)
    found.scene(view(), 0)
    return found


def view() -> SceneView:
    rov = BodyView("rov", "x", "rov", (ShapeView("sphere", radius=1.0),), sensors=SENSORS)
    crate = BodyView("crate", "object", "crate", (ShapeView("box", size=(1.0, 1.0, 1.0)),))
    return SceneView(1, 1, "s", "t", "", 240.0, None, WATER, None, (), (rov,), (crate,), (), {})


def decoded(message: Foreign) -> Any:
    name = message.schema.removeprefix("foxglove.")
    return getattr(pytest.importorskip(f"foxglove_schemas_protobuf.{name}_pb2"), name).FromString(message.data)


def test_the_scene_has_an_entity_for_each_body() -> None:
    message = SceneChannels({}.__getitem__, {}.__getitem__).scene(view(), 7)
    assert (message.topic, message.t_ns) == ("/scene", 7)
    assert [(e.id, e.frame_id) for e in decoded(message).entities] == [("rov", "rov"), ("crate", "crate")]


def test_frames_form_one_tree_with_z_up_at_its_root(channels: SceneChannels) -> None:
    q_NB = (0.5, 0.5, 0.5, -0.5)
    poses = np.array([[1.0, 2.0, 3.0, *q_NB], [4.0, 5.0, 6.0, *LEVEL]])
    tf, pose = channels.state(SceneState(ENTITIES, 99, poses, np.zeros(0, np.int8), (0, 0, 0)))
    transforms = {t.child_frame_id: t for t in decoded(tf).transforms}
    parents = {child: t.parent_frame_id for child, t in transforms.items()}
    assert parents == {
        "N": "N_enu",
        "rov": "N",
        "crate": "N",
        "rov/gps": "rov",
        "rov/lasers": "rov",
        "rov/sonar": "rov",
        "rov/profiler": "rov",
        "rov/swath": "rov",
        "rov/side": "rov",
        "rov/camera": "rov",
    }
    root = transforms["N"].rotation
    q = (root.w, root.x, root.y, root.z)
    np.testing.assert_allclose(
        rotate(q, (1.0, 2.0, 3.0)), (2.0, 1.0, -3.0), atol=1e-12
    )  # north, east, down to east, north, up
    mine = transforms["rov"].rotation
    flu = multiply(multiply(q, (mine.w, mine.x, mine.y, mine.z)), (0.0, 1.0, 0.0, 0.0))
    theirs = attitude_enu_flu(q_NB)
    assert abs(sum(a * b for a, b in zip(flu, theirs, strict=True))) == pytest.approx(1.0)
    assert pose.topic == "/rov/pose"
    assert decoded(pose).pose.position.z == 3.0


def test_a_fix_a_scan_and_a_ping(channels: SceneChannels) -> None:
    fix = channels.sample(GPS, Sample("rov/gps", 0, 5, 9, True, (1.0, 0.5, 2.0, 3.0, 4.0)))
    assert fix is not None
    assert (fix.topic, fix.t_ns) == ("/rov/gps", 9)
    assert decoded(fix).latitude == pytest.approx(math.degrees(1.0))
    assert decoded(fix).timestamp.nanos == 5
    scan = channels.sample(LASERS, Sample("rov/lasers", 0, 5, 9, True, ((1.0, None, 3.0),)))
    assert scan is not None
    assert list(decoded(scan).ranges) == [1.0, math.inf, 3.0]
    assert decoded(scan).start_angle == pytest.approx(-0.5)
    ping = channels.sample(SONAR, Sample("rov/sonar", 0, 5, 9, True, (math.pi / 2, 8.0, (0, 10, 0, 20))))
    assert ping is not None
    points = np.frombuffer(decoded(ping).data, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(points, [[0, 3, 0, 10], [0, 7, 0, 20]], atol=1e-6)


def test_soundings_are_points_of_the_sensor(channels: SceneChannels) -> None:
    assert (shown_as(PROFILER), shown_as(SWATH)) == ("foxglove.PointCloud", "foxglove.PointCloud")
    ping = channels.sample(PROFILER, Sample("rov/profiler", 0, 5, 9, True, (math.pi / 2, 8.0, 120.0)))
    assert ping is not None
    points = np.frombuffer(decoded(ping).data, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(points, [[0, 8, 0, 120]], atol=1e-6)  # the head turns from x towards y
    assert channels.sample(PROFILER, Sample("rov/profiler", 0, 5, 9, True, (0.5, None, None))) is None
    rows = ((-math.pi / 6, 0.0, math.pi / 6), (20.0, math.nan, 10.0), (110.0, math.nan, 109.0))
    buffers = tuple(Buffer.of(np.array(row, np.float32)) for row in rows)
    swath = channels.sample(SWATH, Sample("rov/swath", 0, 5, 9, True, buffers))
    assert swath is not None
    assert (decoded(swath).frame_id, swath.t_ns) == ("rov/swath", 9)
    points = np.frombuffer(decoded(swath).data, "<f4").reshape(-1, 4)
    deep = math.cos(math.pi / 6)
    np.testing.assert_allclose(points, [[0, -10, 20 * deep, 110], [0, 5, 10 * deep, 109]], rtol=1e-6)  # one had no echo
    assert channels.sample(SWATH, Sample("rov/swath", 0, 5, 9, True, (None, None, None))) is None


@pytest.mark.parametrize("output", ["counts", "complex"])
def test_both_sides_of_a_side_scan_lie_abreast(channels: SceneChannels, output: str) -> None:
    """Port to the left, nearest in the middle; of more bins than are shown the strongest of neighbours."""
    shape = (400,) if output == "counts" else (400, 2)
    layout = Layout("uint8" if output == "counts" else "float32", shape)
    fields = tuple(Field(name, "1", "", type="buffer", buffer=layout) for name in ("port", "starboard"))
    side = Port("rov/side", "sensor", "side_scan", (Field("range", "m", ""), *fields), "", message="SideScan")
    rows = np.zeros((2, *shape), layout.dtype)
    if output == "counts":
        rows[0, 399], rows[1, 10], rows[1, 11] = 7, 3, 9
    else:
        rows[0, 399], rows[1, 10], rows[1, 11] = (0.0, -7.0), (3.0, 0.0), (5.4, -7.2)
    assert shown_as(side) == "foxglove.PointCloud"
    told = channels.sample(side, Sample("rov/side", 0, 5, 9, True, (40.0, *(Buffer.of(row) for row in rows))))
    assert told is not None
    points = np.frombuffer(decoded(told).data, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(np.sort(points[:, 1]), points[:, 1])
    assert len(points) == 400
    heard = points[points[:, 3] > 0.0]
    np.testing.assert_allclose(heard, [[0, -39.9, 0, 7], [0, 1.1, 0, 9]], rtol=1e-6)
    assert channels.sample(side, Sample("rov/side", 0, 5, 9, True, (40.0, None, None))) is None


def test_a_ping_of_complex_echoes_has_their_amplitudes(channels: SceneChannels) -> None:
    bins = Field("bins", "Pa", "", type="buffer", buffer=Layout("float32", (2, 2)))
    port = Port("rov/sonar", "sensor", "scanning_sonar", (*SONAR.fields[:2], bins), "", message="SonarPing")
    waves = Buffer.of(np.array([(0.0, 0.0), (3.0, -4.0)], np.float32))
    ping = channels.sample(port, Sample("rov/sonar", 0, 5, 9, True, (0.0, 8.0, waves)))
    assert ping is not None
    points = np.frombuffer(decoded(ping).data, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(points, [[6, 0, 0, 5]], atol=1e-6)


def test_pictures_are_shown_as_jpeg(channels: SceneChannels, monkeypatch: pytest.MonkeyPatch) -> None:
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    assert shown_as(CAMERA) == "foxglove.CompressedImage"
    grey = Buffer.of(np.full((20, 30, 3), 90, np.uint8))
    told = channels.sample(CAMERA, Sample(CAMERA.path, 0, 5, 9, True, (0.0, grey)))
    assert told is not None
    assert (told.topic, told.schema, told.t_ns) == ("/rov/camera/noisy", "foxglove.CompressedImage", 9)
    picture = decoded(told)
    assert (picture.frame_id, picture.timestamp.nanos, picture.format) == ("rov/camera", 5, "jpeg")
    shown = np.asarray(image.open(io.BytesIO(picture.data)))
    assert shown.shape == (20, 30, 3)
    assert np.abs(shown.astype(int) - 90).max() <= 2
    assert channels.sample(CAMERA, Sample(CAMERA.path, 0, 5, 9, False, (None, None))) is None
    assert channels.sample(CAMERA, Sample(CAMERA.path, 0, 5, 9, True, (0.0, None))) is None
    monkeypatch.setattr(channels_module, "can_encode_jpeg", lambda: False)
    assert shown_as(CAMERA) is None


@pytest.mark.parametrize(
    "sample",
    [
        Sample("rov/gps", 0, 5, 9, False, (1.0, 0.5, 2.0, 3.0, 4.0)),
        Sample("rov/gps", 0, 5, 9, True, (None, 0.5, 2.0, 3.0, 4.0)),
    ],
)
def test_without_a_fix_nothing_is_told(channels: SceneChannels, sample: Sample) -> None:
    assert channels.sample(GPS, sample) is None


def test_others_have_no_message(channels: SceneChannels) -> None:
    imu = Port("rov/imu", "sensor", "imu", (Field("f_S", "1", ""),), "", message="Imu")
    assert channels.sample(imu, Sample("rov/imu", 0, 5, 9, True, (1.0,))) is None
    strange = Port("rov/strange", "sensor", "gps", GPS.fields, "", message="NavSatFix")
    assert (
        channels.sample(strange, Sample("rov/strange", 0, 5, 9, True, (1.0,) * 5)) is None
    )  # nobody says where it sits


def test_events_have_levels(channels: SceneChannels) -> None:
    line = decoded(channels.event(Event("fault", 1, 2, "it broke")))
    assert (line.level, line.message, line.name) == (line.WARNING, "it broke", "fault")
    assert decoded(channels.event(Event("paused", 1, 2, ""))).level == line.INFO

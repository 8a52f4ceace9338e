"""What a world has to say in Foxglove's messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from uwserver.adapter.foxglove import codec
from uwserver.adapter.foxglove.shapes import Files, entity_of
from uwserver.adapter.pictures import Levels, amplitudes, can_encode_jpeg, jpeg, picture_place, pixels
from uwserver.frames import Quat
from uwserver.ports import Buffer, Event, Port, Sample, SceneState, SceneView, SensorView

PICTURE = "foxglove.CompressedImage"
"""What pictures are shown as, which take a while to encode."""
ROOT, WORLD = "N_enu", "N"
_ABREAST = 256
"""Points of each side of a side-scan sonar: more than a picture of the way has across."""
_HALF = math.sqrt(0.5)
_NED_IN_ENU: Quat = (0.0, _HALF, _HALF, 0.0)
_LEVELS = {
    "fault": codec.WARNING, "watchdog": codec.WARNING, "conflict": codec.WARNING, "diverged": codec.ERROR,
    "adapter_failed": codec.ERROR,
}  # fmt: skip


class Foreign(NamedTuple):
    """A message: topic, full name of its schema, simulation time, bytes."""

    topic: str
    schema: str
    t_ns: int
    data: bytes


_Encode = Callable[[Sample], "Foreign | None"]


class SceneChannels:
    """Turns what happens in a world into messages. Keeps nothing but who is in it.

    Args:
        meshes: triangles by hash, as `uwserver.ports.MeshView` names them.
        looks: glTF files by hash.
    """

    def __init__(self, meshes: Files, looks: Files) -> None:
        self._meshes, self._looks = meshes, looks
        self._fixed = b""
        self._sensors: dict[str, SensorView] = {}
        self._encoders: dict[str, tuple[Port, _Encode | None]] = {}

    def scene(self, scene: SceneView, t_ns: int) -> Foreign:
        """All shapes, in place of those before; and from now on these sensors."""
        self._sensors = {sensor.path: sensor for body in scene.vehicles for sensor in body.sensors}
        self._encoders = {}
        shown = [sensor for sensor in self._sensors.values() if sensor.kind in _FRAMES or sensor.kind in _LOOKING]
        # Each message holds all frames: who jumps to a time reads the newest one alone.
        self._fixed = codec.transform(0, ROOT, WORLD, (0.0, 0.0, 0.0), _NED_IN_ENU) + b"".join(
            codec.transform(0, sensor.path.partition("/")[0], sensor.path, sensor.p, sensor.q) for sensor in shown
        )
        parts = [codec.delete_all(t_ns)]
        solids = ([] if scene.seabed is None else [scene.seabed]) + list(scene.structures)
        for solid in solids:
            parts.append(entity_of(t_ns, WORLD, solid.name, solid.shapes, solid.looks, self._meshes, self._looks))
        for body in (*scene.vehicles, *scene.objects):
            parts.append(entity_of(t_ns, body.name, body.name, body.shapes, body.looks, self._meshes, self._looks))
        return Foreign("/scene", "foxglove.SceneUpdate", t_ns, b"".join(parts))

    def state(self, state: SceneState) -> Iterator[Foreign]:
        """Frames of all bodies, and the pose of each vehicle."""
        t_ns, parts = state.t_ns, [self._fixed]
        vehicles = len(state.cast.vehicles)
        poses = []
        for k, (body, row) in enumerate(
            zip((*state.cast.vehicles, *state.cast.objects), state.poses.tolist(), strict=True)
        ):
            parts.append(codec.transform(t_ns, WORLD, body.name, row[:3], row[3:]))
            if k < vehicles:
                poses.append((body.name, row))
        yield Foreign("/tf", "foxglove.FrameTransforms", t_ns, b"".join(parts))
        for name, row in poses:
            yield Foreign(
                f"/{name}/pose", "foxglove.PoseInFrame", t_ns, codec.pose_in_frame(t_ns, WORLD, row[:3], row[3:])
            )

    def sample(self, port: Port, sample: Sample) -> Foreign | None:
        """A sample of a sensor that Foxglove has a message for; None of any other, and where it has nothing to show."""
        work = self.work(port, sample)
        return None if work is None else work()

    def shows(self, port: Port) -> bool:
        """Whether samples of a port have messages, when they show something."""
        return self._known(port) is not None

    def work(self, port: Port, sample: Sample) -> Callable[[], Foreign | None] | None:
        """What makes the message of a sample, on any thread; None where there is none."""
        encode = self._known(port)
        return partial(encode, sample) if encode is not None and sample.valid else None

    def _known(self, port: Port) -> _Encode | None:
        """What encodes samples of a port."""
        known = self._encoders.get(port.path)
        if known is None or known[0] is not port:
            known = self._encoders[port.path] = (port, self._encoder(port))
        return known[1]

    def event(self, event: Event) -> Foreign:
        """What every client is told."""
        level = _LEVELS.get(event.event, codec.INFO)
        return Foreign("/log", "foxglove.Log", event.t_ns, codec.log_line(event.t_ns, level, event.text, event.event))

    def _encoder(self, port: Port) -> _Encode | None:
        make = _FRAMES.get(port.kind) or (_picture if _shows_pictures(port) else None)
        # A second stream of a sensor sits where its sensor sits.
        sensor = self._sensors.get(port.path) or self._sensors.get("/".join(port.path.split("/")[:2]))
        return make(port, sensor) if make is not None and sensor is not None else None


def _gps(port: Port, sensor: SensorView) -> _Encode | None:
    names = [field.name for field in port.fields]
    try:
        latitude, longitude, height, across, up = (
            names.index(name)
            for name in ("latitude", "longitude", "height", "horizontal_accuracy", "vertical_accuracy")
        )
    except ValueError:
        return None
    topic, frame = f"/{port.path}", sensor.path

    def encode(sample: Sample) -> Foreign | None:
        value = sample.value
        place = value[latitude], value[longitude], value[height]
        if None in place:
            return None
        sigmas = (
            (value[across], value[across], value[up]) if value[across] is not None and value[up] is not None else None
        )
        data = codec.location_fix(sample.t_ns, frame, *place, sigmas)  # type: ignore[arg-type]  # numbers, as its fields say
        return Foreign(topic, "foxglove.LocationFix", sample.t_sent_ns, data)

    return encode


def _range_array(port: Port, sensor: SensorView) -> _Encode | None:
    index = next((k for k, field in enumerate(port.fields) if field.name == "ranges"), None)
    angles = [math.atan2(beam.direction[1], beam.direction[0]) for beam in sensor.beams]
    if index is None or not angles or len(angles) != port.fields[index].size:
        return None
    topic, frame, first, last = f"/{port.path}", sensor.path, angles[0], angles[-1]

    def encode(sample: Sample) -> Foreign | None:
        ranges = sample.value[index]
        told = [math.inf if r is None else r for r in (ranges if isinstance(ranges, tuple) else (ranges,))]
        data = codec.laser_scan(sample.t_ns, frame, first, last, told)  # type: ignore[arg-type]  # numbers, as its field says
        return Foreign(topic, "foxglove.LaserScan", sample.t_sent_ns, data)

    return encode


def _scanning_sonar(port: Port, sensor: SensorView) -> _Encode | None:
    names = [field.name for field in port.fields]
    try:
        angle, reach, bins = (names.index(name) for name in ("head_angle", "range", "bins"))
    except ValueError:
        return None
    topic, frame = f"/{port.path}", sensor.path

    def encode(sample: Sample) -> Foreign | None:
        theta, far, echoes = sample.value[angle], sample.value[reach], sample.value[bins]
        if not isinstance(theta, int | float) or not isinstance(far, int | float) or echoes is None:
            return None
        levels = amplitudes(echoes) if isinstance(echoes, Buffer) else np.array(echoes, dtype=np.float32)
        heard = np.flatnonzero(levels > 0.0)  # what is silent would only hide what is behind it
        points = np.zeros((len(heard), 4), dtype=np.float32)
        distance = (heard + 0.5) * (far / max(len(levels), 1))
        points[:, 0], points[:, 1], points[:, 3] = distance * math.cos(theta), distance * math.sin(theta), levels[heard]
        return Foreign(topic, "foxglove.PointCloud", sample.t_sent_ns, codec.point_cloud(sample.t_ns, frame, points))

    return encode


def _side_scan(port: Port, sensor: SensorView) -> _Encode | None:
    """Both rows abreast of the vehicle, by slant range: as the vehicle goes, a decay time makes a mosaic of them."""
    names = [field.name for field in port.fields]
    try:
        reach, port_side, starboard = (names.index(name) for name in ("range", "port", "starboard"))
    except ValueError:
        return None
    topic, frame = f"/{port.path}", sensor.path

    def encode(sample: Sample) -> Foreign | None:
        far, *rows = (sample.value[k] for k in (reach, port_side, starboard))
        sides = [_peaks(amplitudes(row), _ABREAST) for row in rows if isinstance(row, Buffer)]
        if len(sides) < 2 or not isinstance(far, int | float):
            return None
        count = len(sides[0])
        points = np.zeros((2 * count, 4), dtype=np.float32)
        across = (np.arange(count) + 0.5) * (far / max(count, 1))
        points[:, 1], points[:, 3] = np.concatenate([-across[::-1], across]), np.concatenate([sides[0][::-1], sides[1]])
        return Foreign(topic, "foxglove.PointCloud", sample.t_sent_ns, codec.point_cloud(sample.t_ns, frame, points))

    return encode


def _peaks(levels: Levels, most: int) -> Levels:
    """The largest of neighbours, so that at most so many are left."""
    each = -(-len(levels) // most)
    padded = np.pad(levels, (0, -len(levels) % max(each, 1)))
    peaks: Levels = padded.reshape(-1, max(each, 1)).max(axis=1)
    return peaks


def _profiler(port: Port, sensor: SensorView) -> _Encode | None:
    names = [field.name for field in port.fields]
    try:
        angle, reach, level = (names.index(name) for name in ("head_angle", "range", "level"))
    except ValueError:
        return None
    topic, frame = f"/{port.path}", sensor.path

    def encode(sample: Sample) -> Foreign | None:
        theta, r, strength = sample.value[angle], sample.value[reach], sample.value[level]
        if None in (theta, r, strength):
            return None
        point = np.array([(r * math.cos(theta), r * math.sin(theta), 0.0, strength)], np.float32)  # type: ignore[operator,arg-type]  # numbers, as its fields say
        return Foreign(topic, "foxglove.PointCloud", sample.t_sent_ns, codec.point_cloud(sample.t_ns, frame, point))

    return encode


def _bathymetry(port: Port, sensor: SensorView) -> _Encode | None:
    names = [field.name for field in port.fields]
    try:
        places = [names.index(name) for name in ("angle", "range", "level")]
    except ValueError:
        return None
    topic, frame = f"/{port.path}", sensor.path

    def encode(sample: Sample) -> Foreign | None:
        told = [value.array() for k in places if isinstance(value := sample.value[k], Buffer)]
        if len(told) < len(places):
            return None
        theta, r, level = (row[np.isfinite(told[1])] for row in told)
        points = np.stack([np.zeros_like(r), r * np.sin(theta), r * np.cos(theta), level], axis=1)
        return Foreign(topic, "foxglove.PointCloud", sample.t_sent_ns, codec.point_cloud(sample.t_ns, frame, points))

    return encode


def _shows_pictures(port: Port) -> bool:
    """Whether its pictures are shown, which takes a library for JPEG."""
    return picture_place(port) is not None and can_encode_jpeg()


def _picture(port: Port, sensor: SensorView) -> _Encode | None:
    place = picture_place(port)
    topic, frame = f"/{port.path}", sensor.path

    def encode(sample: Sample) -> Foreign | None:
        shown = pixels(sample.value[place]) if place is not None else None
        if shown is None:
            return None
        data = codec.compressed_image(sample.t_ns, frame, jpeg(shown))
        return Foreign(topic, PICTURE, sample.t_sent_ns, data)

    return encode


def shown_as(port: Port) -> str | None:
    """Full name of the message in which the samples of a port are shown under its path; None of most."""
    if port.direction != "sensor":
        return None
    return _SCHEMA_OF.get(port.kind) or (PICTURE if _shows_pictures(port) else None)


_SCHEMA_OF = {
    "bathymetry": "foxglove.PointCloud",
    "gps": "foxglove.LocationFix",
    "profiler": "foxglove.PointCloud",
    "range_array": "foxglove.LaserScan",
    "scanning_sonar": "foxglove.PointCloud",
    "side_scan": "foxglove.PointCloud",
}
_FRAMES: dict[str, Callable[[Port, SensorView], _Encode | None]] = {
    "bathymetry": _bathymetry,
    "gps": _gps,
    "profiler": _profiler,
    "range_array": _range_array,
    "scanning_sonar": _scanning_sonar,
    "side_scan": _side_scan,
}
"""Kinds of sensors that have a message, and so a frame; ports with pictures have one too, whatever their kind."""
_LOOKING = frozenset({"camera", "multibeam"})
"""Kinds whose pictures are seen from a frame of their own."""

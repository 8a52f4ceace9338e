"""Turns scenes, states, samples and events into Foxglove's messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from uwserver.adapter.foxglove import codec
from uwserver.adapter.foxglove.shapes import Files, entity_of
from uwserver.adapter.pictures import Levels, amplitudes, can_encode_jpeg, jpeg, picture_place, pixels
from uwserver.frames import Quat
from uwserver.ports import Buffer, Event, Port, Sample, SceneState, SceneView, SensorView

PICTURE = "foxglove.CompressedImage"
"""The message of pictures, which takes a while to encode."""
ROOT, WORLD = "N_enu", "N"
_ABREAST = 256
"""Points of each side of a side-scan sonar, more than a picture of its track has across."""
_HALF = math.sqrt(0.5)
_NED_IN_ENU: Quat = (0.0, _HALF, _HALF, 0.0)
_LEVELS = {
    "fault": codec.WARNING, "watchdog": codec.WARNING, "conflict": codec.WARNING, "diverged": codec.ERROR,
    "adapter_failed": codec.ERROR,
}  # fmt: skip


class Foreign(NamedTuple):
    """A message for a viewer.

    Attributes:
        topic: the topic.
        schema: full name of its schema.
        t_ns: simulation time.
        data: the encoded message.
    """

    topic: str
    schema: str
    t_ns: int
    data: bytes


_Encode = Callable[[Sample], "Foreign | None"]


class _Shown(NamedTuple):
    """How samples that fit one standard message are shown.

    Attributes:
        schema: full name of the message.
        fields: names of the fields that it is made of; a port without one of them is not shown.
        encode: makes the message of the time (ns), the sensor and the values of these fields; gives None where there is nothing to show.
    """

    schema: str
    fields: tuple[str, ...]
    encode: Callable[..., bytes | None]


class SceneChannels:
    """Turns what happens in a world into messages. It remembers only which bodies and sensors there are.

    Args:
        meshes: triangles by hash, as `uwserver.ports.MeshView` names them.
        model_files: glTF files by hash.
    """

    def __init__(self, meshes: Files, model_files: Files) -> None:
        self._meshes, self._model_files = meshes, model_files
        self._fixed = b""
        self._sensors: dict[str, SensorView] = {}
        self._encoders: dict[str, tuple[Port, _Encode | None]] = {}

    def scene(self, scene: SceneView, t_ns: int) -> Foreign:
        """Return all shapes, which replace earlier ones, and take over the sensors of this scene."""
        self._sensors = {sensor.path: sensor for body in scene.vehicles for sensor in body.sensors}
        self._encoders = {}
        # Each message of transforms holds all frames, because a viewer that jumps to a time reads only the newest message.
        self._fixed = codec.transform(0, ROOT, WORLD, (0.0, 0.0, 0.0), _NED_IN_ENU) + b"".join(
            codec.transform(0, sensor.path.partition("/")[0], sensor.path, sensor.p, sensor.q)
            for sensor in self._sensors.values()
            if sensor.message in _SHOWN or sensor.message in _PICTURED
        )
        solids = ([] if scene.seabed is None else [scene.seabed]) + list(scene.structures)
        framed = [(WORLD, solid) for solid in solids] + [
            (body.name, body) for body in (*scene.vehicles, *scene.objects)
        ]
        entities = (
            entity_of(t_ns, frame, thing.name, thing.shapes, thing.looks, self._meshes, self._model_files)
            for frame, thing in framed
        )
        return Foreign("/scene", "foxglove.SceneUpdate", t_ns, b"".join((codec.delete_all(t_ns), *entities)))

    def state(self, state: SceneState) -> Iterator[Foreign]:
        """Yield the frames of all bodies, and the pose of each vehicle."""
        t_ns, bodies = state.t_ns, (*state.entities.vehicles, *state.entities.objects)
        rows = list(zip(bodies, state.poses.tolist(), strict=True))
        frames = (codec.transform(t_ns, WORLD, body.name, row[:3], row[3:]) for body, row in rows)
        yield Foreign("/tf", "foxglove.FrameTransforms", t_ns, b"".join((self._fixed, *frames)))
        for body, row in rows[: len(state.entities.vehicles)]:
            data = codec.pose_in_frame(t_ns, WORLD, row[:3], row[3:])
            yield Foreign(f"/{body.name}/pose", "foxglove.PoseInFrame", t_ns, data)

    def sample(self, port: Port, sample: Sample) -> Foreign | None:
        """Return the message of a sample, or None if its sensor has no message or there is nothing to show."""
        work = self.work(port, sample)
        return None if work is None else work()

    def shows(self, port: Port) -> bool:
        """Tell whether the samples of a port have messages, if they show something."""
        return self._encoder(port) is not None

    def work(self, port: Port, sample: Sample) -> Callable[[], Foreign | None] | None:
        """Return a function that makes the message of a sample, on any thread; None if there is no message."""
        encode = self._encoder(port)
        return partial(encode, sample) if encode is not None and sample.valid else None

    def event(self, event: Event) -> Foreign:
        """Return the log line of an event."""
        level = _LEVELS.get(event.event, codec.INFO)
        return Foreign("/log", "foxglove.Log", event.t_ns, codec.log_line(event.t_ns, level, event.text, event.event))

    def _encoder(self, port: Port) -> _Encode | None:
        """Return what encodes the samples of a port."""
        known = self._encoders.get(port.path)
        if known is None or known[0] is not port:
            # A second stream of a sensor has the frame of its sensor.
            sensor = self._sensors.get(port.path) or self._sensors.get("/".join(port.path.split("/")[:2]))
            shown = _shown(port)
            encode = None if sensor is None or shown is None else _encoder_of(shown, port, sensor)
            known = self._encoders[port.path] = (port, encode)
        return known[1]


def _encoder_of(shown: _Shown, port: Port, sensor: SensorView) -> _Encode | None:
    names = [field.name for field in port.fields]
    if not set(shown.fields) <= set(names):
        return None
    places = [names.index(name) for name in shown.fields]

    def encode(sample: Sample) -> Foreign | None:
        data = shown.encode(sample.t_ns, sensor, *(sample.value[place] for place in places))
        return None if data is None else Foreign(f"/{port.path}", shown.schema, sample.t_sent_ns, data)

    return encode


# The values of fields are numbers, arrays and buffers as the sensors' fields say, or None.


def _gps(
    t_ns: int, sensor: SensorView, latitude: Any, longitude: Any, height: Any, across: Any, up: Any
) -> bytes | None:
    if None in (latitude, longitude, height):
        return None
    sigmas = None if None in (across, up) else (across, across, up)
    return codec.location_fix(t_ns, sensor.path, latitude, longitude, height, sigmas)


def _range_array(t_ns: int, sensor: SensorView, ranges: Any) -> bytes | None:
    distances = [math.inf if r is None else r for r in (ranges if isinstance(ranges, tuple) else (ranges,))]
    if len(distances) != len(sensor.beams):
        return None
    ends = (sensor.beams[0].direction, sensor.beams[-1].direction)
    first, last = (math.atan2(y, x) for x, y, _ in ends)
    return codec.laser_scan(t_ns, sensor.path, first, last, distances)


def _scanning_sonar(t_ns: int, sensor: SensorView, theta: Any, far: Any, echoes: Any) -> bytes | None:
    if None in (theta, far, echoes):
        return None
    levels = amplitudes(echoes) if isinstance(echoes, Buffer) else np.array(echoes, dtype=np.float32)
    # Silent bins would only hide what is behind them.
    heard = np.flatnonzero(levels > 0.0)
    points = np.zeros((len(heard), 4), dtype=np.float32)
    distance = (heard + 0.5) * (far / max(len(levels), 1))
    points[:, 0], points[:, 1], points[:, 3] = distance * math.cos(theta), distance * math.sin(theta), levels[heard]
    return codec.point_cloud(t_ns, sensor.path, points)


def _side_scan(t_ns: int, sensor: SensorView, far: Any, port_side: Any, starboard: Any) -> bytes | None:
    """Show both rows abreast of the vehicle, by slant range. A decay time in the viewer makes a mosaic of them as the vehicle moves."""
    if None in (far, port_side, starboard):
        return None
    left, right = (_peaks(amplitudes(row), _ABREAST) for row in (port_side, starboard))
    points = np.zeros((2 * len(left), 4), dtype=np.float32)
    across = (np.arange(len(left)) + 0.5) * (far / max(len(left), 1))
    points[:, 1], points[:, 3] = np.concatenate([-across[::-1], across]), np.concatenate([left[::-1], right])
    return codec.point_cloud(t_ns, sensor.path, points)


def _peaks(levels: Levels, most: int) -> Levels:
    """Return the largest level of each group of neighbours, in at most `most` groups."""
    each = max(-(-len(levels) // most), 1)
    peaks: Levels = np.pad(levels, (0, -len(levels) % each)).reshape(-1, each).max(axis=1)
    return peaks


def _profiler(t_ns: int, sensor: SensorView, theta: Any, r: Any, level: Any) -> bytes | None:
    if None in (theta, r, level):
        return None
    point = np.array([(r * math.cos(theta), r * math.sin(theta), 0.0, level)], np.float32)
    return codec.point_cloud(t_ns, sensor.path, point)


def _bathymetry(t_ns: int, sensor: SensorView, *rows: Any) -> bytes | None:
    if None in rows:
        return None
    angles, ranges, levels = (row.array() for row in rows)
    heard = np.isfinite(ranges)
    theta, r, level = angles[heard], ranges[heard], levels[heard]
    points = np.stack([np.zeros_like(r), r * np.sin(theta), r * np.cos(theta), level], axis=1)
    return codec.point_cloud(t_ns, sensor.path, points)


def _picture(t_ns: int, sensor: SensorView, picture: Any) -> bytes | None:
    image = pixels(picture)
    return None if image is None else codec.compressed_image(t_ns, sensor.path, jpeg(image))


_POINTS = "foxglove.PointCloud"
_SHOWN = {
    "Bathymetry": _Shown(_POINTS, ("angle", "range", "level"), _bathymetry),
    "NavSatFix": _Shown(
        "foxglove.LocationFix",
        ("latitude", "longitude", "height", "horizontal_accuracy", "vertical_accuracy"),
        _gps,
    ),
    "SonarProfile": _Shown(_POINTS, ("head_angle", "range", "level"), _profiler),
    "LaserScan": _Shown("foxglove.LaserScan", ("ranges",), _range_array),
    "SonarPing": _Shown(_POINTS, ("head_angle", "range", "bins"), _scanning_sonar),
    "SideScan": _Shown(_POINTS, ("range", "port", "starboard"), _side_scan),
}
"""By standard message. Ports with pictures are shown too, whatever their message."""
_PICTURED = frozenset({"Image", "SonarImage"})
"""Standard messages whose pictures need a frame of their own."""


def _shown(port: Port) -> _Shown | None:
    """Return how a port is shown. Pictures are shown only if a library for JPEG is installed."""
    known = _SHOWN.get(port.message or "")
    if known is not None:
        return known
    place = picture_place(port)
    return None if place is None or not can_encode_jpeg() else _Shown(PICTURE, (port.fields[place].name,), _picture)


def shown_as(port: Port) -> str | None:
    """Return the full name of the message in which the samples of a port are shown, under its path; None for most ports."""
    shown = _shown(port) if port.direction == "sensor" else None
    return shown and shown.schema

"""Acoustic sensors: DVL, altimeter, sonars, beacons."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from uwserver.ports import BeamView, Buffer, Sample, Value
from uwserver_adapters.ros.messages.frames import covariance, flu
from uwserver_adapters.ros.messages.source import Mount, Outlet, Source, is_whole, number, numbers, unknown

_ULTRASOUND = 0
_NO_BEAM = BeamView((0.0, 0.0, 0.0), 0.0, 0.0, math.inf)
_BOTTOM, _WATER = 1, 2
_NOT_MEASURED = 1e6


def dvl(source: Source) -> Iterator[Outlet]:
    """Dvl in the device's own axes (z where it points), one message for the bottom and one for the water; twist and altitude beside it."""
    get = source.bind("v_S", "altitude", "covariance_S", "beam_ranges", "beam_velocities", "beam_locks")
    water = source.bind("v_water_S") if source.has("v_water_S") else None

    def bottom(sample: Sample) -> object | None:
        v, altitude, spread, *beams = get(sample.value)
        if not (sample.valid and is_whole(v)):
            return None
        return _dvl(source, sample, _BOTTOM, v, altitude, spread, tuple(beams))

    def through_water(sample: Sample) -> object | None:
        assert water is not None
        v = water(sample.value)
        return _dvl(source, sample, _WATER, v, None, None, None) if is_whole(v) else None

    yield source.outlet("", _DVL, bottom)
    if water is not None:
        yield source.outlet("", _DVL, through_water)
    yield _twist(source)
    yield _altitude(source)


_DVL = "marine_acoustic_msgs/msg/Dvl"


def _dvl(
    source: Source, sample: Sample, mode: int, v: tuple[float, ...], altitude: Value,
    spread: tuple[float, ...] | None, beams: tuple[tuple[Value, ...], ...] | None,
) -> object:  # fmt: skip
    types = source.types
    views = source.mount.beams if source.mount is not None else ()
    units = [types.vector(view.direction) for view in (*views, *(_NO_BEAM,) * 4)[:4]]
    ranges, speeds, locks = beams or ((None,) * 4, (None,) * 4, (False,) * 4)
    whole = is_whole(spread) and spread is not None
    return types.make(
        _DVL, header=source.header(sample, source.frame + "_fsd"), velocity_mode=mode, velocity=types.vector(v),
        velocity_covar=np.array(spread) if whole else unknown(), altitude=number(altitude),
        course_gnd=math.atan2(v[1], v[0]), speed_gnd=math.hypot(v[0], v[1]), num_good_beams=sum(map(bool, locks)),
        sound_speed=math.nan, beam_ranges_valid=any(locks), beam_velocities_valid=any(locks), beam_unit_vec=units,
        range=_four(ranges), range_covar=np.full(4, -1.0, np.float32), beam_quality=np.array(_locks(locks), np.float32),
        beam_velocity=_four(speeds).astype(np.float32), beam_velocity_covar=np.full(4, -1.0, np.float32),
    )  # fmt: skip


def _four(values: tuple[Value, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Of devices with another number of beams the first four."""
    return numbers((*values, None, None, None, None)[:4])  # type: ignore[arg-type]


def _locks(locks: tuple[Value, ...]) -> list[bool]:
    return [bool(lock) for lock in (*locks, False, False, False, False)[:4]]


def _twist(source: Source) -> Outlet:
    types, get = source.types, source.bind("v_S", "covariance_S")

    def make(sample: Sample) -> object | None:
        v, spread = get(sample.value)
        if not (sample.valid and is_whole(v)):
            return None
        whole = np.zeros((6, 6))
        whole[3:, 3:] = np.eye(3) * _NOT_MEASURED
        if is_whole(spread):
            whole[:3, :3] = np.array(covariance(spread)).reshape(3, 3)
        twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(flu(v)))
        both = types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=whole.ravel())
        return types.make("geometry_msgs/msg/TwistWithCovarianceStamped", header=source.header(sample), twist=both)

    return source.outlet("/twist", "geometry_msgs/msg/TwistWithCovarianceStamped", make)


def _altitude(source: Source) -> Outlet:
    get = source.bind("altitude")
    beams = source.mount.beams if source.mount is not None else ()
    # Its beams stand about the axis: what they see is the bottom within this cone.
    cone = 2.0 * max((math.acos(max(-1.0, min(1.0, beam.direction[2]))) for beam in beams), default=0.0)
    reach = max((beam.far * beam.direction[2] for beam in beams), default=math.inf)
    near = min((beam.near for beam in beams), default=0.0)

    def make(sample: Sample) -> object | None:
        altitude = get(sample.value)
        return None if not sample.valid or altitude is None else _range(source, sample, altitude, cone, near, reach)

    return source.outlet("/altitude", "sensor_msgs/msg/Range", make)


def _range(source: Source, sample: Sample, distance: float, cone: float, near: float, far: float) -> object:
    (variance,) = source.variances("range", 1)
    return source.types.make(
        "sensor_msgs/msg/Range", header=source.header(sample, source.frame + "_beam"), radiation_type=_ULTRASOUND,
        field_of_view=cone, min_range=near, max_range=far, range=distance, variance=variance,
    )  # fmt: skip


def altimeter(source: Source) -> Iterator[Outlet]:
    """Range along x of the frame ``_beam``; without an echo it is +inf (REP-117)."""
    get = source.bind("range")
    beams = source.mount.beams if source.mount is not None else ()
    beam = beams[0] if beams else _NO_BEAM

    def make(sample: Sample) -> object | None:
        distance = get(sample.value)
        known = sample.valid and distance is not None
        return _range(source, sample, distance if known else math.inf, beam.width, beam.near, beam.far)

    yield source.outlet("", "sensor_msgs/msg/Range", make)


def scanning_sonar(source: Source) -> Iterator[Outlet]:
    """One ping is an image of one beam, in the frame ``_sonar`` (z ahead, x up)."""
    types, get = source.types, source.bind("head_angle", "range", "bins")
    counts = next(field for field in source.port.fields if field.name == "bins").type == "int"
    fan = (source.mount or Mount()).fan
    widths = (fan.horizontal, fan.vertical) if fan is not None else None
    along, across = (np.array([width] if width else [], np.float32) for width in widths or (0.0, 0.0))
    image_type, ping_type = "marine_acoustic_msgs/msg/SonarImageData", "marine_acoustic_msgs/msg/PingInfo"
    # The transmitter's width is vertical, the receiver's horizontal; a head that turns has both of one transducer.
    ping = types.make(ping_type, tx_beamwidths=across, rx_beamwidths=along)

    def make(sample: Sample) -> object | None:
        angle, reach, bins = get(sample.value)
        if not sample.valid or angle is None or reach is None or bins is None:
            return None
        if isinstance(bins, Buffer):
            return None  # complex: this message has no type for it
        levels = _levels(bins) if counts else numbers(bins).astype(np.float32)
        centres = ((np.arange(len(levels)) + 0.5) * (reach / max(len(levels), 1))).astype(np.float32)
        return types.make(
            "marine_acoustic_msgs/msg/ProjectedSonarImage", header=source.header(sample, source.frame + "_sonar"),
            ping_info=ping, beam_directions=[types.vector((0.0, math.sin(angle), math.cos(angle)))], ranges=centres,
            image=types.make(
                image_type, is_bigendian=False, dtype=_DTYPES[levels.dtype.name], beam_count=1, data=levels.view(np.uint8)
            ),
        )  # fmt: skip

    yield source.outlet("", "marine_acoustic_msgs/msg/ProjectedSonarImage", make)


_DTYPES = {"uint8": 0, "float32": 8}
_NONE = np.zeros(0, np.float32)
_RANGES = "marine_acoustic_msgs/msg/SonarRanges"
_DETECTIONS = "marine_acoustic_msgs/msg/SonarDetections"
Floats = np.ndarray[tuple[int], np.dtype[np.float32]]


def multibeam(source: Source) -> Iterator[Outlet]:
    """One ping is an image of all beams, in the frame ``_sonar`` (z ahead, x up); all beams of the first range stand first."""
    types, get = source.types, source.bind("range_start", "range", "frequency", "sound_speed", "azimuth", "image")
    fan = (source.mount or Mount()).fan
    widths = None if fan is None else (fan.vertical, fan.horizontal)

    def make(sample: Sample) -> object | None:
        near, far, frequency, speed, azimuth, image = get(sample.value)
        if not sample.valid or azimuth is None or image is None or len(image.shape) != 2 or image.dtype not in _DTYPES:
            return None
        angles, (rows, beams) = azimuth.array(), image.shape
        centres = (near + (np.arange(rows) + 0.5) * ((far - near) / max(rows, 1))).astype(np.float32)
        # The transmitter's width is vertical, the receiver's horizontal.
        tall, wide = (np.full(beams, width, np.float32) for width in widths) if widths is not None else (_NONE, _NONE)
        ping = types.make(
            "marine_acoustic_msgs/msg/PingInfo", frequency=frequency, sound_speed=speed, tx_beamwidths=tall, rx_beamwidths=wide
        )  # fmt: skip
        return types.make(
            "marine_acoustic_msgs/msg/ProjectedSonarImage", header=source.header(sample, source.frame + "_sonar"), ping_info=ping,
            beam_directions=[types.vector((0.0, math.sin(angle), math.cos(angle))) for angle in angles.tolist()], ranges=centres,
            image=types.make(
                "marine_acoustic_msgs/msg/SonarImageData", is_bigendian=False, dtype=_DTYPES[image.dtype], beam_count=beams,
                data=np.frombuffer(image.data, np.uint8),
            ),
        )  # fmt: skip

    yield source.outlet("", "marine_acoustic_msgs/msg/ProjectedSonarImage", make)


def side_scan(source: Source) -> Iterator[Outlet]:
    """One ping is a raw image of two beams, port and starboard, in the frame ``_fsd``; both of the nearest range stand first."""
    types, get = source.types, source.bind("range", "frequency", "sound_speed", "port", "starboard")
    views = (source.mount or Mount()).beams
    # Positive to starboard, from straight down; of the axes of both transducers.
    angles = np.array([math.atan2(view.direction[1], view.direction[2]) for view in views], np.float32)
    widths = np.array([view.width for view in views], np.float32)

    def make(sample: Sample) -> object | None:
        reach, frequency, speed, *rows = get(sample.value)
        if (
            not sample.valid
            or not reach
            or None in rows
            or rows[0].dtype not in _DTYPES
            or rows[0].shape != rows[1].shape
            or len(rows[0].shape) != 1
        ):
            return None
        image, bins = np.stack([row.array() for row in rows], axis=1), rows[0].shape[0]
        return types.make(
            "marine_acoustic_msgs/msg/RawSonarImage", header=source.header(sample, source.frame + "_fsd"),
            ping_info=types.make(
                "marine_acoustic_msgs/msg/PingInfo", frequency=frequency, sound_speed=speed, tx_beamwidths=widths
            ),
            sample_rate=0.5 * number(speed) * bins / reach, samples_per_beam=bins, sample0=0, tx_delays=np.zeros(2, np.float32),
            tx_angles=np.zeros(2, np.float32), rx_angles=angles,
            image=types.make(
                "marine_acoustic_msgs/msg/SonarImageData", is_bigendian=False, dtype=_DTYPES[rows[0].dtype], beam_count=2,
                data=image.view(np.uint8).ravel(),
            ),
        )  # fmt: skip

    yield source.outlet("", "marine_acoustic_msgs/msg/RawSonarImage", make)


class _Ping(NamedTuple):
    """Of a sonar that tells ranges: its sound (Hz, m/s), widths of beams (rad), and of each beam unit vector, range (m) and level (dB)."""

    frequency: float
    speed: float
    tx: Floats
    rx: Floats
    directions: list[object]
    ranges: Floats
    levels: Floats


def _ping_info(source: Source, ping: _Ping) -> object:
    return source.types.make(
        "marine_acoustic_msgs/msg/PingInfo", frequency=ping.frequency, sound_speed=ping.speed, tx_beamwidths=ping.tx, rx_beamwidths=ping.rx
    )  # fmt: skip


def _flags(source: Source, ping: _Ping) -> list[object]:
    """A beam without an echo has the flag of the sonar."""
    good, bad = (source.types.make("marine_acoustic_msgs/msg/DetectionFlag", flag=flag) for flag in (0, 1))
    return [bad if missing else good for missing in np.isnan(ping.ranges).tolist()]


def _ranges(source: Source, sample: Sample, ping: _Ping) -> object:
    """A beam without an echo has no range."""
    return source.types.make(
        _RANGES, header=source.header(sample, source.frame + "_fsd"), ping_info=_ping_info(source, ping), flags=_flags(source, ping),
        transmit_delays=np.zeros(len(ping.ranges), np.float32), intensities=ping.levels, beam_unit_vec=ping.directions, ranges=ping.ranges,
    )  # fmt: skip


def bathymetry(source: Source) -> Iterator[Outlet]:
    """Ranges of all beams, and below that as ``/detections`` their travel times and angles; in the frame ``_fsd`` (x ahead, y starboard, z where
    it looks)."""
    types, get = source.types, source.bind("frequency", "sound_speed", "angle", "range", "level")
    views = (source.mount or Mount()).beams

    def ping_of(sample: Sample) -> tuple[_Ping, Floats] | None:
        frequency, speed, *buffers = get(sample.value)
        if not sample.valid or not speed or None in buffers:
            return None
        angles, ranges, levels = (buffer.array() for buffer in buffers)
        across = np.full(len(angles), views[0].width, np.float32) if views else _NONE
        directions = [types.vector((0.0, math.sin(angle), math.cos(angle))) for angle in angles.tolist()]
        return _Ping(frequency, speed, _NONE, across, directions, ranges, levels), angles

    def make(sample: Sample) -> object | None:
        found = ping_of(sample)
        return None if found is None else _ranges(source, sample, found[0])

    def detections(sample: Sample) -> object | None:
        found = ping_of(sample)
        if found is None:
            return None
        ping, angles = found
        nothing = np.zeros(len(angles), np.float32)
        return types.make(
            _DETECTIONS, header=source.header(sample, source.frame + "_fsd"), ping_info=_ping_info(source, ping), flags=_flags(source, ping),
            two_way_travel_times=(2.0 * ping.ranges / ping.speed).astype(np.float32), tx_delays=nothing, intensities=ping.levels,
            tx_angles=nothing, rx_angles=angles,
        )  # fmt: skip

    yield source.outlet("", _RANGES, make)
    yield source.outlet("/detections", _DETECTIONS, detections)


def profiler(source: Source) -> Iterator[Outlet]:
    """The range of one beam, in the frame ``_fsd``, about whose z the head turns; pings without an echo are told too."""
    types, get = source.types, source.bind("frequency", "sound_speed", "head_angle", "range", "level")
    fan = (source.mount or Mount()).fan
    width = np.array([fan.horizontal], np.float32) if fan is not None else _NONE

    def make(sample: Sample) -> object | None:
        frequency, speed, angle, *echo = get(sample.value)
        if angle is None or speed is None:
            return None
        distance, level = (np.array([number(value)], np.float32) for value in echo)
        directions = [types.vector((math.cos(angle), math.sin(angle), 0.0))]
        return _ranges(source, sample, _Ping(frequency, speed, width, width, directions, distance, level))

    yield source.outlet("", _RANGES, make)


def _levels(bins: tuple[int | None, ...]) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    return np.clip(np.nan_to_num(numbers(bins)), 0, 255).astype(np.uint8)


def beacons(source: Source) -> Iterator[Outlet]:
    """A fix of a beacon by USBL or LBL: our own AcousticFix in FLU axes; the place alone where it is known."""
    types, get = source.types, source.bind("beacon", "range", "travel_time")
    direction = source.bind("bearing", "elevation", "p_beacon_S") if source.has("p_beacon_S") else None
    phones = source.bind("hydrophone_ranges") if source.has("hydrophone_ranges") else None

    def make(sample: Sample) -> object | None:
        beacon, distance, time = get(sample.value)
        if not sample.valid or beacon is None:
            return None
        bearing, elevation, p = direction(sample.value) if direction is not None else (None, None, None)
        place = flu(p) if p is not None and is_whole(p) else (math.nan,) * 3
        return types.make(
            "uwserver_msgs/msg/AcousticFix", header=source.header(sample), beacon=beacon, range=number(distance),
            # Counter-clockwise and up are positive in FLU axes.
            travel_time=number(time), bearing=-number(bearing), elevation=-number(elevation),
            position=types.point(place), hydrophone_ranges=numbers(phones(sample.value) if phones else ()),
        )  # fmt: skip

    def point(sample: Sample) -> object | None:
        assert direction is not None
        p = direction(sample.value)[2]
        if not (sample.valid and is_whole(p)):
            return None
        return types.make("geometry_msgs/msg/PointStamped", header=source.header(sample), point=types.point(flu(p)))

    yield source.outlet("", "uwserver_msgs/msg/AcousticFix", make)
    if direction is not None:
        yield source.outlet("/point", "geometry_msgs/msg/PointStamped", point)

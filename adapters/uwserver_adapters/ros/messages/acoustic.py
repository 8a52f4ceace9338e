"""Acoustic sensors: DVL, altimeter, sonars, beacons."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from uwserver.ports import BeamView, Buffer, Sample, Value
from uwserver_adapters.ros.messages.frames import covariance, flu
from uwserver_adapters.ros.messages.motion import NOT_MEASURED, twist_stamped
from uwserver_adapters.ros.messages.ros_port import Mount, RosPort, SensorTopic, is_whole, number, numbers, unknown

Floats = np.ndarray[tuple[int], np.dtype[np.float32]]

_ULTRASOUND = 0
_NO_BEAM = BeamView((0.0, 0.0, 0.0), 0.0, 0.0, math.inf)
_BOTTOM, _WATER = 1, 2
_DTYPES = {"uint8": 0, "float32": 8}
"""Types of samples that SonarImageData has a number for, of those that our sonars have."""
_NONE = np.zeros(0, np.float32)
_DVL = "marine_acoustic_msgs/msg/Dvl"
_IMAGE = "marine_acoustic_msgs/msg/ProjectedSonarImage"
_RANGES = "marine_acoustic_msgs/msg/SonarRanges"
_DETECTIONS = "marine_acoustic_msgs/msg/SonarDetections"


def dvl(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a Dvl for the bottom and one for the water, the twist, and the altitude.

    A Dvl is in the device's own axes, whose z points where the device looks.
    """
    beams = ("beam_ranges", "beam_velocities", "beam_locks")

    def bottom(sample: Sample, v: Any, altitude: Value, spread: Any, *beams: Any) -> object:
        return _dvl(ros_port, sample, _BOTTOM, v, altitude, spread, beams)

    yield ros_port.sensor_topic("", _DVL, ros_port.complete(("v_S",), bottom, ("altitude", "covariance_S", *beams)))
    if ros_port.has("v_water_S"):
        water = ros_port.bind("v_water_S")

        def through_water(sample: Sample) -> object | None:
            # The velocity through water may be known while the bottom is out of reach and the sample therefore not valid.
            v = water(sample.value)
            return _dvl(ros_port, sample, _WATER, v) if is_whole(v) else None

        yield ros_port.sensor_topic("", _DVL, through_water)
    yield _twist(ros_port)
    yield _altitude(ros_port)


def _dvl(
    ros_port: RosPort, sample: Sample, mode: int, v: tuple[float, ...], altitude: Value = None,
    spread: tuple[float, ...] | None = None, beams: tuple[tuple[Value, ...], ...] = ((), (), ()),
) -> object:  # fmt: skip
    types = ros_port.types
    views = ros_port.mount.beams if ros_port.mount is not None else ()
    units = [types.vector(view.direction) for view in (*views, *(_NO_BEAM,) * 4)[:4]]
    ranges, speeds, _ = (numbers((*row, *(None,) * 4)[:4]) for row in beams)  # type: ignore[arg-type]  # numbers
    locks = [bool(lock) for lock in (*beams[2], *(False,) * 4)[:4]]
    return types.make(
        _DVL, header=ros_port.header(sample, ros_port.frame + "_fsd"), velocity_mode=mode, velocity=types.vector(v),
        velocity_covar=np.array(spread) if is_whole(spread) else unknown(), altitude=number(altitude),
        course_gnd=math.atan2(v[1], v[0]), speed_gnd=math.hypot(v[0], v[1]), num_good_beams=sum(map(bool, beams[2])),
        sound_speed=math.nan, beam_ranges_valid=any(beams[2]), beam_velocities_valid=any(beams[2]), beam_unit_vec=units,
        range=ranges, range_covar=np.full(4, -1.0, np.float32), beam_quality=np.array(locks, np.float32),
        beam_velocity=speeds.astype(np.float32), beam_velocity_covar=np.full(4, -1.0, np.float32),
    )  # fmt: skip


def _twist(ros_port: RosPort) -> SensorTopic:
    def make(sample: Sample, v: Any, spread: Any) -> object:
        whole = np.zeros((6, 6))
        whole[3:, 3:] = np.eye(3) * NOT_MEASURED
        if is_whole(spread):
            whole[:3, :3] = np.array(covariance(spread)).reshape(3, 3)
        return twist_stamped(ros_port, sample, flu(v), whole.ravel())

    make_whole = ros_port.complete(("v_S",), make, ("covariance_S",))
    return ros_port.sensor_topic("/twist", "geometry_msgs/msg/TwistWithCovarianceStamped", make_whole)


def _altitude(ros_port: RosPort) -> SensorTopic:
    beams = (ros_port.mount or Mount()).beams
    # The beams of a DVL stand around its axis: what they see is the bottom within this cone.
    cone = 2.0 * max((math.acos(max(-1.0, min(1.0, beam.direction[2]))) for beam in beams), default=0.0)
    reach = max((beam.far * beam.direction[2] for beam in beams), default=math.inf)
    near = min((beam.near for beam in beams), default=0.0)

    def make(sample: Sample, altitude: float) -> object:
        return _range(ros_port, sample, altitude, cone, near, reach)

    return ros_port.sensor_topic("/altitude", "sensor_msgs/msg/Range", ros_port.complete(("altitude",), make))


def _range(ros_port: RosPort, sample: Sample, distance: float, cone: float, near: float, far: float) -> object:
    (variance,) = ros_port.variances("range", 1)
    return ros_port.types.make(
        "sensor_msgs/msg/Range", header=ros_port.header(sample, ros_port.frame + "_beam"), radiation_type=_ULTRASOUND,
        field_of_view=cone, min_range=near, max_range=far, range=distance, variance=variance,
    )  # fmt: skip


def altimeter(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a Range along x of the frame ``_beam``; without an echo it is +inf (REP-117)."""
    get = ros_port.bind("range")
    beam = next(iter((ros_port.mount or Mount()).beams), _NO_BEAM)

    def make(sample: Sample) -> object:
        distance = get(sample.value)
        known = sample.valid and distance is not None
        return _range(ros_port, sample, distance if known else math.inf, beam.width, beam.near, beam.far)

    yield ros_port.sensor_topic("", "sensor_msgs/msg/Range", make)


# -- images -------------------------------------------------------------------------------------------------------------------------------


def _ping_info(ros_port: RosPort, frequency: float, speed: float, tx: Floats = _NONE, rx: Floats = _NONE) -> object:
    """Return a PingInfo: frequency (Hz), speed of sound (m/s), and beam widths of transmitter and receiver (rad).

    The transmitter's width is vertical, the receiver's horizontal.
    """
    return ros_port.types.make(
        "marine_acoustic_msgs/msg/PingInfo", frequency=frequency, sound_speed=speed, tx_beamwidths=tx, rx_beamwidths=rx
    )


def _image(ros_port: RosPort, dtype: str, beams: int, data: object) -> object:
    return ros_port.types.make(
        "marine_acoustic_msgs/msg/SonarImageData", is_bigendian=False, dtype=_DTYPES[dtype], beam_count=beams, data=data
    )  # fmt: skip


def _ahead(ros_port: RosPort, angles: list[float]) -> list[object]:
    """Return the directions of beams in a frame whose z looks ahead (rad, positive to its y)."""
    return [ros_port.types.vector((0.0, math.sin(angle), math.cos(angle))) for angle in angles]


def _centres(near: float, far: float, count: int) -> Floats:
    """Return the ranges of the centres of equal bins, m."""
    return (near + (np.arange(count) + 0.5) * ((far - near) / max(count, 1))).astype(np.float32)


def scanning_sonar(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield each ping as an image of one beam, in the frame ``_sonar`` (z ahead, x up)."""
    counts = next(field for field in ros_port.port.fields if field.name == "bins").type == "int"
    fan = (ros_port.mount or Mount()).fan
    # A head that turns has both widths of one transducer.
    widths = () if fan is None else (fan.vertical, fan.horizontal)
    ping = _ping_info(ros_port, 0.0, 0.0, *(np.array([width] if width else [], np.float32) for width in widths))

    def make(sample: Sample, angle: float, reach: float, bins: Any) -> object | None:
        if bins is None or isinstance(bins, Buffer):  # complex bins: this message has no type for them
            return None
        levels = numbers(bins)
        levels = np.clip(np.nan_to_num(levels), 0, 255).astype(np.uint8) if counts else levels.astype(np.float32)
        return ros_port.types.make(
            _IMAGE, header=ros_port.header(sample, ros_port.frame + "_sonar"), ping_info=ping,
            beam_directions=_ahead(ros_port, [angle]), ranges=_centres(0.0, reach, len(levels)),
            image=_image(ros_port, levels.dtype.name, 1, levels.view(np.uint8)),
        )  # fmt: skip

    yield ros_port.sensor_topic("", _IMAGE, ros_port.complete(("head_angle", "range"), make, ("bins",)))


def multibeam(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield each ping as an image of all beams, in the frame ``_sonar`` (z ahead, x up); all beams of the first range come first."""
    fan = (ros_port.mount or Mount()).fan
    others = ("range_start", "range", "frequency", "sound_speed")

    def make(sample: Sample, azimuth: Buffer, image: Buffer, near: Any, far: Any, frequency: Any, speed: Any) -> Any:
        if len(image.shape) != 2 or image.dtype not in _DTYPES:
            return None
        rows, beams = image.shape
        widths = () if fan is None else (fan.vertical, fan.horizontal)
        ping = _ping_info(ros_port, frequency, speed, *(np.full(beams, width, np.float32) for width in widths))
        return ros_port.types.make(
            _IMAGE, header=ros_port.header(sample, ros_port.frame + "_sonar"), ping_info=ping,
            beam_directions=_ahead(ros_port, azimuth.array().tolist()), ranges=_centres(near, far, rows),
            image=_image(ros_port, image.dtype, beams, np.frombuffer(image.data, np.uint8)),
        )  # fmt: skip

    yield ros_port.sensor_topic("", _IMAGE, ros_port.complete(("azimuth", "image"), make, others))


def side_scan(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield each ping as a raw image of two beams, port and starboard, in the frame ``_fsd``; both samples of the nearest range come first."""
    views = (ros_port.mount or Mount()).beams
    # Positive to starboard, counted from straight down; of the axes of both transducers.
    angles = np.array([math.atan2(view.direction[1], view.direction[2]) for view in views], np.float32)
    widths = np.array([view.width for view in views], np.float32)

    def make(sample: Sample, reach: float, port: Buffer, starboard: Buffer, frequency: Any, speed: Any) -> Any:
        if not reach or port.dtype not in _DTYPES or port.shape != starboard.shape or len(port.shape) != 1:
            return None
        image, bins = np.stack([port.array(), starboard.array()], axis=1), port.shape[0]
        return ros_port.types.make(
            "marine_acoustic_msgs/msg/RawSonarImage", header=ros_port.header(sample, ros_port.frame + "_fsd"),
            ping_info=_ping_info(ros_port, frequency, speed, widths), sample_rate=0.5 * number(speed) * bins / reach,
            samples_per_beam=bins, sample0=0, tx_delays=np.zeros(2, np.float32), tx_angles=np.zeros(2, np.float32),
            rx_angles=angles, image=_image(ros_port, port.dtype, 2, image.view(np.uint8).ravel()),
        )  # fmt: skip

    make_whole = ros_port.complete(("range", "port", "starboard"), make, ("frequency", "sound_speed"))
    yield ros_port.sensor_topic("", "marine_acoustic_msgs/msg/RawSonarImage", make_whole)


# -- ranges -------------------------------------------------------------------------------------------------------------------------------


class _Ping(NamedTuple):
    """One ping of a sonar that measures ranges.

    Attributes:
        info: PingInfo.
        directions: unit vectors of the beams.
        ranges: range of each beam, m; NaN without an echo.
        levels: level of each echo, dB.
    """

    info: object
    directions: list[object]
    ranges: Floats
    levels: Floats


def _flags(ros_port: RosPort, ranges: Floats) -> list[object]:
    """Return a DetectionFlag for each beam: a beam without an echo is marked bad by the sonar."""
    good, bad = (ros_port.types.make("marine_acoustic_msgs/msg/DetectionFlag", flag=flag) for flag in (0, 1))
    return [bad if missing else good for missing in np.isnan(ranges).tolist()]


def _ranges(ros_port: RosPort, sample: Sample, ping: _Ping) -> object:
    return ros_port.types.make(
        _RANGES, header=ros_port.header(sample, ros_port.frame + "_fsd"), ping_info=ping.info, flags=_flags(ros_port, ping.ranges),
        transmit_delays=np.zeros(len(ping.ranges), np.float32), intensities=ping.levels, beam_unit_vec=ping.directions, ranges=ping.ranges,
    )  # fmt: skip


def bathymetry(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield the ranges of all beams, and as ``/detections`` their travel times and angles.

    Both are in the frame ``_fsd`` (x ahead, y starboard, z where the sonar looks).
    """
    views = (ros_port.mount or Mount()).beams

    def ping_info(frequency: float, speed: float, beams: int) -> object:
        across = np.full(beams, views[0].width, np.float32) if views else _NONE
        return _ping_info(ros_port, frequency, speed, rx=across)

    def make(sample: Sample, speed: float, angle: Buffer, range_: Buffer, level: Buffer, frequency: Any) -> Any:
        if not speed:
            return None
        angles = angle.array().tolist()
        info = ping_info(frequency, speed, len(angles))
        return _ranges(ros_port, sample, _Ping(info, _ahead(ros_port, angles), range_.array(), level.array()))

    def detections(sample: Sample, speed: float, angle: Buffer, range_: Buffer, level: Buffer, frequency: Any) -> Any:
        if not speed:
            return None
        angles, ranges = angle.array(), range_.array()
        nothing = np.zeros(len(angles), np.float32)
        return ros_port.types.make(
            _DETECTIONS, header=ros_port.header(sample, ros_port.frame + "_fsd"), ping_info=ping_info(frequency, speed, len(angles)),
            flags=_flags(ros_port, ranges), two_way_travel_times=(2.0 * ranges / speed).astype(np.float32), tx_delays=nothing,
            intensities=level.array(), tx_angles=nothing, rx_angles=angles,
        )  # fmt: skip

    whole = ("sound_speed", "angle", "range", "level")
    yield ros_port.sensor_topic("", _RANGES, ros_port.complete(whole, make, ("frequency",)))
    yield ros_port.sensor_topic("/detections", _DETECTIONS, ros_port.complete(whole, detections, ("frequency",)))


def profiler(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield the range of one beam in the frame ``_fsd``, around whose z the head turns; also for pings without an echo."""
    types, get = ros_port.types, ros_port.bind("frequency", "sound_speed", "head_angle", "range", "level")
    fan = (ros_port.mount or Mount()).fan
    width = np.array([fan.horizontal], np.float32) if fan is not None else _NONE

    def make(sample: Sample) -> object | None:
        frequency, speed, angle, *echo = get(sample.value)
        if angle is None or speed is None:
            return None
        distance, level = (np.array([number(value)], np.float32) for value in echo)
        directions = [types.vector((math.cos(angle), math.sin(angle), 0.0))]
        info = _ping_info(ros_port, frequency, speed, width, width)
        return _ranges(ros_port, sample, _Ping(info, directions, distance, level))

    yield ros_port.sensor_topic("", _RANGES, make)


# -- beacons ------------------------------------------------------------------------------------------------------------------------------


def beacons(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield the fix of a beacon by USBL or LBL as our own AcousticFix in FLU axes, and its position as a point where it is known."""
    types, direction = ros_port.types, ("bearing", "elevation", "p_beacon_S")
    has_direction, has_phones = ros_port.has("p_beacon_S"), ros_port.has("hydrophone_ranges")

    def make(sample: Sample, beacon: str, distance: Value, time: Value, *more: Any) -> object:
        bearing, elevation, p = more[:3] if has_direction else (None, None, None)
        position = flu(p) if p is not None and is_whole(p) else (math.nan,) * 3
        return types.make(
            "uwserver_msgs/msg/AcousticFix", header=ros_port.header(sample), beacon=beacon, range=number(distance),
            # Counter-clockwise and up are positive in FLU axes.
            travel_time=number(time), bearing=-number(bearing), elevation=-number(elevation),
            position=types.point(position), hydrophone_ranges=numbers(more[-1] if has_phones else ()),
        )  # fmt: skip

    def point(sample: Sample, p: Any) -> object:
        return types.make("geometry_msgs/msg/PointStamped", header=ros_port.header(sample), point=types.point(flu(p)))

    optional = (*(direction if has_direction else ()), *(("hydrophone_ranges",) if has_phones else ()))
    fix = ros_port.complete(("beacon",), make, ("range", "travel_time", *optional))
    yield ros_port.sensor_topic("", "uwserver_msgs/msg/AcousticFix", fix)
    if has_direction:
        yield ros_port.sensor_topic(
            "/point", "geometry_msgs/msg/PointStamped", ros_port.complete(("p_beacon_S",), point)
        )

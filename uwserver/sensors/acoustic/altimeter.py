"""Echosounder altimeter: the range of the first echo in a cone, the confidence in it, and wrong echoes."""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.column import SOUND_SPEED
from uwserver.frames import Vec3
from uwserver.modifiers.base import Memory, Time
from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.random import SAMPLE, normals, uniforms
from uwserver.physics.rays.raycast import NOTHING
from uwserver.ports import Argument, BeamView, Field
from uwserver.sensors.acoustic.echo import (
    MU_SEDIMENT,
    SOUND_SPEED_ARGUMENT,
    check_range,
    fill_row,
    lay_ray,
    or_truth,
    pings,
)
from uwserver.sensors.base import Distance, Gain, Pose, SensorTable, Settings, SoundSpeed, Traits
from uwserver.sensors.compiled import (
    MISSING,
    CompiledSensor,
    SensorKernel,
    aim_loop,
    conjugate,
    echo_of,
    meet_surface,
    p_NS,
    q_NS,
    ray_loop,
    record,
    rotate,
    sound_absorption,
    submergence,
    water_property,
)
from uwserver.table import NonNegative, Positive, Probability
from uwserver.units import rad

MOST_HEARD = 4
"""Largest number of bodies that one ping tells apart; the nearest ones."""
THRESHOLD_DB = 6.0
"""Signal over noise at which half of the echoes are detected."""
SLOPE_DB = 1.5
"""Scale of the logistic function by which the probability of detection grows around the threshold."""
SURE_DB = 20.0
"""The confidence is 1 this far above the threshold."""
BEYOND = 1.2
"""Rays reach so many times farther than the device, so that a bottom at its largest range fills the cone."""


class AltimeterConfig(SensorTable, tag="altimeter", kw_only=True, frozen=True):
    """An echosounder with one conical beam along the sensor's z.

    `rate_hz` is an upper limit: a ping waits until the last one is over.

    Attributes:
        ideal: the exact distance of the nearest point in the cone.
        frequency_hz: frequency of the sound; absorption depends on it.
        beam_width_deg: full angle of the cone.
        rings: number of rings of rays around the axis; ring k has 6 k rays.
        min_range_m: blanking range; nearer echoes are not heard, but their multiples may be.
        max_range_m: range at which half of the pings detect sediment.
        range_m: how far it listens at the start, by default the largest range; with a shorter range it pings faster.
        range_sigma_m, range_sigma_relative: white error, fixed and as a part of the range.
        assumed_sound_speed_mps: sound speed that the device believes; default: the true one.
        multiple_loss_db: loss at each further trip between bottom and vehicle.
        multiple_probability: probability that the second echo is taken for the first.
        processing_s: time from the echo to the delivery.
    """

    message = "Range"
    ideal: bool = False
    frequency_hz: Positive = 5e5
    beam_width_deg: Annotated[float, Meta(gt=0, lt=120)] = 6.0
    rings: Annotated[int, Meta(ge=0, le=30)] = 4
    min_range_m: NonNegative = 0.3
    max_range_m: Positive = 50.0
    range_m: Positive | UnsetType = UNSET
    range_sigma_m: NonNegative = 0.01
    range_sigma_relative: NonNegative = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    multiple_loss_db: NonNegative = 10.0
    multiple_probability: Probability = 0.0
    processing_s: NonNegative = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError if keys contradict each other."""
        if not self.min_range_m < self.max_range_m:
            raise ValueError("min_range_m must be less than max_range_m")
        if self.range_m is not UNSET:
            check_range(self.range_m, self.min_range_m, self.max_range_m, "the altimeter")

    def traits(self) -> Traits:
        """Return its stages of compiled code, its cone and its fixed white error."""
        cone = BeamView((0.0, 0.0, 1.0), rad(self.beam_width_deg), self.min_range_m, self.max_range_m)
        return Traits(("soundings",), beams=(cone,), sigmas={"range": (self.range_sigma_m,)})

    def build(self, mount: Pose) -> Altimeter:
        return Altimeter(mount, self)


class AltimeterSettings(Settings, frozen=True):
    """See `AltimeterConfig`; `sound_speed` 0 stands for the true one; with a `gain` below 0 dB echoes must be stronger."""

    range: Distance
    gain: Gain
    sound_speed: SoundSpeed


class AltimeterMemory(Memory):
    """Attributes:
    ready: time of the next ping, s."""

    ready: Time = 0.0


_RECORD = record(
    [
        ("half", "f8"), ("rings", "i8"), ("frequency", "f8"), ("low", "f8"), ("high", "f8"), ("reach", "f8"), ("gain", "f8"),
        ("sigma", "f8"), ("relative", "f8"), ("sound_speed", "f8"), ("loss", "f8"), ("multiples", "f8"), ("processing", "f8"),
        # Bodies that this ping hears: number, row of each, distance (m), and level above the threshold (dB).
        ("heard", "i8"), ("body", "i8", (MOST_HEARD,)), ("distance", "f8", (MOST_HEARD,)), ("excess", "f8", (MOST_HEARD,)),
    ],
    [("ready", "f8")],
)  # fmt: skip


@compiled
def cone(half: float, rings: int, k: int, j: int) -> Vec3:
    """Return ray j of ring k around z. The rays fill a cone of this half angle (rad) evenly: ring 0 is the axis, ring k has 6 k rays."""
    if k == 0:
        return 0.0, 0.0, 1.0
    angle = half * k / rings
    # Every other ring is turned by half a step, so that no plane holds more rays than others.
    azimuth = 2.0 * math.pi * (j + 0.5 * (k % 2)) / (6 * k)
    return math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)


@compiled
def aim(
    head: Any, row: Any, surroundings: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """Lay the rays of the cone if the device pings."""
    if not pings(head, row, surroundings, t):
        return count, 0.0
    p, q = p_NS(head, surroundings), q_NS(head, surroundings)
    for ring in range(row.rings + 1):
        for j in range(max(1, 6 * ring)):
            lay_ray(p, rotate(q, cone(row.half, row.rings, ring, j)), count, origin, direction)
            count += 1
    return count, BEYOND * row.reach


@compiled
def _keep_body(row: Any, body: int, distance: float, excess: float) -> None:
    """Add a body to those that are heard; if there is no room, it replaces the farthest one, unless it is farther itself."""
    k = row.heard
    if k == MOST_HEARD:
        k = 0
        for i in range(MOST_HEARD):
            k = i if row.distance[i] > row.distance[k] else k
        if row.distance[k] <= distance:
            return
    else:
        row.heard += 1
    row.body[k], row.distance[k], row.excess[k] = body, distance, excess


@compiled
def _power(row: Any, surroundings: Array, loss: float, direction: Array, k: int, hits: Any) -> float:
    """Return signal over noise (a ratio) of the echo of ray k; `loss`: absorption both ways, bel/m.

    The echo of an extended bottom loses 20 lg r + 2 alpha r. Sediment that fills the cone at the largest range is at the threshold.
    """
    r = min(max(hits.distance[k], 1e-3), BEYOND * row.reach)
    rays = 1 + 3 * row.rings * (row.rings + 1)
    back = echo_of(surroundings, direction[k], hits.normal[k], hits.body[k], hits.material[k])
    level = (row.reach / r) ** 2 * 10.0 ** (loss * (row.reach - r)) * back
    return float(level * 10.0 ** (0.1 * THRESHOLD_DB) / (MU_SEDIMENT * rays))


@compiled
def _bodies(
    head: Any, row: Any, surroundings: Array, t: float, direction: Array, begin: int, end: int, hits: Any
) -> None:
    """Find the bodies that this ping hears: the distance of each along its nearest ray (m), and its level above the threshold (dB)."""
    p = p_NS(head, surroundings)
    height, limit = submergence(surroundings, p, t), BEYOND * row.reach
    loss = 0.2 * sound_absorption(surroundings, row.frequency, p[2])
    chance, _ = uniforms(head.key, head.number, SAMPLE, 0)
    # The threshold varies with a logistic distribution, so that weak echoes come and go.
    luck = math.log(max(chance, 1e-12) / max(1.0 - chance, 1e-12))
    threshold = THRESHOLD_DB - row.gain + SLOPE_DB * luck
    row.heard = 0
    for k in range(begin, end):
        meet_surface(height, direction, limit, k, hits)
    for k in range(begin, end):
        body, seen = hits.body[k], False
        for i in range(begin, k):
            seen = seen or hits.body[i] == body
        if body == NOTHING or seen:
            continue
        power, nearest = 0.0, math.inf
        for i in range(k, end):
            if hits.body[i] == body:
                power += _power(row, surroundings, loss, direction, i, hits)
                nearest = min(nearest, hits.distance[i])
        excess = 10.0 * math.log10(max(power, 1e-30)) - threshold
        if head.exact != 0 or excess >= 0.0:
            _keep_body(row, body, nearest, excess)


@compiled
def _foot(head: Any, row: Any, surroundings: Array, begin: int, end: int, n: int, hits: Any) -> Vec3:
    """Return the direction in N of the nearest point of body n in the cone.

    That is the foot of the perpendicular on the plane that the nearest ray hits, or the point at the edge of the cone that is closest to it.
    """
    ray = begin
    for i in range(begin, end):
        if hits.body[i] == row.body[n] and hits.distance[i] == row.distance[n]:
            ray = i
            break
    normal, q = hits.normal[ray], q_NS(head, surroundings)
    x, y, z = rotate(conjugate(q), (-normal[0], -normal[1], -normal[2]))
    across = math.hypot(x, y)
    if math.atan2(across, z) > row.half:
        side = math.sin(row.half) / max(across, 1e-12)
        x, y, z = x * side, y * side, math.cos(row.half)
    direction: Vec3 = rotate(q, (x, y, z))
    return direction


@entry
def refine(
    heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
) -> float:  # fmt: skip
    """Lay one ray to the nearest point of each body that is heard. A sensor never has more of these rays than it had in its cone."""
    count, begin, reach = 0, first[0], 0.0
    for n, k in enumerate(due):
        end, head = first[n + 1], heads[k]
        first[n] = count
        if end > begin:
            row, p = rows[head.row], p_NS(head, surroundings)
            _bodies(head, row, surroundings, t, direction, begin, end, hits)
            for i in range(row.heard):
                lay_ray(p, _foot(head, row, surroundings, begin, end, i, hits), count, origin, direction)
                count += 1
            reach = max(reach, BEYOND * row.reach)
        else:
            rows[head.row].heard = 0
        begin = end
    first[len(due)] = count
    return reach


@compiled
def _nearest(
    head: Any, row: Any, surroundings: Array, t: float, direction: Array, first: int, hits: Any
) -> tuple[float, float]:
    """Return the distance of the nearest body that is heard, m (inf for none), and its level above the threshold, dB."""
    height, best, excess = submergence(surroundings, p_NS(head, surroundings), t), math.inf, 0.0
    for i in range(row.heard):
        meet_surface(height, direction, BEYOND * row.reach, first + i, hits)
        reach = row.distance[i]
        if hits.body[first + i] == row.body[i]:
            reach = min(reach, hits.distance[first + i])
        if reach < best:
            best, excess = reach, row.excess[i]
    return best, excess


@compiled
def _taken(head: Any, row: Any, reach: float, excess: float) -> tuple[float, float]:
    """Return the range of the echo that the device takes for the first one, m (inf for none), and its level above the threshold, dB."""
    if head.exact != 0:
        return (reach if row.low <= reach <= row.high else math.inf), SURE_DB
    _, wrong = uniforms(head.key, head.number, SAMPLE, 0)
    trips = 1
    # The device hears nothing within the blanking range: it takes the first multiple behind it.
    while reach > 0.0 and (trips * reach < row.low or (trips == 1 and wrong < row.multiples)):
        trips += 1
        excess -= row.loss + 20.0 * math.log10(trips / (trips - 1))
    return (math.inf if excess < 0.0 or trips * reach > row.high else trips * reach), excess


@compiled
def measure(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """Read the range of the nearest body that is heard."""
    c = water_property(surroundings, SOUND_SPEED, p_NS(head, surroundings)[2])
    wait = 2.0 * row.high / c
    row.m.ready = t + wait
    out[0], out[1], head.valid = MISSING, MISSING, 0
    if row.heard > 0:
        reach, excess = _nearest(head, row, surroundings, t, direction, begin, hits)
        reach, excess = _taken(head, row, reach, excess)
        if reach < math.inf:
            wait, head.valid, out[0], out[1] = 2.0 * reach / c, 1, reach, min(1.0, excess / SURE_DB)
            if head.exact == 0:
                believed = reach * (row.sound_speed / c if row.sound_speed > 0.0 else 1.0)
                noise, _ = normals(head.key, head.number, SAMPLE, 1)
                out[0] = believed + math.hypot(row.sigma, row.relative * believed) * noise
    head.delay_ns = rounded_ns(wait + row.processing)


class Altimeter(CompiledSensor):
    """Gives the range of the first echo and the confidence in it."""

    doc = "Echosounder: range of the first echo in a cone along the sensor's z, and the confidence in it; invalid without echo."
    fields = (
        Field("range", "m", "distance of the first echo"),
        Field("confidence", "1", "how far the echo stands out of the noise, 0 to 1"),
    )
    kernel = SensorKernel(_RECORD, ray_loop(measure), (aim_loop(aim), refine))
    random = ("sigma", "relative")
    memory_type = AltimeterMemory
    settings: AltimeterSettings

    def __init__(self, mount: Pose, config: AltimeterConfig) -> None:
        self._config, self.exact, self.rays = config, config.ideal, 1 + 3 * config.rings * (config.rings + 1)
        low, high = config.min_range_m, config.max_range_m
        self.arguments = (
            Argument("range", "float", "how far it listens", "m", False, minimum=low, maximum=high),
            Argument("gain", "float", "sensitivity; a lower one needs stronger echoes", "dB", False, minimum=-60, maximum=0),
            SOUND_SPEED_ARGUMENT,
        )  # fmt: skip
        reach = high if config.range_m is UNSET else config.range_m
        super().__init__(mount, AltimeterSettings(reach, 0.0, or_truth(config.assumed_sound_speed_mps)))

    def fill(self, row: Any) -> None:
        c, s = self._config, self.settings
        fill_row(
            row, half=rad(c.beam_width_deg) / 2.0, rings=c.rings, frequency=c.frequency_hz, low=c.min_range_m, high=s.range,
            reach=c.max_range_m, gain=s.gain, sigma=c.range_sigma_m, relative=c.range_sigma_relative, sound_speed=s.sound_speed,
            loss=c.multiple_loss_db, multiples=c.multiple_probability, processing=c.processing_s,
        )  # fmt: skip

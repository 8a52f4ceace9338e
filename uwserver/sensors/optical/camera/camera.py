"""The camera: what it records at an exposure, how a worker makes a picture of that, and how its exposure follows the light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType, structs

from uwserver.frames import Vec3, multiply, quat_from_rpy, rotate
from uwserver.modifiers.base import NEVER, Measurement, Memory, Number, Time
from uwserver.ports import Argument, Buffer, Field, Layout, Value
from uwserver.sensors.base import Pose, Scope, Sensor, Settings, Traits, blank, earlier
from uwserver.sensors.job import Job, PendingMeasurement, Pieces, whole
from uwserver.sensors.optical.camera import electronics
from uwserver.sensors.optical.camera.config import CameraTable, gain_of
from uwserver.sensors.optical.camera.view import Pose as Place
from uwserver.sensors.optical.camera.view import View
from uwserver.units import NANOSECONDS

if TYPE_CHECKING:
    from uwserver.sensors.optical.camera.picture import Optics

_SETTLING_S = 0.4
"""Time constant of auto-exposure."""
_DARKEST = 1e-4
"""Level that a black picture counts as, as a part of full scale."""
_DAZZLED = 0.97
"""Above this part of full scale the picture is saturated and its brightness unknown, so the exposure goes down by `_STEP`."""
_STEP = 0.3
_SHORTEST_S = 2e-5
_GREY, _LAMPLIGHT = 0.35, 0.05
"""For the guess of the first picture: albedo, and lux per lumen of a lamp 2 m away."""


class CameraConfig(CameraTable, tag="camera", kw_only=True, frozen=True):
    """A camera that looks along its x axis, with y to the right of the picture and z down."""

    message = "Image"

    def traits(self) -> Traits:
        """Declare the size of its pictures, and that it needs things to see."""
        eyes = 1 if isinstance(self.baseline_m, UnsetType) else 2
        each = {"rgb": 3, "mono": 1, "depth": 2, "segmentation": 2}[self.mode]
        return Traits(("cameras",), picture_bytes=eyes * each * self.width * self.height, needs_sight=True)

    def companions(self, mount: Pose) -> Mapping[str, tuple[CameraConfig, Pose]]:
        """Return the right camera of a pair."""
        if isinstance(self.baseline_m, UnsetType):
            return {}
        right = structs.replace(self, baseline_m=UNSET, streams={}, modifiers={})
        return {"right": (right, self.beside(mount))}

    def build(self, mount: Pose) -> Camera:
        return Camera(mount, self)


class CameraSettings(Settings, frozen=True):
    """See `CameraTable`."""

    exposure: Annotated[float, Meta(ge=1e-6, le=10)]
    gain: Annotated[float, Meta(ge=0, le=60)]
    auto_exposure: bool


class CameraMemory(Memory):
    """Attributes:
    exposure: exposure time of the next picture, s; 0 before the first one.
    gain: dB.
    level: brightness of the last picture, as a part of full scale; negative before the first one.
    tilt: tilt of its mount, rad.
    last: time of the last picture, s."""

    exposure: Annotated[float, Meta(ge=0, le=10)] = 0.0
    gain: Annotated[float, Meta(ge=0, le=60)] = 0.0
    level: Number = -1.0
    tilt: Annotated[float, Meta(ge=-4, le=4)] = 0.0
    last: Time = NEVER


class CameraParts(NamedTuple):
    """The parts of a camera that never change. All its jobs use them, and share the arrays of the optics."""

    config: CameraConfig
    optics: Optics
    chip: electronics.Chip


class Shot(Job):
    """An exposure, as a worker gets it.

    Attributes:
        view: the world in the middle of the exposure.
        exposure: exposure time, s.
        gain: dB.
        seed: seed of the noise; 0 for no noise.
    """

    def __init__(self, parts: CameraParts, view: View, exposure: float, gain: float, seed: int) -> None:
        self.view, self.exposure, self.gain, self.seed = view, exposure, gain, seed
        self._parts, self.shared = parts, parts.optics

    def run(self) -> tuple[Value, ...]:
        """Return the picture. For a segmentation, also return which objects it shows, and how much of them."""
        return whole(self.pieces())

    def pieces(self) -> Pieces[tuple[Value, ...]]:
        """Do the same as `run`, in pieces."""
        config, optics, chip = self._parts
        if config.mode == "depth":
            return (Buffer.of((yield from optics.depths(self.view))),)
        if config.mode == "segmentation":
            return (yield from _segmented(optics, self.view))
        radiance = yield from optics.light(self.view, config.lamp_shadows)
        channels = 3 if config.mode == "rgb" else 1
        n = config.width * config.height
        counts: Any = np.empty((n, channels), np.uint16)
        expose = electronics.expose if channels == 3 else electronics.expose_mono
        expose(
            radiance, chip.electrons(self.exposure), chip.dark * self.exposure, chip.full_well, chip.read_noise,
            chip.gain * gain_of(self.gain), np.uint64(self.seed), electronics.normal_table(), counts if channels == 3 else counts.reshape(-1),
        )  # fmt: skip
        picture: Any = np.empty((n, channels), np.uint8)
        balance = np.array(config.white_balance) if channels == 3 else np.ones(1)
        electronics.develop(counts, electronics.gamma_table(), balance, picture)
        shape = (config.height, config.width, 3) if channels == 3 else (config.height, config.width)
        return (Buffer.of(picture.reshape(shape)),)


class Camera(Sensor):
    """A camera, whose settings and memory decide the exposure. A job computes the picture."""

    paces = takes_time = True
    settings: CameraSettings
    memory: CameraMemory

    def __init__(self, mount: Pose, config: CameraConfig) -> None:
        self._mount, self._config = mount, config
        self._optics: Optics | None = None
        self._chip = electronics.Chip(
            config.pixel_um, config.f_number, config.quantum_efficiency, config.full_well_e,
            0.0 if config.ideal else config.read_noise_e, config.dark_current_eps, electronics.MOST_DN / config.full_well_e,
        )  # fmt: skip
        self.doc, self.fields = _DOCS[config.mode], _fields(config)
        self.arguments = () if self._is_exact else _arguments(config)
        auto = config.auto_exposure and not config.ideal
        super().__init__(CameraSettings(config.exposure_s, config.gain_db, auto))

    @property
    def _is_exact(self) -> bool:
        return self._config.mode in ("depth", "segmentation")

    @property
    def learns(self) -> bool:  # type: ignore[override]  # it follows the settings
        """Whether the next exposure follows from the last picture."""
        return self.settings.auto_exposure and not self._is_exact

    def turn_on(self) -> CameraMemory:
        """Return a memory without a picture."""
        return CameraMemory()

    def load_kernels(self) -> None:
        from uwserver.sensors.optical.camera.kernels import load

        load()
        self._lens()

    def _lens(self) -> Optics:
        """Return the rays of the lens; computed once."""
        if self._optics is None:
            from uwserver.sensors.optical.camera.picture import Optics

            config = self._config
            exact = self._is_exact or config.ideal
            self._optics = Optics(config.optics(), config.window(), 0.0 if exact else config.snow_pm3, self._mount.p)
        return self._optics

    # -- on the tick ----------------------------------------------------------------------------------------------------------------

    def sense(self, scope: Scope) -> Measurement:
        """Begin a picture; invalid in a world that does not say what can be seen."""
        if scope.sight is None:
            return Measurement(blank(self.fields), False)
        config, memory, sight, now = self._config, self.memory, scope.sight, scope.t
        p = scope.position(self._mount.p)
        self._set_exposure(scope, p)
        mount = self._tilted_mount(now)
        memory.last = now
        half = 0.5 * config.read_out_s if config.rolling_shutter and not self._is_exact else 0.0
        view = View(
            now, sight.scene(), sight.state().copy(), _pose_at(scope, mount, half), _pose_at(scope, mount, -half), scope.submergence(p), sight.water,
            sight.day, sight.lamps(), scope.water.current, scope.row,
        )  # fmt: skip
        seed = 0 if config.ideal else int(self.rng.integers(1, 1 << 63))
        job = Shot(CameraParts(config, self._lens(), self._chip), view, memory.exposure, memory.gain, seed)
        numbers: list[Value] = (
            [None, None, None] if config.mode == "segmentation" else [None, memory.exposure, memory.gain]
        )
        return PendingMeasurement(numbers[: len(self.fields)], True, self._delay_ns(memory.exposure), job=job)

    def _delay_ns(self, exposure: float) -> int:
        """Return the time from the middle of the exposure to the end of the read-out."""
        exposed = 0.0 if self._is_exact else 0.5 * exposure
        return round((exposed + self._config.read_out_s) * NANOSECONDS)

    def _set_exposure(self, scope: Scope, p: Vec3) -> None:
        """Set exposure and gain of this picture, taken at p (N)."""
        config, memory, settings, now = self._config, self.memory, self.settings, scope.t
        if not settings.auto_exposure:
            memory.exposure, memory.gain = settings.exposure, settings.gain
            return
        if memory.exposure <= 0.0:
            memory.exposure, memory.gain = min(settings.exposure, config.longest_s), settings.gain
            memory.level = self._guess(scope, p)
        if memory.level < 0.0:
            return
        wanted = electronics.TARGET / max(memory.level, _DARKEST)
        if memory.last >= 0.0:  # the first picture is taken as guessed; later ones follow slowly
            wanted = _STEP if memory.level > _DAZZLED else min(max(wanted, 0.1), 10.0)
            wanted **= 1.0 - math.exp(-max(now - memory.last, 0.0) / _SETTLING_S)
        total = memory.exposure * gain_of(memory.gain) * wanted
        memory.exposure = min(max(total, _SHORTEST_S), config.longest_s)
        more = 20.0 * math.log10(max(total / memory.exposure, 1.0))
        memory.gain = min(more, config.max_gain_db)

    def _guess(self, scope: Scope, p: Vec3) -> float:
        """Guess the brightness of the first picture: grey things, lit by the daylight at the camera and by lamps a few metres away."""
        sight, memory = scope.sight, self.memory
        assert sight is not None
        depth = max(scope.submergence(p), 0.0)
        light = np.exp(-depth * np.array(sight.water.fading)) * sight.day.illuminance
        ways = np.add(sight.water.dimming(), sight.water.attenuation)
        light += sum(lamp.lumens for lamp in sight.lamps()) * _LAMPLIGHT * np.exp(-2.0 * ways)
        electrons = float((light * _GREY / math.pi * self._chip.electrons(memory.exposure)).max())
        return min(max(electrons * gain_of(memory.gain) / self._chip.full_well, 1e-4), 1.0)

    def _tilted_mount(self, now: float) -> Pose:
        """Return the mount with its present tilt."""
        joint, memory = self.joint, self.memory
        if joint is None:
            return self._mount
        dt = self.dt if memory.last < 0.0 else max(now - memory.last, 0.0)
        way, reach = float(joint.memory.tilt) - memory.tilt, joint.rate * dt
        memory.tilt += min(max(way, -reach), reach)
        return Pose(self._mount.p, multiply(self._mount.q, quat_from_rpy(0.0, memory.tilt, 0.0)))

    def learn(self, values: tuple[Value, ...]) -> None:
        """Measure the brightness of the picture that was just delivered."""
        picture = values[0]
        if isinstance(picture, Buffer):
            self.memory.level = electronics.metered(picture.array())


def _pose_at(scope: Scope, mount: Pose, ago: float) -> Place:
    """Return the pose of the camera `ago` s earlier."""
    p_NB, q_NB = (
        earlier(scope.p_NB, scope.q_NB, (*scope.v_NB_B, *scope.w_NB_B), ago) if ago else (scope.p_NB, scope.q_NB)
    )
    dx, dy, dz = rotate(q_NB, mount.p)
    return Place((p_NB[0] + dx, p_NB[1] + dy, p_NB[2] + dz), multiply(q_NB, mount.q))


def _segmented(optics: Optics, view: View) -> Pieces[tuple[Value, ...]]:
    ids, counts = yield from optics.owners(view)
    share = np.divide(counts[:, 0], counts[:, 1], out=np.zeros(len(counts)), where=counts[:, 1] > 0.0)
    there = np.flatnonzero(counts[:, 1])
    names = ",".join(f"{k}:{view.scene.made().names[k]}" for k in there.tolist())
    seen = np.column_stack((there, counts[there, 0], share[there])).astype(np.float32)
    return Buffer.of(ids), names, Buffer.of(seen)


_DOCS = {
    "rgb": "Pictures in colour, sRGB, row after row from above.",
    "mono": "Grey pictures, row after row from above.",
    "depth": "Distance along the optical axis of what each pixel sees.",
    "segmentation": "Which object each pixel sees, and which part of each object is visible.",
}


def _fields(config: CameraConfig) -> tuple[Field, ...]:
    size = config.height, config.width
    if config.mode == "depth":
        return (
            Field(
                "image",
                "mm",
                "distance along the optical axis, 0 for nothing",
                type="buffer",
                buffer=Layout("uint16", size),
            ),
        )
    if config.mode == "segmentation":
        return (
            Field("image", "1", "ids of objects, 0 for none", type="buffer", buffer=Layout("uint16", size)),
            Field("objects", "1", "names of the objects before the camera, as id:name, separated by commas", type="str"),
            Field(
                "shares", "1", "for each object: id, visible pixels, and their part of the pixels that it would have alone",
                type="buffer", buffer=Layout("float32", (-1, 3)),
            ),
        )  # fmt: skip
    shape = (*size, 3) if config.mode == "rgb" else size
    return (
        Field("image", "1", "picture, 0 to 255", type="buffer", buffer=Layout("uint8", shape)),
        Field("exposure", "s", "exposure time of this picture"),
        Field("gain", "dB", "gain of this picture"),
    )


def _arguments(config: CameraConfig) -> tuple[Argument, ...]:
    return (
        Argument(
            "exposure",
            "float",
            "exposure time without auto-exposure",
            "s",
            False,
            minimum=1e-6,
            maximum=config.longest_s,
        ),
        Argument("gain", "float", "gain without auto-exposure", "dB", False, minimum=0, maximum=60),
        Argument("auto_exposure", "bool", "whether exposure and gain follow the light", required=False),
    )

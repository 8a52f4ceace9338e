"""The scene description of a world, for viewers, recordings and everything else that draws it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from fractions import Fraction
from functools import cached_property, partial
from typing import Protocol

from msgspec import UnsetType, structs

from uwserver.environment.currents import ProfileConfig, flow_of
from uwserver.environment.light import WATER_TYPES
from uwserver.environment.water import Water
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import HalfSpace, Placed
from uwserver.physics.kernel.layout import (
    WAVE_AMPLITUDE,
    WAVE_DEPTH,
    WAVE_K,
    WAVE_KX,
    WAVE_KY,
    WAVE_OMEGA,
    WAVE_PHASE,
)
from uwserver.ports import (
    BodyView,
    EntityList,
    ModelFileView,
    OriginView,
    Present,
    SceneView,
    SolidView,
    WaterView,
    WaveView,
)
from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.scene.fittings import actuator_views, beacon_views, lamp_views, sensor_views
from uwserver.scenario.scene.shapes import Meshes, displaced_shapes, shape_views
from uwserver.scenario.solids.appearance import OBJECT, SEABED, STRUCTURE, VEHICLE
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.entry import COLOURS
from uwserver.units import rad
from uwserver.world.world import World

SCHEMA = 1
"""Version of the format of the description."""
SEABED_NAME = "seabed"
"""Name of the seabed among the static solids. No structure may have it."""
_FLAT_K = 1e-9
"""Wave number (rad/m) below which a component is the tide and no wave."""


class Shown(Protocol):
    """What a scene needs to know of a world."""

    @property
    def rate_hz(self) -> Fraction:
        """Ticks a second."""

    @property
    def epoch_utc(self) -> str:
        """UTC of time zero."""


class Scenery:
    """Describes a world from its scenario. Nothing is computed before somebody asks. It belongs to the loop thread.

    Attributes:
        meshes: triangles of the things that were described.
        model_files: glTF files, by hash.
    """

    def __init__(self, resolved: Resolved, world: World | Shown, water: Callable[[], WaterView] | None = None) -> None:
        """Prepare the description of a world. Apart from the current, nothing that it reads changes during a run.

        Args:
            resolved: the scenario.
            world: the world that was built of it, or what is known of a world that is not there.
            water: returns the present sea, if there is no world.
        """
        if water is None:
            if not isinstance(world, World):
                raise TypeError("without a world, water must be given")
            water = partial(water_view, resolved, world)
        self._resolved, self._world, self._water = resolved, world, water
        self.meshes = Meshes()
        self.model_files: dict[str, bytes] = {}
        self._newest: SceneView | None = None
        self._params: dict[int, BodyParams] = {}

    def scene(self, entities: EntityList) -> SceneView:
        """Return the description of the world with these bodies."""
        newest = self._newest
        if newest is not None and newest.revision == entities.revision:
            return newest
        resolved, world = self._resolved, self._world
        seabed, structures = self._static
        origin = resolved.scenario.world.origin
        vehicles = tuple(self._vehicle(body) for body in entities.vehicles)
        files = [(body.name, resolved.vehicles[body.like].vehicle) for body in entities.vehicles]
        self._newest = SceneView(
            schema=SCHEMA,
            revision=entities.revision,
            scenario=resolved.name,
            title=resolved.scenario.title,
            epoch=world.epoch_utc,
            rate_hz=float(world.rate_hz),
            origin=None if origin is None else OriginView(*map(rad, origin)),
            water=self._water(),
            seabed=seabed,
            structures=structures,
            vehicles=vehicles,
            objects=tuple(self._object(body) for body in entities.objects),
            beacons=tuple(beacon for name, file in files for beacon in beacon_views(name, file)),
            meshes=self.meshes.views,
        )
        return self._newest

    @cached_property
    def _static(self) -> tuple[SolidView | None, tuple[SolidView, ...]]:
        """Seabed and structures."""
        views: dict[str, SolidView] = {}
        for name, solid in self._resolved.static.items():
            colour = SEABED if name == SEABED_NAME else STRUCTURE
            shapes = shape_views(solid, self._resolved.materials, colour, self.meshes)
            placed = solid.shapes[0] if solid.shapes else Placed(HalfSpace())
            looks = self._model_file(self._resolved.looks.get(name, b""))
            views[name] = SolidView(name, shapes, looks and structs.replace(looks, p=placed.p, q=placed.q))
        return views.pop(SEABED_NAME, None), tuple(views.values())

    def _vehicle(self, body: Present) -> BodyView:
        resolved = self._resolved.vehicles[body.like]
        file = resolved.vehicle
        params = self._params.get(id(file))  # shared by all that are alike
        if params is None:
            params = body_params(file, resolved.devices, self._resolved.scenario.environment)
            self._params[id(file)] = params
        solid = resolved.solid or resolved.ghost
        if solid is None:
            shapes = displaced_shapes(file, VEHICLE)
        else:
            shapes = shape_views(solid, self._resolved.materials, VEHICLE, self.meshes)
            names = tuple(file.collision)
            if len(names) == len(shapes):  # names let a viewer tell a frame from a hull
                shapes = tuple(structs.replace(shape, name=name) for shape, name in zip(shapes, names, strict=True))
        return BodyView(
            name=body.name,
            model=file.name,
            like=body.like,
            shapes=shapes,
            mass=file.rigid_body.mass_kg,
            looks=self._model_file(resolved.looks),
            actuators=actuator_views(body.name, resolved, params),
            sensors=sensor_views(body.name, file),
            lamps=lamp_views(file),
            external=resolved.entry.is_external,
            ghost=resolved.entry.is_external and not resolved.entry.solid,
            colour=self._colour(resolved),
        )

    def _colour(self, resolved: ResolvedVehicle) -> tuple[float, float, float] | None:
        """Return the colour of an external vehicle: its own, or one for each, so that a user can tell them apart."""
        if not resolved.entry.is_external:
            return None
        if not isinstance(resolved.entry.colour, UnsetType):
            return resolved.entry.colour
        externals = [name for name, each in self._resolved.vehicles.items() if each.entry.is_external]
        return COLOURS[externals.index(resolved.name) % len(COLOURS)]

    def _object(self, body: Present) -> BodyView:
        resolved = self._resolved.objects[body.like]
        shapes = shape_views(resolved.solid, self._resolved.materials, OBJECT, self.meshes)
        return BodyView(body.name, "object", body.like, shapes, looks=self._model_file(resolved.looks))

    def _model_file(self, data: bytes) -> ModelFileView | None:
        """Keep a glTF file under its hash, and return the view of it."""
        if not data:
            return None
        name = hashlib.sha256(data).hexdigest()
        self.model_files[name] = data
        return ModelFileView(name, len(data))


def water_view(resolved: Resolved, world: World) -> WaterView:
    """Return the sea of a world that was built of this scenario, with its present current."""
    return structs.replace(still_water_view(resolved, world.water), waves=_waves(world))


def still_water_view(resolved: Resolved, water: Water) -> WaterView:
    """Return the sea without waves."""
    environment = resolved.scenario.environment
    light = WATER_TYPES[environment.water_type]
    flows = [flow_of(current) for current in environment.currents.values()]
    return WaterView(
        density=environment.density,
        sound_speed=water.sound_speed(0.0),
        waves=(),
        surface_level=environment.surface_level_m,
        current=water.current,
        profiles=tuple(
            tuple(zip(flow.depth_m, flow.velocity_ned_mps, strict=True))
            for flow in flows
            if isinstance(flow, ProfileConfig)
        ),
        jerlov=environment.water_type,
        attenuation=light.attenuation,
        colour=light.veil(),
    )


def _waves(world: World) -> tuple[WaveView, ...]:
    sea = world.water.sea
    if sea is None:
        return ()
    columns = (WAVE_AMPLITUDE, WAVE_KX, WAVE_KY, WAVE_OMEGA, WAVE_PHASE)
    waves = []
    for row in sea.rows.waves.tolist():
        if row[WAVE_K] > _FLAT_K:
            a, kx, ky, omega, phase = (row[column] for column in columns)
            depth = row[WAVE_DEPTH]
            waves.append(WaveView(a, kx, ky, omega, phase, None if math.isinf(depth) else depth))
    return tuple(waves)

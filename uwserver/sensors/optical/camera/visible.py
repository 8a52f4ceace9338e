"""Everything that cameras see of a world: painted triangles, and scenes to cast rays at. It is rebuilt when bodies are added or removed."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.frames import matrix
from uwserver.physics.geometry.shapes import Solid
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.optical.camera.faces import FACE, Paint, blank_faces, floors, solid_faces
from uwserver.sensors.optical.camera.gltf import BadGltf, GltfModel, read_glb
from uwserver.sensors.optical.camera.rays import THING, PickScene, Placed, pick_scene
from uwserver.sensors.optical.camera.textures import Atlas, BadTexture, ByteBudget, Picture
from uwserver.sensors.optical.camera.view import quat_of

LATTICE_M = 1024.0
"""Distance between the centres of static scenes. With one scene for all, float32 would be coarse if something is far away."""


class VisibleThing(NamedTuple):
    """One thing of a world.

    Attributes:
        name: name of the structure or body.
        solid: its shapes, in N or B; None if it has only looks.
        paint: paint of the shapes.
        looks: a .glb file that is shown instead of the shapes; b"" for none.
        row: row of its body; -1 for a thing that never moves.
        p, R: pose of the looks in the frame of the solid.
    """

    name: str
    solid: Solid | None
    paint: Paint
    looks: bytes = b""
    row: int = -1
    p: tuple[float, float, float] = (0.0, 0.0, 0.0)
    R: FloatArray | None = None


class Plane(NamedTuple):
    """A half-space: a point of its plane and its normal, in N; and its rows of FACE and THING."""

    p: FloatArray
    normal: FloatArray
    face: int
    thing: int


class Models:
    """The faces and scenes of all models so far. Things that are alike share them, and nothing is computed twice."""

    def __init__(self) -> None:
        self._faces: dict[tuple[int, int], tuple[object, Any, list[Picture]]] = {}
        self._scenes: dict[int, tuple[object, PickScene]] = {}
        self._faults: dict[str, None] = {}
        self._budget = ByteBudget()

    @property
    def faults(self) -> list[str]:
        """Texts about things that cannot be shown as they are."""
        return [*self._faults]

    def faces(self, seen: VisibleThing) -> tuple[Any, list[Picture]]:
        """Return FACE (n) in the frame of the solid, and the pictures of the textures."""
        key = id(seen.looks), id(seen.solid)
        if key not in self._faces:
            self._faces[key] = ((seen.looks, seen.solid), *self._made(seen))
        return self._faces[key][1:]

    def _made(self, seen: VisibleThing) -> tuple[Any, list[Picture]]:
        if seen.looks:
            try:
                model: GltfModel = read_glb(seen.looks, self._budget)
            except BadGltf as error:
                self._faults[f"{seen.name}: {error}"] = None
            else:
                self._faults.update(dict.fromkeys(f"{seen.name}: {fault}" for fault in model.faults))
                faces = model.faces.copy()
                if seen.R is not None:
                    faces["corners"] = faces["corners"] @ seen.R.T + np.array(seen.p)
                    faces["normals"] = faces["normals"] @ seen.R.T
                return faces, model.pictures
        return (blank_faces(0) if seen.solid is None else solid_faces(seen.solid, seen.paint)), []

    def moving(self, faces: Any) -> PickScene:
        """Return the scene of a moving thing, in its own frame."""
        if id(faces) not in self._scenes:
            corners = faces["corners"].astype(np.float64)
            flat = corners.reshape(-1, 3)
            self._scenes[id(faces)] = faces, pick_scene(corners, 0.5 * (flat.min(axis=0) + flat.max(axis=0)))
        return self._scenes[id(faces)][1]

    def atlas(self, pictures: Sequence[Picture]) -> Atlas:
        """Return the atlas of all pictures, or an empty one if they are too large."""
        try:
            return Atlas(pictures)
        except BadTexture as error:
            self._faults[str(error)] = None
            return Atlas()


class VisibleScene:
    """All things at one moment. The thread that makes pictures builds the catalogue when it is first used."""

    def __init__(self, things: Iterable[VisibleThing], models: Models) -> None:
        self._things, self._models = tuple(things), models
        self._made: Visible | None = None

    def made(self) -> Visible:
        """Return the catalogue. Call it in one thread at a time."""
        if self._made is None:
            self._made = Visible(self._things, self._models)
        return self._made


class SceneCache:
    """Gives the present `VisibleScene` while things are added and removed."""

    def __init__(self, things: Callable[[], Iterable[VisibleThing]], bodies: Callable[[], Hashable]) -> None:
        """things: returns everything that can be seen; bodies: returns another value after bodies were added or removed."""
        self._things, self._bodies, self._models = things, bodies, Models()
        self._scene: tuple[Hashable, VisibleScene] | None = None

    def scene(self) -> VisibleScene:
        """Return the scene of everything that is there now. It stays the same object until bodies are added or removed."""
        bodies = self._bodies()
        if self._scene is None or self._scene[0] != bodies:
            self._scene = bodies, VisibleScene(self._things(), self._models)
        return self._scene[1]

    def faults(self) -> list[str]:
        """Build the catalogue, and return texts about what cannot be shown as it is. Call it before the world runs."""
        self.scene().made()
        return self._models.faults


class Visible:
    """The catalogue of faces, and how to place them in a picture.

    Attributes:
        names: names of the objects, by id; id 0 means none.
        faces: FACE of everything.
        scenes: the scenes that rays are cast at.
        planes: the half-spaces.
        rows: (things) row of the body that carries each, -1 for none.
        centres: (things, 3) origin of the faces in the frame of the body, or in N.
        ids: (things) ids of the objects.
        atlas: the textures.
    """

    def __init__(self, things: Iterable[VisibleThing], models: Models) -> None:
        """Build the catalogue of these things, with models that may be known already."""
        self.names: list[str] = [""]
        self._parts: list[Any] = []
        self._count = 0
        self._pictures: list[Picture] = []
        self._places: list[tuple[int, FloatArray, int]] = []
        self.scenes: list[Placed] = []
        self.planes: list[Plane] = []
        self._alone: list[tuple[int, int, PickScene]] | None = None
        still: dict[tuple[float, ...], list[tuple[int, Any]]] = {}
        for seen in things:
            number = len(self.names)
            self.names.append(seen.name)
            faces, pictures = models.faces(seen)
            faces = self._with_texture_numbers(faces, pictures)
            if seen.row >= 0:
                if len(faces):
                    scene = models.moving(models.faces(seen)[0])
                    faces["corners"] -= scene.centre.astype(np.float32)
                    self.scenes.append(Placed(scene, *self._add(faces, seen.row, scene.centre, number)))
                continue
            if seen.solid is not None:
                self._add_half_spaces(seen, number)
            if len(faces):
                flat = faces["corners"].reshape(-1, 3).astype(np.float64)
                about = LATTICE_M * np.round(0.5 * (flat.min(axis=0) + flat.max(axis=0)) / LATTICE_M)
                still.setdefault(tuple(about.tolist()), []).append((number, faces))
        for about_m, parts in still.items():
            self._add_static(np.array(about_m), parts)
        self.scenes.sort(
            key=lambda placed: self._places[placed.thing][0] >= 0
        )  # static scenes first: they stop most rays
        self.faces: Any = np.concatenate(self._parts) if self._parts else np.zeros(0, FACE)
        self.rows: IntArray = np.array([row for row, _, _ in self._places], np.int64)
        self.centres: FloatArray = np.array([centre for _, centre, _ in self._places]).reshape(-1, 3)
        self.ids: IntArray = np.array([number for _, _, number in self._places], np.int64)
        self.atlas = models.atlas(self._pictures)
        number_of = np.append(np.array(self.atlas.numbers, np.int32), -1)
        wanted = self.faces["texture"]
        self.faces["texture"] = number_of[np.where(wanted < len(self.atlas.numbers), wanted, -1)]

    def _with_texture_numbers(self, faces: Any, pictures: list[Picture]) -> Any:
        """Return a copy whose textures have numbers among all textures."""
        faces = faces.copy()
        faces["texture"] = np.where(faces["texture"] >= 0, faces["texture"] + len(self._pictures), -1)
        self._pictures += pictures
        return faces

    def _add(self, faces: Any, row: int, centre: FloatArray, number: int) -> tuple[int, int]:
        """Add faces as a thing. Returns its row of THING, and the first row of its faces."""
        thing, first = len(self._places), self._count
        faces["thing"] = thing
        self._places.append((row, centre, number))
        self._parts.append(faces)
        self._count += len(faces)
        return thing, first

    def _add_static(self, about: FloatArray, parts: list[tuple[int, Any]]) -> None:
        """Add one scene of all static things around a point of the lattice: numbers of the objects, and their faces."""
        first_thing, first_face = len(self._places), self._count
        for number, faces in parts:
            faces["corners"] = faces["corners"].astype(np.float64) - about
            self._add(faces, -1, about, number)
        corners = np.concatenate([faces["corners"] for _, faces in parts]).astype(np.float64)
        scene = pick_scene(corners, np.zeros(3))
        self.scenes.append(Placed(scene._replace(centre=about), first_thing, first_face))

    def _add_half_spaces(self, seen: VisibleThing, number: int) -> None:
        """Add the half-spaces of a thing. Each has one face that stands for all of it."""
        assert seen.solid is not None
        for floor in floors(seen.solid, seen.paint):
            face = blank_faces(1)
            across = np.cross(floor.normal, (0.0, 1.0, 0.0) if abs(floor.normal[1]) < 0.9 else (1.0, 0.0, 0.0))
            across /= np.linalg.norm(across)
            face["corners"][0, 1], face["corners"][0, 2] = across, np.cross(floor.normal, across)
            face["normals"][0], face["colour"], face["pattern"] = floor.normal, floor.colour, floor.pattern
            thing, first = self._add(face, -1, floor.p, number)
            self.planes.append(Plane(floor.p, floor.normal, first, thing))

    def alone(self) -> list[tuple[int, int, PickScene]]:
        """Return each meshed thing by itself: id, row of THING, and scene. They are built at the first call."""
        if self._alone is None:
            self._alone = []
            of = self.faces["thing"]
            flat = {plane.thing for plane in self.planes}
            for thing in range(len(self.rows)):
                if thing not in flat:
                    corners = self.faces["corners"][of == thing].astype(np.float64)
                    self._alone.append((int(self.ids[thing]), thing, pick_scene(corners, np.zeros(3))))
        return self._alone

    def facing(self, placed: Placed, point: FloatArray) -> Placed | None:
        """Return the faces of a moving scene that face a point (3) of its body or are two-sided; None if there are none."""
        faces = self.faces[placed.first : placed.first + placed.scene.triangles]
        corners = faces["corners"].astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        away = np.einsum("ij,ij->i", corners[:, 0] - (point - placed.scene.centre), normal)
        rows = np.flatnonzero((away < 0.0) | (faces["sided"] == 0))
        if not len(rows):
            return None
        scene = pick_scene(corners[rows], np.zeros(3))
        return Placed(scene, placed.thing, placed.first, placed.first + rows)

    def placed(self, state: FloatArray, base: FloatArray) -> Any:
        """Return THING of a picture.

        Args:
            state: (m, 13) state of the bodies.
            base: (3) base of the picture, m in N.
        """
        things: Any = np.zeros(len(self.rows), THING)
        things["id"], things["row"], things["R"] = self.ids, self.rows, np.eye(3)
        things["p"] = self.centres - base
        for k in np.flatnonzero(self.rows >= 0):
            x = state[self.rows[k]]
            R = np.array(matrix(quat_of(x)))
            things["R"][k], things["p"][k] = R, x[0:3] + R @ self.centres[k] - base
        return things

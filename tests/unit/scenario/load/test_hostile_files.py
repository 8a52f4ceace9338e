"""Files that lie, that never end, that are none: each gives an error with its place, what is wrong and what to do, in bounded time and memory."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

import json
import os
import socket
import struct
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uwserver.scenario.files import documents
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import MOST_PROBLEMS, load

MOST_CPU_S = 8.0
MOST_MEMORY = 200_000_000

Make = Callable[[Path], object]


def sparse(path: Path, size: int, head: bytes = b"") -> None:
    """A file with holes, which needs no room on the disk."""
    with path.open("wb") as file:
        file.write(head)
        file.truncate(size)


def npy(path: Path, shape: str, descr: str = "'<f8'", size: int = 0) -> None:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    sparse(path, max(size, 10 + len(text)), b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode())


def gltf(**tree: object) -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], **tree}).encode()


def bomb(levels: int) -> bytes:
    """Nodes that repeat a mesh 2 ** levels times."""
    nodes: list[object] = [{"children": [k + 1, k + 1]} for k in range(levels)]
    return gltf(nodes=[*nodes, {"mesh": 0}], meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}])


def accessor(**keys: object) -> bytes:
    return gltf(nodes=[{"mesh": 0}], meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}], accessors=[keys])


def classic_netcdf(path: Path) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        for name in ("lat", "lon"):
            file.createDimension(name, 4)
            file.createVariable(name, "f8", (name,))[:] = np.arange(4.0)
        file.createVariable("elevation", "f8", ("lat", "lon"))[:] = -20.0
    path.write_bytes(path.read_bytes().replace(b"lat\x00\x00\x00\x00\x04", b"lat\x00\x7f\xff\xff\xff", 1))


def hdf5(path: Path, **keys: object) -> None:
    h5netcdf = pytest.importorskip("h5netcdf", reason="h5netcdf is not installed")
    shape = keys.pop("shape", (4, 4))
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"lat": shape[0], "lon": shape[1]}
        for name, n in zip(("lat", "lon"), shape, strict=True):
            axis = file.create_variable(name, (name,), float, fillvalue=1.0, chunks=(min(n, 4096),))
            if n <= 4096:
                axis[:] = np.arange(float(n))
        file.create_variable("elevation", ("lat", "lon"), "f4", fillvalue=0.0, **keys)


def external(path: Path) -> None:
    hdf5(path)
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "a") as file:
        del file["elevation"]
        made = file.create_dataset("elevation", (4, 4), "f4", external=[("/dev/zero", 0, 64)])
        made.dims[0].attach_scale(file["lat"])
        made.dims[1].attach_scale(file["lon"])


def archive(path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, a=np.zeros((2, 2)))


def endpoint(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def loop(path: Path) -> None:
    path.symlink_to(path.name)


SPECIAL: dict[str, tuple[Make, str]] = {
    "pipe": (os.mkfifo, "not a regular file"),
    "folder": (Path.mkdir, "not a regular file"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
    "socket": (endpoint, ""),
    "loop of links": (loop, "Too many levels of symbolic links"),
    "link to nothing": (lambda path: path.symlink_to("nowhere"), ""),
    "terabyte": (lambda path: sparse(path, 1 << 40), ""),
    "empty": (Path.touch, ""),
    "noise": (lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)), ""),
}
"""What may stand where any file should; and a phrase of the error."""

GRID = '[world]\norigin_lat_deg = 1.5\norigin_lon_deg = 1.5\n[seabed]\nkind = "grid"\nspacing_m = [1, 1]\nfile = "{}"\n'
STRUCTURE = '[structures.s]\nkind = "mesh"\nfile = "{}"\n'
VEHICLE = '[vehicles.rov]\nmodel = "./{}"\n'
PLACES = {
    "a.npy": (GRID, "4:2: seabed"),
    "a.nc": (GRID, "4:2: seabed"),
    "a.stl": (STRUCTURE, "1:13: structures.s"),
    "a.obj": (STRUCTURE, "1:13: structures.s"),
    "a.ply": (STRUCTURE, "1:13: structures.s"),
    "a.gltf": (STRUCTURE, "1:13: structures.s"),
    "a.glb": (STRUCTURE, "1:13: structures.s"),
    "a.toml": (VEHICLE, ""),
    "a.py": ('extensions = ["{}"]\n', ""),
}

STL = b"\0" * 80
CASES: dict[str, tuple[str, Make, str]] = {
    "npy that announces a terabyte": ("a.npy", lambda p: npy(p, "(1000000, 1000000)"), "but has only 0"),
    "npy of a terabyte": ("a.npy", lambda p: npy(p, "(350000, 350000)", size=1 << 40), "at most 4000000"),
    "npy of minus one": ("a.npy", lambda p: npy(p, "(-1, -4)"), "but has only 0"),
    "npy of objects": ("a.npy", lambda p: npy(p, "(2, 2)", "'|O'"), "array of numbers"),
    "npy with a nested head": ("a.npy", lambda p: npy(p, "(" * 90), "is not an array in .npy format"),
    "npy whose head has gigabytes": ("a.npy", lambda p: sparse(p, 1 << 33, b"\x93NUMPY\x02\x00\xff\xff\xff\xff"), "is not an array in .npy format"),
    "npy that is an archive": ("a.npy", archive, "is not an array in .npy format"),
    "NetCDF with a lying dimension": ("a.nc", classic_netcdf, 'cannot read "a.nc"'),
    "NetCDF of gigabytes": ("a.nc", lambda p: sparse(p, 1 << 33, b"CDF\x01"), "at most 1000 MB"),
    "NetCDF with an endless axis": ("a.nc", lambda p: hdf5(p, shape=(10**9, 4), chunks=(64, 4)), "at most 4000000"),
    "NetCDF with endless chunks": ("a.nc", lambda p: hdf5(p, shape=(4096, 4096), chunks=(4096, 4096), compression="gzip"), "is in chunks of"),
    "NetCDF whose values are elsewhere": ("a.nc", external, "are in other files"),
    "STL that lies": ("a.stl", lambda p: p.write_bytes(STL + struct.pack("<I", 99) + b"\xff" * 50), "declares 99 triangles in 5034 bytes, but it has 134"),
    "STL that lies and says solid": ("a.stl", lambda p: p.write_bytes(b"solid".ljust(80, b"\xfe") + b"\xff" * 60), "is not an STL"),
    "STL of a billion": ("a.stl", lambda p: sparse(p, 84 + 50 * 10**9, STL + struct.pack("<I", 10**9)), "at most 2000000"),
    "STL of half a gigabyte of nothing": ("a.stl", lambda p: sparse(p, 500_000_000, b""), "declares 0 triangles in 84 bytes, but it has 500000000"),
    "PLY of a billion": ("a.ply", lambda p: p.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\nend_header\n"), "declares 1000000000"),
    "PLY of less than nothing": ("a.ply", lambda p: p.write_bytes(b"ply\nformat ascii 1.0\nelement face -5\nend_header\n"), "declares -5"),
    "PLY without end": ("a.ply", lambda p: p.write_bytes(b"ply\n" + b"comment\n" * 10000), "does not begin with a header"),
    "OBJ of points": ("a.obj", lambda p: p.write_bytes(b"v 0 0 0\n" * 6_000_001), "6000001 vertices"),
    "OBJ of nonsense": ("a.obj", lambda p: p.write_bytes(b"v a b c\nf 1 2 3\n"), 'cannot read "a.obj"'),
    "OBJ with corners it lacks": ("a.obj", lambda p: p.write_bytes(b"v 0 0 0\nf 1 2 1000000000\n"), "a.obj"),
    "glTF with a billion entries": ("a.gltf", lambda p: p.write_bytes(accessor(count=10**9, componentType=5126, type="VEC3")), "1000000000 entries"),
    "glTF with entries of nothing": ("a.gltf", lambda p: p.write_bytes(accessor(count=10**6, componentType=5126, type="VEC3")), "accessor without data"),
    "glTF that repeats itself": ("a.gltf", lambda p: p.write_bytes(bomb(40)), "a node with two parents"),
    "glTF of another folder": ("a.gltf", lambda p: p.write_bytes(gltf(nodes=[], buffers=[{"uri": "../x.bin", "byteLength": 9}])), "not in its own folder"),
    "glTF with a link to another folder": ("a.gltf", lambda p: ((p.parent / "x.bin").symlink_to("/etc/hostname"), p.write_bytes(gltf(nodes=[], buffers=[{"uri": "x.bin", "byteLength": 9}]))), "a link to another folder"),
    "glTF with a pipe": ("a.gltf", lambda p: (os.mkfifo(p.parent / "x.bin"), p.write_bytes(gltf(nodes=[], buffers=[{"uri": "x.bin", "byteLength": 9}]))), "not a regular file"),
    "glTF nested deeply": ("a.gltf", lambda p: p.write_bytes(b'{"nodes":' + b"[" * 100_000), "export it again"),
    "GLB cut short": ("a.glb", lambda p: p.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 1 << 31, 1 << 31, b"JSON")), "not a GLB"),
    "TOML with a key has 50000 parts": ("a.toml", lambda p: p.write_text(".".join(["a"] * 50_000) + " = 1"), "a key has 50000 parts, at most 32"),
    "TOML with a header of 50000 parts": ("a.toml", lambda p: p.write_text(f"[{'.'.join(['a'] * 50_000)}]"), "a key has 50000 parts"),
    "TOML with 10000 keys": ("a.toml", lambda p: p.write_text("".join(f"sensor{k} = 1\n" for k in range(10_000))), f"{MOST_PROBLEMS} problems: the rest was not checked"),
    "TOML with a key of a megabyte": ("a.toml", lambda p: p.write_text("a" * 1_000_000 + " = 1"), "unknown key"),
    "TOML of many tables": ("a.toml", lambda p: p.write_text("".join(f"[sensors.s{k}]\n" for k in range(5000))), "problems"),
    "TOML nested deeply": ("a.toml", lambda p: p.write_text("a = " + "{b = " * 20_000), "nested too deeply"),
    "TOML larger than any": ("a.toml", lambda p: p.write_text("#" * (documents.MOST_BYTES + 1)), "at most 1048576"),
    "Python that ends the process": ("a.py", lambda p: p.write_text("raise SystemExit(3)"), "running it failed: SystemExit: 3"),
    "Python that is no text": ("a.py", lambda p: p.write_bytes(b"\xff\xfe\x00"), "not valid UTF-8"),
}  # fmt: skip

FILES = [(name, make, phrase, None) for name, make, phrase in CASES.values()]
FILES += [(name, make, phrase, what) for name in PLACES for what, (make, phrase) in SPECIAL.items()]
IDS = [*CASES, *(f"{name}, {what}" for name in PLACES for what in SPECIAL)]


@pytest.mark.parametrize(("name", "make", "phrase", "special"), FILES, ids=IDS)
def test_a_file_that_a_scenario_names(name: str, make: Make, phrase: str, special: str | None, tmp_path: Path) -> None:
    make(tmp_path / name)
    text, place = PLACES[name]
    (tmp_path / "it.toml").write_text("schema = 1\n" + text.format(name))
    told, lines = refused(tmp_path / "it.toml")
    assert phrase in told
    assert name in told
    if place:
        line, _, rest = place.partition(":")
        assert f"it.toml:{int(line) + 1}:{rest}" in lines[0]


@pytest.mark.parametrize("what", [w for w in SPECIAL if w != "empty"])
def test_a_scenario_itself(what: str, tmp_path: Path) -> None:
    make, phrase = SPECIAL[what]
    make(tmp_path / "it.toml")
    told, _ = refused(tmp_path / "it.toml")
    assert phrase in told
    assert "it.toml" in told


@pytest.mark.parametrize(
    ("model", "phrase"),
    [(r"./a\u0000.toml", "a file cannot have this name"), ("./" + "a" * 5000 + ".toml", "File name too long"), ("./a.toml/b.toml", "")],
)  # fmt: skip
def test_names_that_no_file_can_have(model: str, phrase: str, tmp_path: Path) -> None:
    (tmp_path / "a.toml").touch()
    (tmp_path / "it.toml").write_text(f'schema = 1\n[vehicles.rov]\nmodel = "{model}"\n')
    told, lines = refused(tmp_path / "it.toml")
    assert "it.toml:3:1: vehicles.rov.model: there is no vehicle file" in lines[0]
    assert phrase in told


def test_a_name_that_is_no_utf_8(tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.toml"))
    path.write_text("schema = 2\n")
    told, _ = refused(path)
    assert "expected 1, found 2" in told


def test_who_may_not_look_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*args: object, **keys: object) -> int:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "it.toml").write_text("schema = 1\n")
    monkeypatch.setattr(os, "open", denied)
    told, _ = refused(tmp_path / "it.toml")
    assert "cannot read it: Permission denied" in told


def test_an_extension_outside_the_folder_is_not_run(tmp_path: Path) -> None:
    (tmp_path / "elsewhere.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "link.py").symlink_to("../elsewhere.py")
    (folder / "it.toml").write_text(
        f'schema = 1\nextensions = ["../elsewhere.py", "link.py", "{tmp_path}/elsewhere.py"]\n'
    )
    told, lines = refused(folder / "it.toml")
    assert [line.split(": ")[1] for line in lines[:3]] == [f"extensions[{k}]" for k in range(3)]
    assert told.count("move it there or into a folder below") == 3
    assert not (tmp_path / "ran").exists()


def refused(path: Path) -> tuple[str, list[str]]:
    """What is told about a scenario, and its lines; within processor time and memory."""
    before = time.process_time()
    tracemalloc.start()
    try:
        with pytest.raises(ScenarioError) as caught:
            load(path, adapters={})
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert time.process_time() - before < MOST_CPU_S
    assert peak < MOST_MEMORY
    return str(caught.value), str(caught.value).splitlines()

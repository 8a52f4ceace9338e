"""NetCDF files that were damaged: told in plain words, with no traceback and no crash of the libraries that read them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BROKEN = 60
LAT, LON = np.linspace(63.0, 63.01, 20), np.linspace(10.0, 10.01, 20)
DEPTH = -20.0 + np.random.default_rng(0).normal(size=(20, 20))

READ = """
import resource, sys
from pathlib import Path
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
scenario = Path(sys.argv[1]) / "scenario.toml"
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
for path in sorted(scenario.parent.glob("*.nc")):
    scenario.write_text(f'schema = 1\\n[world]\\norigin_lat_deg = 63.005\\norigin_lon_deg = 10.005\\n'
                        f'[seabed]\\nkind = "grid"\\nfile = "{path.name}"\\n')
    try:
        load(scenario, adapters={})
        print(path.name, "loaded", flush=True)
    except ScenarioError as error:
        print(path.name, *(problem.text.replace("\\n", " ") for problem in error.problems), flush=True)
"""


def classic(path: Path) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(str(path), "w") as file:
        for name, values in (("lat", LAT), ("lon", LON)):
            file.createDimension(name, len(values))
            file.createVariable(name, "f8", (name,))[:] = values
        file.createVariable("elevation", "f8", ("lat", "lon"))[:] = DEPTH


def on_hdf5(path: Path) -> None:
    h5netcdf = pytest.importorskip("h5netcdf")
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"lat": len(LAT), "lon": len(LON)}
        for name, values in (("lat", LAT), ("lon", LON)):
            file.create_variable(name, (name,), float)[:] = values
        packed = file.create_variable("elevation", ("lat", "lon"), float, compression="gzip", chunks=(5, 5))
        packed[:] = DEPTH
        packed.attrs["scale_factor"] = 1.0


def damaged(whole: bytes, rng: np.random.Generator) -> bytes:
    """Cut off, or with some bytes or one number others; the first four, by which the kind is known, stay."""
    data = bytearray(whole)
    how = rng.random()
    if how < 0.2:
        return bytes(data[: rng.integers(4, len(data))])
    if how < 0.7:
        for at in rng.integers(4, len(data), rng.choice((1, 2, 8))):
            data[at] = rng.integers(256)
        return bytes(data)
    at = rng.integers(4, min(len(data) - 8, 3000))
    number = (0, 1, 2**31 - 1, 2**40, 2**62, 2**64 - 1)[rng.integers(6)]
    data[at : at + 8] = number.to_bytes(8, "little" if rng.random() < 0.5 else "big")
    return bytes(data)


@pytest.mark.skipif(sys.platform == "win32", reason="limits of processor time")
def test_a_damaged_file_is_told_in_plain_words(tmp_path: Path) -> None:
    kinds = {"classic": classic, "hdf5": on_hdf5}
    for kind, write in kinds.items():
        sound = tmp_path / f"{kind}_00.nc"
        write(sound)
        rng = np.random.default_rng(7)
        for n in range(1, BROKEN):
            (tmp_path / f"{kind}_{n:02}.nc").write_bytes(damaged(sound.read_bytes(), rng))
    run = [sys.executable, "-c", READ, str(tmp_path)]
    done = subprocess.run(run, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    for kind in kinds:
        lines = [line for line in done.stdout.splitlines() if line.startswith(kind)]
        assert len(lines) == BROKEN
        assert lines[0] == f"{kind}_00.nc loaded"
        told = [line for line in lines if not line.endswith("loaded")]
        assert len(told) > BROKEN / 3
        assert all(len(line) > 28 for line in told)

"""The files that a reader of the pages has: a log, grids, a mesh."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import trimesh
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.io import netcdf_file

START_US = 1_767_225_600_000_000
LAT, LON = 634_600_000, 103_800_000


def write_tlog(path: Path, seconds: int = 10) -> None:
    """A dive northwards at 1 m/s, 5 m deep; its GLOBAL_POSITION_INT lags a metre behind."""
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as file:
        for k in range(10 * seconds):
            ms, north = 100 * k, 0.1 * k
            messages = [
                mavlink.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                mavlink.MAVLink_local_position_ned_message(ms, north, 0.0, 5.0, 1.0, 0.0, 0.0),
                mavlink.MAVLink_global_position_int_message(
                    ms, LAT + round((north - 1.0) * 89.7), LON, -5000, -5000, 100, 0, 0, 0
                ),
            ]
            for message in messages:
                file.write(struct.pack(">Q", START_US + 1000 * ms) + message.pack(link))


def write_gebco(path: Path) -> None:
    """Elevations as of GEBCO: 40 m deep, 0.2 degrees about the place of the page."""
    with netcdf_file(path, "w") as file:
        for name, middle in (("lat", 63.44), ("lon", 10.36)):
            file.createDimension(name, 49)
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = np.linspace(middle - 0.1, middle + 0.1, 49)
            axis.units = {"lat": "degrees_north", "lon": "degrees_east"}[name]
        elevation = file.createVariable("elevation", "f8", ("lat", "lon"))
        elevation[:] = np.full((49, 49), -40.0)
        elevation.units = "m"


def write_mesh(path: Path) -> None:
    """A box of half a metre."""
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(trimesh.creation.box(extents=(0.5, 0.5, 0.5)).export(file_type="glb"))


FILES: Mapping[str, Callable[[Path], None]] = {
    "dive.tlog": write_tlog,
    "GEBCO_2024.nc": write_gebco,
    "slope.npy": lambda path: np.save(path, np.full((101, 101), 20.0)),
    "assets/frame.glb": write_mesh,
}
"""What writes each, by its path beside the scenario."""

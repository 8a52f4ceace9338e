"""The scenario with comments that `uwserver new` writes."""

from __future__ import annotations

import json

_TEXT = """\
# {name}: a scenario for uwserver.
#   uwserver check {name}.toml              is it right?
#   uwserver check --explain {name}.toml    what does it resolve to, with every default?
#   uwserver run {name}.toml                start it
# `uwserver list` shows what else there is; numbers are SI, keys end in their unit, angles here are in degrees.
schema = 1
title = {title}
seed = 1                                # of all noise: the same seed gives the same run

[world]
rate_hz = 240                           # physics; every sensor rate divides it

[environment]
density_kgpm3 = 1025                    # sea water; fresh water is 1000
temperature_degc = 10

[environment.current]
velocity_ned_mps = [0.0, 0.0, 0.0]      # north, east, down

# The name of this table is the name of the vehicle on every connection: rov/...
[vehicles.rov]
model = {vehicle}
position_ned_m = [0.0, 0.0, 2.0]        # 2 m below the surface
attitude_rpy_deg = [0.0, 0.0, 0.0]

# Change any number of the vehicle file for this vehicle alone:
# [vehicles.rov.override.rigid_body]
# mass_kg = 14.0

# Ground truth under rov/truth/: served only by adapters with truth = true.
[vehicles.rov.truth]
rate_hz = 20

# A sensor more than the vehicle file has.
[vehicles.rov.sensors.mocap]
kind = "motion_capture"
rate_hz = 30
latency_s = 0.01

# Its errors, applied in this order.
[vehicles.rov.sensors.mocap.modifiers.noise]
kind = "white_noise"
field = "p_NS"
sigma = 0.002                           # m

# Programs connect here: uwclient, or `nc localhost 7600`.
[adapters.tcp]
kind = "sockets"
port = 7600
"""


def starter(name: str, vehicle: str) -> str:
    """Return the TOML text of a scenario with one vehicle.

    Args:
        name: stem of the file name.
        vehicle: name of a shipped vehicle, or path of a vehicle file.
    """
    # A JSON string without line breaks is a TOML basic string.
    return _TEXT.format(name=name, title=json.dumps(name), vehicle=json.dumps(vehicle, ensure_ascii=False))

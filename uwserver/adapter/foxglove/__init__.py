"""Messages that Foxglove, Lichtblick and rerun show without set-up: a world's bodies, shapes and sensors in Foxglove's schemas (protobuf).

The root of all frames is ``N_enu``, with x east, y north and z up, because viewers take z for up. Below it is ``N``, and below N each body with
its frame B (x forward, y right, z down) under its name. A sensor's frame has the name of its port. Times are simulation time.
"""

from uwserver.adapter.foxglove.channels import PICTURE, Foreign, SceneChannels, shown_as
from uwserver.adapter.foxglove.codec import SCHEMAS

__all__ = ["PICTURE", "SCHEMAS", "Foreign", "SceneChannels", "shown_as"]

"""Messages that Foxglove, Lichtblick and rerun show without set-up: a world's bodies, shapes and sensors in Foxglove's schemas (protobuf).

Frames: ``N_enu`` is the root, x east, y north, z up, for viewers take z for up; ``N`` hangs below it, and each body below N, in its own frame B
(x forward, y right, z down) under its name; a sensor's frame has the name of its port. Times are simulation time.
"""

from uwserver.adapter.foxglove.channels import PICTURE, Foreign, SceneChannels, shown_as
from uwserver.adapter.foxglove.schemas import SCHEMAS

__all__ = ["PICTURE", "SCHEMAS", "Foreign", "SceneChannels", "shown_as"]

"""The mounts of sensors as ``/tf_static`` publishes them: one transform for each frame that a message may name."""

from __future__ import annotations

from collections.abc import Iterable

from uwserver.frames import Quat
from uwserver_adapters.ros.messages.frames import BEAM, SONAR, flu, mounted, mounted_unflipped
from uwserver_adapters.ros.messages.ros_port import Facts, ros_name
from uwserver_adapters.ros.messages.types import Types

_FSD: tuple[tuple[str, Quat], ...] = (("_fsd", (1.0, 0.0, 0.0, 0.0)),)
_FRAMES: dict[str, tuple[tuple[str, Quat], ...]] = {
    "Dvl": (*_FSD, ("_beam", BEAM)),
    "Range": (("_beam", BEAM),),
    "SonarPing": (("_sonar", SONAR),),
    "SonarImage": (("_sonar", SONAR),),
    "SideScan": _FSD,
    "Bathymetry": _FSD,
    "SonarProfile": _FSD,
}
"""Standard message of a sensor -> further frames that its messages name: suffix, and attitude in S."""


def static_transforms(
    types: Types, facts: Facts, sensors: Iterable[tuple[str, str]], vehicles: Iterable[str]
) -> object:
    """Return a TFMessage with the frames of all sensors whose mount is known.

    Args:
        types: message types of the distribution.
        facts: what is the same for all topics, with the mounts.
        sensors: path of each sensor, and the standard message that its fields fit.
        vehicles: names of the vehicles that have an autopilot: their frame odom equals map, as their estimate starts there.
    """
    made = []
    for path, message in sensors:
        mount = facts.mounts.get(path)
        if mount is not None:
            frame = ros_name(path)
            base, place = f"{frame.split('/')[0]}/base_link", flu(mount.p)
            made.append(_transform(types, facts, base, frame, place, mounted(mount.q)))
            for suffix, q in _FRAMES.get(message, ()):
                made.append(_transform(types, facts, base, frame + suffix, place, mounted_unflipped(mount.q, q)))
    for vehicle in vehicles:
        made.append(_transform(types, facts, "map", f"{ros_name(vehicle)}/odom", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    return types.make("tf2_msgs/msg/TFMessage", transforms=made)


def _transform(types: Types, facts: Facts, parent: str, child: str, p: object, q: object) -> object:
    return types.make(
        "geometry_msgs/msg/TransformStamped", header=types.header(facts.epoch_ns, parent), child_frame_id=child,
        transform=types.make("geometry_msgs/msg/Transform", translation=types.vector(p), rotation=types.quaternion(q)),
    )  # fmt: skip

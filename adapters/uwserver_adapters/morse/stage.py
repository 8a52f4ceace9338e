"""The components that all clients of the adapter share, with their streams: samples out, commands in."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property

import msgspec

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Json, Refused, Reply, Sample
from uwserver_adapters.morse import codec
from uwserver_adapters.morse.components import GOTO, Component, components, details, places

Tell = Callable[[bytes], None]
"""Sends a line to a client of a stream."""


class Stage:
    """The components of the world as they are now.

    Args:
        context: the world.
        names: path of a port -> name of its component, where the usual name is not wanted.

    Attributes:
        context: as given.
        components: all components, by name.
        stream_ports: name of a component -> TCP port of its stream. Those of removed vehicles stay, so that no number changes its meaning.
    """

    def __init__(self, context: AdapterContext, names: Mapping[str, str]) -> None:
        self.context = context
        self.stream_ports: dict[str, int] = {}
        self._names = names
        self._hearers: dict[str, list[Tell]] = {}
        self.refresh()

    def refresh(self) -> None:
        """Find all components again: vehicles came or went, or the time of the world was set back."""
        self.components = components(self.context.ports, self.context.services, self._names)
        self._poses: dict[str, Sample] = {}
        for name in ("places", "details"):
            vars(self).pop(name, None)  # the cached properties

    @cached_property
    def places(self) -> dict[str, dict[str, str]]:
        """Services that belong to no component, by name -> path, for each vehicle, and for ``world`` and the like."""
        return places(self.components, self.context.services, [each.name for each in self.context.world.vehicles])

    @cached_property
    def details(self) -> Json:
        """The answer of ``simulation details``. In a swarm it takes a while to make it, so it is kept."""
        world = self.context.world
        return details(self.components, self.places, [each.name for each in world.vehicles], world.scenario)

    # -- what streams say -----------------------------------------------------------------------------------------------------------------

    def enter(self, name: str, tell: Tell) -> None:
        """A client listens to the stream of a component."""
        self._hearers.setdefault(name, []).append(tell)
        self.context.subscriptions_changed()

    def leave(self, name: str, tell: Tell) -> None:
        """A client that listened has gone."""
        self._hearers[name].remove(tell)
        if not self._hearers[name]:
            del self._hearers[name]
        self.context.subscriptions_changed()

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports to whose streams clients listen."""
        heard = [self.components[name] for name in self._hearers if name in self.components]
        return {path for component in heard for path in self.sources(component)}

    def sources(self, component: Component) -> list[str]:
        """Return the paths of the ports that a component's data need: its own, and for a velocity in the world's axes the vehicle's pose."""
        own = [component.path] if component.direction == "OUT" else []
        return [*own, component.pose_path] if component.message == codec.TRUE_VELOCITY else own

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send samples of a tick to the clients that listen."""
        by_port = {sample.port: sample for sample in samples}
        # The pose may come in another tick than the velocity.
        self._poses |= {path: sample for path, sample in by_port.items() if path.endswith("/pose")}
        for name, hearers in self._hearers.items():
            component = self.components.get(name)
            own = None if component is None or component.direction == "IN" else by_port.get(component.path)
            if component is None or own is None:
                continue
            line = msgspec.json.encode(self.data(component, own, self._poses.get(component.pose_path))) + b"\n"
            self.context.stats.encoded += 1
            for tell in list(hearers):
                tell(line)

    def data(self, component: Component, own: Sample, pose: Sample | None) -> dict[str, object]:
        """Return what the stream of a component says of a sample.

        Args:
            component: the component.
            own: sample of its port.
            pose: newest sample of the vehicle's pose; None where it is not known.
        """
        assert component.port is not None
        attitude = pose.value[1] if pose is not None and pose.valid else None
        stamp = codec.timestamp(self.context.world.epoch_ns, own.t_ns)
        said = codec.reading(component.port, own.value, attitude if isinstance(attitude, tuple) else None)  # type: ignore[arg-type]
        return {"timestamp": stamp, "valid": own.valid} | said

    # -- what streams command -------------------------------------------------------------------------------------------------------------

    def carry_out(
        self, peer: Conversation, component: Component, said: dict[str, object], answered: Callable[[Reply], None]
    ) -> None:
        """Carry out a command of a stream.

        Raises:
            Refused: the component is gone, or does not take it.
        """
        if component.name not in self.components:
            raise Refused("unknown_port", f"{component.name} is gone")
        if component.role == "motion":
            peer.command(component.path, codec.motion(said), answered)
        elif component.role == "waypoint":
            peer.call(f"{component.robot}/{GOTO}", _goto(said), answered)
        else:
            assert component.port is not None
            peer.command(component.path, codec.command(component.port, said), answered)


def _goto(said: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments of the autopilot's goto for what MORSE's `waypoint` takes."""
    unknown = set(said) - {"x", "y", "z", "tolerance", "speed", "timestamp"}
    if unknown or not {"x", "y", "z"} <= set(said):
        raise Refused("bad_argument", "write {x, y, z}, and perhaps tolerance and speed: m east, north, up")
    x, y, z = (codec.number(said, key) for key in ("x", "y", "z"))
    more = {
        ours: said[theirs] for theirs, ours in (("tolerance", "radius_m"), ("speed", "speed_mps")) if theirs in said
    }
    return {"position_ned_m": codec.place(x, y, z), **more}

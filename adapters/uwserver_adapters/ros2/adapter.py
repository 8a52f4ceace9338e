"""The `ros2` adapter: a session, a node on it, and their end."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import TYPE_CHECKING, Any

from uwserver.adapter import AdapterContext, CannotServe, Refusals, Worker, serving
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.zenoh_session.config import ZenohConfig, is_exposed

if TYPE_CHECKING:
    from uwserver_adapters.ros2.node import Node
    from uwserver_adapters.ros2.rmw_dds import DdsCarrier
    from uwserver_adapters.ros2.rmw_zenoh import ZenohCarrier

log = logging.getLogger(__name__)

RETRY_S = 0.5
"""Wall time between two attempts to open a session that must connect first."""
LOOK_S = 0.5
"""Wall time between two looks for subscribers."""


class Ros2Adapter:
    """Is a node of ROS 2."""

    Config = Ros2Config

    def __init__(self, config: Ros2Config, context: AdapterContext) -> None:
        self.config, self.context = config, context
        self._refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: a package is not installed, a setting is wrong, or an endpoint cannot be had.
        """
        stats, held = self.context.stats, list[Any]()
        if self.config.transport == "dds" and not self.config.allow_network:
            raise CannotServe(
                "DDS listens on all interfaces of this machine, and asks nobody who he is: say allow_network = true if that may be, "
                'or take transport = "zenoh"'
            )
        sender = Worker("ros2 sender", stats)
        try:
            if self.config.transport == "dds":
                await self._serve_dds(sender, ready)
            else:
                await self._serve(await self._open(sender, held), sender, ready)
        finally:
            await sender.close(lambda: [session.close() for session in held])
            stats.state = "stopped"
            stats.peers = 0

    async def _open(self, sender: Worker, held: list[Any]) -> Any:
        from uwserver_adapters.zenoh_session.session import NobodyThere, free, opened

        stats, config = self.context.stats, session_of(self.config)
        while True:
            listen = free(config)
            try:
                await sender.run(lambda listen=listen: held.append(opened(config, listen)))  # type: ignore[misc]
            except NobodyThere as error:
                stats.state, stats.last_error = "retrying", str(error)
                await asyncio.sleep(RETRY_S)
                continue
            stats.address = ", ".join(listen or config.connect)
            if is_exposed(config, listen):
                log.warning(
                    "%s listens at %s, which others can reach, unrestricted: set access_control or TLS in `config`, or listen on loopback",
                    self.context.name, stats.address,
                )  # fmt: skip
            return held[-1]

    async def _serve(self, session: Any, sender: Worker, ready: asyncio.Event) -> None:
        from uwserver_adapters.ros.messages.types import Types
        from uwserver_adapters.ros2.node import Node
        from uwserver_adapters.ros2.rmw_zenoh import ZenohCarrier

        types = Types(self.config.ros_distro)
        carrier = ZenohCarrier(session, self.config, types, sender, self.context.stats, self._refusals)
        await self._live(Node(self.context, self.config, self._refusals, carrier, types), carrier, ready)

    async def _serve_dds(self, sender: Worker, ready: asyncio.Event) -> None:
        from uwserver_adapters.ros.messages.types import Types
        from uwserver_adapters.ros2.node import Node

        types = Types(self.config.ros_distro)
        try:
            from uwserver_adapters.ros2.rmw_dds import DdsCarrier
        except ImportError as error:
            raise CannotServe(f"{error.name} is not installed: pip install 'uwserver[dds]'") from error
        self.context.stats.address = f"domain {self.config.its_domain}"
        carrier = DdsCarrier(self.config, types, sender, self.context.stats)
        await self._live(Node(self.context, self.config, self._refusals, carrier, types), carrier, ready)

    async def _live(self, node: Node, carrier: ZenohCarrier | DdsCarrier, ready: asyncio.Event) -> None:
        try:
            node.feed.begin()
            with serving(self.context, node, self.context.stats.address, ready):
                while True:
                    carrier.look()
                    await asyncio.sleep(LOOK_S)
        finally:
            await node.close()
            carrier.close()


def session_of(config: Ros2Config) -> ZenohConfig:
    """The session that the table asks for. Its messages carry times, which a publisher needs that keeps its last one for late comers."""
    timed = {"timestamping/enabled": True}
    make = partial(ZenohConfig, mode=config.mode, listen=config.listen, connect=config.connect, scouting=False)
    return make(config_file=config.config_file, config={**timed, **config.config})

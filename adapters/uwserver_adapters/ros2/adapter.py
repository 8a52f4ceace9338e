"""The `ros2` adapter: opens a transport, runs a node on it, and closes both."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from uwserver.adapter import AdapterBase, CannotServe, Worker, install_command, serving
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.zenoh_session.config import ZenohConfig
from uwserver_adapters.zenoh_session.session import open_session

if TYPE_CHECKING:
    from uwserver_adapters.ros.messages.types import Types
    from uwserver_adapters.ros2.rmw_dds import DdsCarrier
    from uwserver_adapters.ros2.rmw_zenoh import ZenohCarrier

REFRESH_S = 0.5
"""Wall time between two checks for subscribers."""


class Ros2Adapter(AdapterBase[Ros2Config]):
    """Runs a node of ROS 2. The message types are loaded only when it runs."""

    Config = Ros2Config

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: a package is not installed, a setting is wrong, or an endpoint cannot be had.
        """
        config, context = self.config, self.context
        if config.transport == "dds":
            await self._serve_dds(ready)
            return
        async with open_session(session_of(config), context, "ros2 sender") as (session, sender):
            from uwserver_adapters.ros.messages.types import Types
            from uwserver_adapters.ros2.rmw_zenoh import ZenohCarrier

            types = Types(config.ros_distro)
            carrier = ZenohCarrier(session, config, types, sender, context.stats, self.refusals)
            await self._serve(carrier, types, ready)

    async def _serve_dds(self, ready: asyncio.Event) -> None:
        config, stats = self.config, self.context.stats
        if not config.allow_network:
            raise CannotServe(
                "DDS listens on all interfaces of this machine and does not authenticate anybody: say allow_network = true if that is wanted, "
                'or take transport = "zenoh"'
            )
        from uwserver_adapters.ros.messages.types import Types

        try:
            from uwserver_adapters.ros2.rmw_dds import DdsCarrier
        except ImportError as error:
            raise CannotServe(f"{error.name} is not installed: {install_command('uwserver[dds]')}") from error
        sender = Worker("ros2 sender", stats)
        try:
            types = Types(config.ros_distro)
            stats.address = f"domain {config.its_domain}"
            await self._serve(DdsCarrier(config, types, sender, stats), types, ready)
        finally:
            await sender.close(lambda: None)
            stats.state = "stopped"
            stats.peers = 0

    async def _serve(self, carrier: ZenohCarrier | DdsCarrier, types: Types, ready: asyncio.Event) -> None:
        from uwserver_adapters.ros2.node import Node

        node = Node(self.context, self.config, self.refusals, carrier, types)
        try:
            node.feed.begin()
            with serving(self.context, node.feed, self.context.stats.address, ready):
                while True:
                    carrier.refresh()
                    await asyncio.sleep(REFRESH_S)
        finally:
            await node.close()
            carrier.close()


def session_of(config: Ros2Config) -> ZenohConfig:
    """Return the settings of the zenoh session.

    Its messages carry times: a publisher that keeps its last message for late subscribers needs them.
    """
    settings = {"timestamping/enabled": True, **config.config}
    return ZenohConfig(
        mode=config.mode, listen=config.listen, connect=config.connect, scouting=False, config_file=config.config_file,
        config=settings,
    )  # fmt: skip

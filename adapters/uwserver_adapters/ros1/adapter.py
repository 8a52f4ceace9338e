"""The `ros1` adapter: a node of a ROS 1 graph, by XML-RPC and TCPROS. It needs no ROS on this machine."""

from __future__ import annotations

import asyncio
import itertools
import socket

from uwserver.adapter import AdapterBase, AdapterContext, Peers, serve_tcp, serving
from uwserver_adapters.ros1.config import Ros1Config


class Ros1Adapter(AdapterBase[Ros1Config]):
    """Registers at a ROS master, which may start later, end, and come back."""

    Config = Ros1Config

    def __init__(self, config: Ros1Config, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._numbers = itertools.count(1)

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: rosbags is not installed.
            CannotListen: the address cannot be had; or it is not loopback and the table does not allow that, or does not say by which name
                others reach it.
        """
        from uwserver_adapters.ros1.node import Node
        from uwserver_adapters.ros1.peers import Caller, Peer

        config, context = self.config, self.context
        config.check_bind("ROS 1")
        host = config.reached_at()
        node = Node(context, config, self.refusals)
        node.feed.begin()
        peers: Peers[Caller | Peer] = Peers(
            config.max_clients, self.refusals, context.stats, strangers=config.max_strangers
        )
        names = (host, socket.gethostname(), *config.allowed_hosts)

        async with (
            serve_tcp(lambda: Caller(node, peers, names), peers, config.bind, config.api_port, key="api_port") as api,
            serve_tcp(
                lambda: Peer(node, peers, f"ros1_{next(self._numbers)}"),
                peers,
                config.bind,
                config.tcpros_port,
                key="tcpros_port",
            ) as tcpros,
        ):
            node.uris = (f"http://{host}:{api.port}/", f"rosrpc://{host}:{tcpros.port}")
            node.tcpros = (host, tcpros.port)
            context.stats.details["master"] = node.master
            context.stats.details["tcpros"] = f"{host}:{tcpros.port}"
            with serving(context, node.feed, node.uris[0], ready):
                try:
                    await node.run()
                finally:
                    api.close()
                    tcpros.close()
                    await node.leave_graph()
                    await node.feed.close()

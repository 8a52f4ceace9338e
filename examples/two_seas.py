"""Two servers, one water: carries the pose of each server's own vehicle to the other server, where it is an external vehicle.

    uwserver run examples/two_seas_north.toml
    uwserver run examples/two_seas_south.toml
    python examples/two_seas.py

Open both web views (http://127.0.0.1:7690/ and :7691/) and steer: what you drive in one moves in the other, and bumps into what is there.
A server that ends is waited for: its vehicle is gone in the other sea after a second, and back when it runs again.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable
from typing import NamedTuple

from uwclient import AsyncClient, UwError

AGAIN_S = 0.2
"""After a connection was lost it is tried anew so often."""


class Sea(NamedTuple):
    """A server, and the vehicle that it simulates."""

    vehicle: str
    host: str
    port: int


async def carry(here: Sea, there: Sea, on_carried: Callable[[str], None] = lambda vehicle: None) -> None:
    """Tell a server of the other one's vehicle, for ever; `on_carried` learns of each pose that was taken."""
    while True:
        try:
            async with await AsyncClient.connect(here.host, here.port, name=f"from {here.vehicle}") as source:
                async with await AsyncClient.connect(there.host, there.port, name=f"to {there.vehicle}") as sink:
                    await follow(here.vehicle, source, sink, on_carried)
        except UwError as error:
            print(f"{here.vehicle} to {there.vehicle}: {error.message}", flush=True)
            await asyncio.sleep(AGAIN_S)


async def follow(vehicle: str, source: AsyncClient, sink: AsyncClient, on_carried: Callable[[str], None]) -> None:
    """Until a connection is lost: the newest pose with its velocity, one at a time, so that none waits behind another."""
    pose, velocity = f"{vehicle}/truth/pose", f"{vehicle}/truth/velocity"
    for port in (pose, velocity):
        await source.subscribe(port, delivery="latest")
    async for moving in source.samples(velocity):
        standing = source.latest(pose)
        if standing is None or standing.t_ns != moving.t_ns:
            continue
        await sink.send(f"{vehicle}/pose", {**standing.value, **moving.value})
        on_carried(vehicle)


async def main() -> None:
    """Both ways at once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--north", default="127.0.0.1:7610", help="server of the vehicle north")
    parser.add_argument("--south", default="127.0.0.1:7611", help="server of the vehicle south")
    options = parser.parse_args()
    seas = []
    for vehicle in ("north", "south"):
        host, _, port = getattr(options, vehicle).rpartition(":")
        seas.append(Sea(vehicle, host, int(port)))
    await asyncio.gather(carry(seas[0], seas[1]), carry(seas[1], seas[0]))


if __name__ == "__main__":
    asyncio.run(main())

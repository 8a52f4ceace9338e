"""A world that one page alone looks at: `python -m uwserver.cli.lone_view SCENARIO [SEED]` says the page's address in a line.

It listens on a free port of loopback and wants a token, has no other adapter, stands still at time 0, runs as fast as it can when it is told to,
and ends with its standard input: it cannot outlive who started it.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec

from uwserver.cli.child import child
from uwserver.cli.web_view import KIND

if TYPE_CHECKING:
    from uwserver.scenario.load.resolved import Resolved


class ViewFailed(Exception):
    """There is no address: the process has told why."""


@contextmanager
def lone_view(scenario: str, seed: int | None = None) -> Iterator[str]:
    """The address of such a page, with its token; the server is a process of its own and ends with the block.

    Args:
        scenario: a shipped name or a file.
        seed: instead of the scenario's.

    Raises:
        ViewFailed: see there.
    """
    command = [sys.executable, "-m", "uwserver.cli.lone_view", scenario, *([] if seed is None else [str(seed)])]
    with child(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        if not address:
            raise ViewFailed(f"the server of {scenario} ended before it had an address")
        yield address


def seen_alone(resolved: Resolved, adapters: Mapping[str, type[Any]], token: str) -> Resolved:
    """The scenario with a web view as its only adapter, and nothing else that listens.

    Args:
        resolved: of the scenario.
        adapters: configuration types by kind, of those that are installed.
        token: that its page must show.
    """
    view = adapters[KIND](port=0, required=True, token=token)
    server = msgspec.structs.replace(resolved.scenario.server, metrics=False)
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters={KIND: view}, server=server))


async def _serve(resolved: Resolved, seed: int | None, token: str) -> int:
    from uwserver.server.life_cycle import Options, Server
    from uwserver.simulation.clock import Timing

    def announce(addresses: dict[str, str]) -> None:
        print(f"{addresses[KIND]}#token={token}", flush=True)

    def leave() -> None:
        loop.remove_reader(sys.stdin)
        server.shutdown("who started it has gone")

    server = Server(resolved, Options(seed, Timing("freerun", paused=True), shown=KIND, announce=announce))
    loop = asyncio.get_running_loop()
    if sys.platform != "win32":  # whose loop knows sockets alone
        loop.add_reader(sys.stdin, leave)
    return await server.run()


def _main(scenario: str, seed: str = "") -> int:
    from uwserver.adapter import installed_adapters, new_token
    from uwserver.logs import set_up_logging
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load
    from uwserver.server.life_cycle import StartFailed
    from uwserver.server.loop import run
    from uwserver.server.signals import end_undisturbed

    set_up_logging("error", False)
    adapters, token = installed_adapters(), new_token()
    try:
        resolved = seen_alone(load(scenario, adapters=adapters), adapters, token)
        status = run(_serve(resolved, int(seed) if seed else None, token))
    except (ScenarioError, StartFailed, OSError) as error:
        print(f"uwserver: {error}", file=sys.stderr)
        status = 1
    end_undisturbed()
    return status


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))

"""Serves a world to a single page: `python -m uwserver.cli.browser.lone_view SCENARIO [SEED]` prints the page's address in one line.

The server listens on a free port of loopback, asks for a token and has no other adapter. The world is paused at time 0 and runs as fast as
possible when it is told to. The server ends when its standard input does, so it cannot outlive its parent.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import msgspec

from uwserver.cli.browser.child import child
from uwserver.cli.loading import with_changes
from uwserver.cli.serving.web_view import KIND

if TYPE_CHECKING:
    from uwserver.scenario.load.resolved import Resolved


class ViewFailed(Exception):
    """The server ended before it had an address; it has printed why."""


@contextmanager
def lone_view(scenario: str, seed: int | None = None) -> Iterator[str]:
    """Start such a server in a process of its own, and end it with the block. Yields the page's address, with its token.

    Args:
        scenario: a shipped name or a file.
        seed: random seed; None takes that of the scenario.

    Raises:
        ViewFailed: the server did not start.
    """
    command = [sys.executable, "-m", "uwserver.cli.browser.lone_view", scenario, *([] if seed is None else [str(seed)])]
    with child(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        if not address:
            raise ViewFailed(f"the server of {scenario} ended before it had an address")
        yield address


def seen_alone(resolved: Resolved, adapters: Mapping[str, type[Any]], token: str) -> Resolved:
    """Return the scenario with a web view as its only adapter, and nothing else that listens.

    Args:
        resolved: the scenario.
        adapters: configuration types of the installed adapters by kind.
        token: the token that the page must show.
    """
    view = adapters[KIND](port=0, required=True, token=token)
    server = msgspec.structs.replace(resolved.scenario.server, metrics=False)
    return with_changes(resolved, adapters={KIND: view}, server=server)


async def _serve(resolved: Resolved, seed: int | None, token: str) -> int:
    from uwserver.server.life_cycle import Options, Server
    from uwserver.simulation.clock import Timing

    def announce(addresses: dict[str, str]) -> None:
        print(f"{addresses[KIND]}#token={token}", flush=True)

    def leave() -> None:
        loop.remove_reader(sys.stdin)
        server.shutdown("its parent process has ended")

    server = Server(resolved, Options(seed, Timing("freerun", paused=True), shown=KIND, announce=announce))
    loop = asyncio.get_running_loop()
    # The loop of Windows can wait for sockets only.
    if sys.platform != "win32":
        loop.add_reader(sys.stdin, leave)
    return await server.run()


def _main(scenario: str, seed: str = "") -> int:
    from uwserver.adapter import installed_adapters, new_token
    from uwserver.logs import set_up_logging
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load
    from uwserver.server.adapters import StartFailed
    from uwserver.server.process import end_undisturbed, run

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

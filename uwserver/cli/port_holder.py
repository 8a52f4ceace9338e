"""Finds out which program has a TCP port, before anything is started that needs it."""

from __future__ import annotations

import json
import socket


def holder_of(bind: str, port: int) -> str | None:
    """Return which program has a TCP port, or why the port cannot be had; None if it is free.

    Args:
        bind: IPv4 address on which it would be opened. Other addresses are not examined, and count as free.
        port: its number; 0 is free.
    """
    with socket.socket() as probe:
        # As servers do, so that a port whose last connection has just closed counts as free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            socket.inet_aton(bind)
        except OSError:
            return None
        try:
            probe.bind((bind, port))
        except PermissionError:
            return "the system (only root may open ports below 1024)"
        except OSError:
            return _program_at(port)
    return None


def _program_at(port: int) -> str:
    """Return what a uwserver at the port says of itself, or "another program" if what is there does not speak its protocol."""
    hello = b'{"jsonrpc":"2.0","id":1,"method":"hello","params":{"version":1}}\n'
    try:
        with socket.create_connection(("127.0.0.1", port), 1.0) as peer:
            peer.settimeout(1.0)
            peer.sendall(hello)
            with peer.makefile("rb") as lines:
                answer = json.loads(lines.readline(65536))
    except (OSError, ValueError):
        answer = None
    if not isinstance(answer, dict) or answer.get("jsonrpc") != "2.0":
        return "another program"
    result = answer.get("result")
    if isinstance(result, dict) and "scenario" in result:
        return f"a running {result.get('server')} with scenario {result['scenario']}"
    return "a running uwserver that wants a token"

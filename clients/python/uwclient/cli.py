"""The command line: `uwclient topics | watch | echo | hz | call | send | plot`.

Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Sequence

from uwclient import cli_verbs
from uwclient.errors import UwError
from uwclient.link import tls_context
from uwclient.over_zenoh import LOOPBACK, connect_zenoh
from uwclient.sync import Client

_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        with _connected(options) as client:
            options.run(client, options)
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output has gone (`uwclient echo ... | head`). Without a place for the rest of the output, the interpreter would
        # complain at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (UwError, OSError) as error:
        print(f"uwclient: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return _INTERRUPTED
    return 0


def _connected(options: argparse.Namespace) -> Client:
    if options.zenoh:
        connect = () if options.scout else options.connect or LOOPBACK
        return connect_zenoh(options.server, connect, prefix=options.prefix, timeout=options.timeout)
    tls = tls_context(options.ca) if options.tls or options.ca else None
    return Client.connect(options.host, options.port, token=options.token, timeout=options.timeout, tls=tls)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="uwclient",
        description="Look at a running uwserver, and command it.",
        epilog="The environment variable UWSERVER_TOKEN may hold the token.",
    )
    parser.add_argument("--host", default="127.0.0.1", help="host of the server (default %(default)s)")
    parser.add_argument("--port", type=int, default=7600, help="TCP port of the server (default %(default)s)")
    parser.add_argument("--token", help="token that the server asks for (default: UWSERVER_TOKEN)")
    parser.add_argument(
        "--tls", action="store_true", help="encrypt; this machine must trust the certificate of the server"
    )
    parser.add_argument("--ca", metavar="FILE", help="encrypt, and trust the certificates in this file")
    parser.add_argument("--zenoh", action="store_true", help="use zenoh instead of TCP (needs eclipse-zenoh)")
    parser.add_argument("--server", default="uwserver", help="with --zenoh: name of the server (default %(default)s)")
    parser.add_argument(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help=f"with --zenoh: endpoint of a router or server (default {LOOPBACK[0]})",
    )
    parser.add_argument(
        "--scout", action="store_true", help="with --zenoh: search by multicast instead of using an endpoint"
    )
    parser.add_argument("--prefix", default="uw", help="with --zenoh: first level of the keys (default %(default)s)")
    parser.add_argument(
        "--timeout", type=_positive, default=5.0, metavar="S", help="wall seconds to wait for an answer (default 5)"
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    _add_streams(verbs.add_parser)
    _add_requests(verbs.add_parser)
    return parser


def _add_streams(add: Callable[..., argparse.ArgumentParser]) -> None:
    echo = add("echo", help="print samples as they come")
    echo.add_argument("pattern", metavar="PATTERN", help="such as rov/imu, 'rov/*', '**'")
    echo.add_argument("-n", type=_count, metavar="N", help="end after N samples")
    echo.add_argument("--rate", type=_positive, metavar="HZ", help="largest rate of each port")
    echo.add_argument("--fields", type=_names, metavar="A,B", help="print only these fields")
    echo.add_argument("--json", action="store_true", help="print a JSON object on each line")
    echo.set_defaults(run=cli_verbs.echo)

    watch = add("watch", help="show live values in one place of the terminal")
    watch.add_argument(
        "pattern", metavar="PATTERN", nargs="?", default="**", help="such as 'rov/*' (default: all sensors)"
    )
    watch.add_argument(
        "--rate", type=_positive, default=4.0, metavar="HZ", help="how often to update (default %(default)s)"
    )
    watch.add_argument("--seconds", type=_positive, metavar="S", help="end after this time (default: at Ctrl-C)")
    watch.set_defaults(run=cli_verbs.watch)

    hz = add("hz", help="measure rate, jitter and drops")
    hz.add_argument("pattern", metavar="PATTERN")
    hz.add_argument("--seconds", type=_positive, default=5.0, metavar="S", help="wall seconds to measure (default 5)")
    hz.set_defaults(run=cli_verbs.hz)

    plot = add("plot", help="draw a field over simulation time (needs matplotlib)")
    plot.add_argument("pattern", metavar="PATTERN")
    plot.add_argument("field", metavar="FIELD")
    plot.add_argument("--seconds", type=_positive, default=5.0, metavar="S", help="wall seconds to collect (default 5)")
    plot.add_argument("--out", metavar="FILE.png", help="write a file instead of opening a window")
    plot.set_defaults(run=cli_verbs.plot)


def _add_requests(add: Callable[..., argparse.ArgumentParser]) -> None:
    topics = add("topics", help="list ports and services")
    topics.add_argument("--services", action="store_true", help="list each service with its arguments")
    topics.add_argument("--json", action="store_true", help="print everything that the server describes as JSON")
    topics.set_defaults(run=cli_verbs.topics)

    call = add("call", help="call a service", description="A value that is not JSON is taken as text.")
    call.add_argument("service", metavar="SERVICE")
    call.add_argument("values", nargs="*", type=_assignment, metavar="NAME=VALUE")
    call.set_defaults(run=cli_verbs.call)

    send = add("send", help="command an actuator", description="Values are JSON: u=[0,0,0.5]")
    send.add_argument("path", metavar="PORT")
    send.add_argument("values", nargs="+", type=_assignment, metavar="NAME=VALUE")
    send.add_argument("--rate", type=_positive, metavar="HZ", help="repeat at this rate of wall time")
    send.add_argument("--seconds", type=_positive, metavar="S", help="repeat for this time (default: until Ctrl-C)")
    send.set_defaults(run=cli_verbs.send)


def _assignment(text: str) -> tuple[str, object]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f'"{text}" is not of the form NAME=VALUE')
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f'"{text}" is no number above 0')
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f'"{text}" is no whole number above 0')
    return int(text)

"""Shows live values of many ports in one place of a terminal, for `uwclient watch`."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import time
from collections.abc import Iterator, Mapping
from typing import TextIO, cast

from uwclient.buffers import Buffer
from uwclient.errors import Timeout, UwError
from uwclient.ports import Field, Port, Sample
from uwclient.sync import Client

_UP_AND_CLEAR = "\x1b[{}F\x1b[J"


def watch(client: Client, pattern: str, rate_hz: float, seconds: float | None, out: TextIO) -> None:
    """Print the newest values of all matching sensors again and again in the same place.

    If the output is no terminal, each table follows the one before.

    Args:
        client: a connected client.
        pattern: pattern of the ports.
        rate_hz: tables per second of wall time.
        seconds: wall time after which it ends; None for no limit.
        out: where to print.
    """
    client.subscribe(pattern, rate_hz=max(2.0 * rate_hz, 1.0), delivery="latest")
    ports = [port for port in client.describe(pattern).ports.values() if port.direction == "sensor"]
    if not ports:
        raise UwError(
            f'no sensor matches "{pattern}"; `uwclient topics` lists them', code="unknown_port", where=pattern
        )
    drawn = 0
    for count, newest in enumerate(_newest(client, 1.0 / rate_hz, seconds)):
        lines = table(ports, newest)
        if out.isatty():
            width, height = shutil.get_terminal_size()
            lines = [line[: width - 1] for line in lines[: height - 1]]
            out.write(_UP_AND_CLEAR.format(drawn) if drawn else "")
        elif count:
            out.write("\n")
        drawn = len(lines)
        out.write("".join(f"{line}\n" for line in lines))
        out.flush()


def _newest(client: Client, period: float, seconds: float | None) -> Iterator[Mapping[str, Sample]]:
    """Yield the newest sample of each port once in each period (wall s), and take in samples in between."""
    newest: dict[str, Sample] = {}
    start = time.monotonic()
    for count in itertools.count(1):
        end = start + count * period
        while (left := end - time.monotonic()) > 0.0:
            with contextlib.suppress(Timeout):
                sample = client.read(timeout=left)
                newest[sample.port] = sample
        yield newest
        if seconds is not None and count * period >= seconds:
            return


def table(ports: list[Port], newest: Mapping[str, Sample]) -> list[str]:
    """Return a line for each field: port, name, value and unit. A port without a sample has a dash."""
    seconds = max((sample.time_s for sample in newest.values()), default=0.0)
    lines = [f"t = {seconds:.3f} s"]
    width = max((len(port.path) for port in ports), default=4)
    for port in ports:
        sample = newest.get(port.path)
        shown = port.path
        for field in port.fields:
            value = "-" if sample is None else _text(sample.value.get(field.name), field)
            doubt = "  INVALID" if sample is not None and not sample.valid else ""
            lines.append(f"{shown:{width}}  {field.name:<16} {value:<44} {_unit(field)}{doubt}".rstrip())
            shown = ""
    return lines


def _text(value: object, field: Field) -> str:
    if isinstance(value, Buffer):
        return f"{value.dtype} {'x'.join(map(str, value.shape)) or 'scalar'}"
    if isinstance(value, (list, tuple)):
        return "  ".join(_text(each, field) for each in cast("list[object]", value))
    if isinstance(value, bool) or value is None or not isinstance(value, (int, float)):
        return "-" if value is None else str(value)
    return f"{value:9.3f}" if field.type == "float" and abs(value) < 1e5 else f"{value:9.6g}"


def _unit(field: Field) -> str:
    return "" if field.unit in ("", "1") else field.unit

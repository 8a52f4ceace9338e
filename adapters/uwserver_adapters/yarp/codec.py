"""Bottles and pictures from samples, and commands and calls from bottles. Values, units and axes are those of the world, as `describe` says."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from uwserver.adapter import Undecodable, decode, did_you_mean
from uwserver.ports import Argument, Buffer, Field, Json, Port, Refused, Sample, Scalar, Service
from uwserver.units import NANOSECONDS
from uwserver_adapters.yarp.bottle import BLOB, INT32, LIST, VOCAB32, Value, Vocab

OK, FAIL, MANY, NULL = Vocab("ok"), Vocab("fail"), Vocab("many"), Vocab("null")
DEEPEST = 16
"""Deepest list within lists of a service's answer; deeper ones are written as JSON."""


# -- samples ------------------------------------------------------------------------------------------------------------------------------


def envelope(sample: Sample) -> str:
    """Return the time stamp of a sample (`yarp::os::Stamp`): its number, and the simulation time of measurement, s."""
    return f"{sample.seq & 0x7FFFFFFF} {sample.t_ns / NANOSECONDS:.15g}"


def bottle(port: Port, sample: Sample) -> list[Value]:
    """Return a sample as pairs of field and value, for `Bottle::find`; missing numbers are NaN."""
    pairs: list[Value] = [
        [field.name, _told(field, value)] for field, value in zip(port.fields, sample.value, strict=True)
    ]
    return [*pairs, ["valid", int(sample.valid)]]


def vector(port: Port, sample: Sample) -> list[Value]:
    """Return all numbers of a sample in one row, in the order of the fields; texts, bytes and buffers are left out."""
    numbers: list[Value] = []
    for field, value in zip(port.fields, sample.value, strict=True):
        if not field.is_packed and field.type != "str":
            numbers += [_number(each) for each in (value if isinstance(value, tuple) else (value,))]
    return numbers


_PIXELS: Mapping[tuple[str, int], tuple[bytes, int]] = {
    ("uint8", 3): (b"rgb\0", 3), ("uint8", 2): (b"mono", 1), ("uint16", 2): (b"mo16", 2),
}  # fmt: skip
"""Type of a buffer and number of its axes -> pixel code, and bytes of a pixel."""
_IMAGE = struct.Struct("<3i4si4s2i2i2h2i2i")
_NOT_PADDED, _TOP_FIRST = 1, 0
"""Rows are padded to a multiple of 1 byte, and the top row comes first."""


def image(picture: object) -> bytes | None:
    """Return a picture as `yarp::sig::Image` reads it in binary: a bottle ``[mat] [rgb] (5 numbers) {pixels}``; None where it is no picture."""
    if not isinstance(picture, Buffer) or len(picture.shape) not in (2, 3):
        return None
    kind = _PIXELS.get((picture.dtype, len(picture.shape)))
    rows, columns = picture.shape[:2]
    if kind is None or not rows * columns or picture.shape[2:] not in ((), (3,)):
        return None
    code, depth = kind
    size = len(picture.data)
    header = _IMAGE.pack(
        LIST, 4, VOCAB32, b"mat\0", VOCAB32, code, LIST + INT32, 5,
        depth, size, _NOT_PADDED, _TOP_FIRST, columns, rows, BLOB, size,
    )  # fmt: skip
    return header + picture.data


def clock(t_ns: int) -> list[Value]:
    """Return a time as `yarp::os::NetworkClock` reads it: whole seconds and nanoseconds."""
    return list(divmod(t_ns, NANOSECONDS))


def span_ns(rate_hz: float) -> int:
    """Return the time between two messages at a rate, ns."""
    return round(NANOSECONDS / rate_hz)


def _told(field: Field, value: object) -> Value:
    if isinstance(value, Buffer):
        described: Value = [["dtype", value.dtype], ["shape", list(value.shape)], ["data", value.data]]
        return described if value.dtype else value.data
    if field.type == "str":
        return [str(each or "") for each in value] if isinstance(value, tuple) else str(value or "")
    if field.is_packed:  # a sensor without a picture
        return b""
    if isinstance(value, tuple):
        return _rows([_scalar(each) for each in value], field.shape)
    return _scalar(value)  # type: ignore[arg-type]  # no tuple, no buffer


def _rows(flat: list[Value], shape: Sequence[int]) -> list[Value]:
    for extent in reversed(shape[1:]):
        flat = [flat[i : i + extent] for i in range(0, len(flat), extent)]
    return flat


def _scalar(value: Scalar) -> Value:
    if value is None:
        return math.nan
    return int(value) if isinstance(value, bool) else value


def _number(value: Scalar | Buffer) -> float:
    return math.nan if value is None or isinstance(value, Buffer) else float(value)


# -- commands -----------------------------------------------------------------------------------------------------------------------------


def command(port: Port, values: Sequence[Value]) -> dict[str, object]:
    """Return the command in a bottle: pairs of field and value, ``(u (0.1 0.2))``, or for a port with one field only its numbers.

    Raises:
        Refused: the fields must be named and are not, or there are too many numbers.
    """
    names = [field.name for field in port.fields]
    if values and all(_is_pair(each) for each in values):
        return _pairs_of(values)
    if len(names) != 1:
        text = f"{port.path} has the fields {', '.join(names)}: write (field value) of each"
        raise Refused("bad_argument", text, port.path)
    (field,) = port.fields
    if len(values) == 1 and (not field.shape or isinstance(values[0], list)):
        return {names[0]: _plain(values[0])}
    if not field.shape:
        raise Refused("bad_shape", f"{names[0]} is one value, here are {len(values)}", port.path)
    return {names[0]: [_plain(each) for each in values]}


def _is_pair(value: Value) -> bool:
    """Return whether a value is a list that begins with a name."""
    return isinstance(value, list) and len(value) >= 2 and isinstance(value[0], str)


def _pairs_of(pairs: Sequence[Any]) -> dict[str, object]:
    """Return name -> value of pairs, the last of each name. Values without brackets of their own, ``(u 1 2)``, are a list too."""
    return {str(name): _plain(rest[0] if len(rest) == 1 else rest) for name, *rest in pairs}


def _plain(value: Value) -> object:
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if isinstance(value, bytes):
        return Buffer(data=value)
    return value


# -- calls --------------------------------------------------------------------------------------------------------------------------------


def call(values: Sequence[Value], services: Mapping[str, Service]) -> tuple[Service, dict[str, object]]:
    """Return the service that a bottle calls, and its arguments.

    Args:
        values: the bottle: the name of the service, then pairs of argument and value, or values in the order of the arguments.
        services: services that may be called, by name.

    Raises:
        Refused: there is no such service; too many arguments; or a JSON text that would cost too much.
    """
    if not values or not isinstance(values[0], str):
        text = "say the name of a service, then its arguments: (name value) of each; help lists them"
        raise Refused("invalid_request", text)
    name, said = str(values[0]), values[1:]
    service = services.get(name)
    if service is None:
        raise Refused("unknown_service", f"no service {name[:80]}{did_you_mean(name[:80], services)}; help lists them")
    known = {argument.name: argument for argument in service.arguments}
    if said and all(_is_pair(each) for each in said):
        pairs = _pairs_of(said)
    elif len(said) <= len(known):
        pairs = {each: _plain(value) for each, value in zip(known, said, strict=False)}
    else:
        text = f"{name} takes {', '.join(known) or 'no arguments'}; here are {len(said)}"
        raise Refused("bad_argument", text, service.path)
    return service, {each: _fitting(known.get(each), value) for each, value in pairs.items()}


_TRUTHS: Mapping[object, bool] = {"1": True, "": False, "true": True, "false": False, 1: True, 0: False}


def _fitting(argument: Argument | None, value: object) -> object:
    """Return a value as its argument needs it: YARP writes true and false as vocabularies or numbers, and JSON as a text."""
    if argument is None:
        return value
    if argument.type == "bool" and isinstance(value, int | str):
        return _TRUTHS.get(value, value)
    if argument.type == "str" and isinstance(value, str):
        return str(value)
    if argument.type == "json" and isinstance(value, str):
        try:
            return decode(value.encode("utf-8", "replace"), "json")
        except Undecodable as undecodable:
            if undecodable.is_valid:
                raise Refused(undecodable.fault.code, f"{argument.name}: {undecodable.fault.text}") from None
            return str(value)
    return value


def answer(result: Json) -> list[Value]:
    """Return the answer of a service: [ok], then its result, in which maps are pairs of key and value."""
    if result is None:
        return [OK]
    if isinstance(result, dict):
        return [OK, *_pairs(result, 0)]
    return [OK, _value(result, 0)]


def _pairs(of: Mapping[str, Json], depth: int) -> list[Value]:
    return [[key, _value(value, depth + 1)] for key, value in of.items()]


def _value(value: Json, depth: int) -> Value:
    if depth > DEEPEST:
        return msgspec.json.encode(value).decode()
    if value is None:
        return NULL
    if isinstance(value, dict):
        return _pairs(value, depth)
    if isinstance(value, list):
        return [_value(each, depth + 1) for each in value]
    return int(value) if isinstance(value, bool) else value


def usage(services: Mapping[str, Service]) -> list[Value]:
    """Return the answer to ``help``: each service with its arguments."""
    ordered = sorted(services.items())
    return [MANY, *(" ".join([name, *map(_form, each.arguments)]) + f"  # {each.doc}" for name, each in ordered)]


def _form(argument: Argument) -> str:
    text = f"({argument.name} {argument.type})"
    return text if argument.required else f"[{text}]"

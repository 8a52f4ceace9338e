"""Checks input from outside before it can change the world: commands against their port, calls against their service.

The functions are pure. Every error is a `Refused` whose text says what is wrong, what is allowed, and what to do.
"""

from __future__ import annotations

import difflib
import heapq
import math
import operator
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from uwserver.ports.buffer import Buffer, unpacked
from uwserver.ports.values import Argument, ErrorCode, Field, Item, Items, Json, Port, Refused, Service, Value

_LARGEST = sys.float_info.max
_NUMERIC = ("float", "int", "bool")

LISTED = 12
"""Most names that an error text lists."""
SHOWN = 80
"""Longest foreign name in an error text, characters."""
COMPARED = 24
"""Most names that are compared with an unknown one."""
LARGEST_WHOLE = 2**63 - 1
"""Largest whole number that TOML, and so a scenario file, can hold."""
LONGEST_WORD = 256
"""Longest unknown name that is compared, characters."""


def find(kind: str, path: str, known: Mapping[str, object]) -> None:
    """Refuse an unknown port or service path; the text suggests a similar one, or lists those of the same vehicle, or the vehicles."""
    if path not in known:
        code: ErrorCode = "unknown_service" if kind == "service" else "unknown_port"
        word = shown(path)
        raise Refused(code, f'no {kind} "{word}"{suggestion(word, known) or _listed(word, known)}', word)


def _listed(word: str, known: Iterable[str]) -> str:
    """Return what there is, as much of it as a line can hold: the paths below the first level of a word, or the first levels."""
    top = word.partition("/")[0] + "/"
    beside = [path for path in known if path.startswith(top)]
    if beside:
        lead, names = "there are", beside
    else:
        lead, names = (
            "paths begin with",
            [f"{name}/" for name in dict.fromkeys(path.partition("/")[0] for path in known)],
        )
    if not names:
        return "; there are none"
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return f"; {lead} {', '.join(names[:LISTED])}{more}"


def shown(word: object) -> str:
    """Return a foreign name for error texts, cut at 80 characters, so that a long one takes neither time nor space in logs."""
    text = str(word[: SHOWN + 1] if isinstance(word, str | bytes) else word)
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return `` (did you mean "x"?)``, or "" if no known word is similar or the word has more than 256 characters."""
    near = difflib.get_close_matches(word, _candidates(word, list(known)), n=1, cutoff=0.6)
    return f' (did you mean "{near[0]}"?)' if near else ""


def _candidates(word: str, known: list[str]) -> list[str]:
    """Return the few words to compare letter by letter, which takes 35 us each; of many paths those that differ in one level only."""
    if len(word) > LONGEST_WORD:
        return []
    if len(known) > COMPARED and "/" in word:
        branch, _, leaf = word.rpartition("/")
        beside = [path for path in known if path.startswith(branch + "/") and "/" not in path[len(branch) + 1 :]]
        known = beside or [path for path in known if path.endswith("/" + leaf)]
    elif len(known) > COMPARED:
        known = [path for path in known if path.endswith("/" + word)] or known
    return heapq.nsmallest(COMPARED, known, key=lambda path: abs(len(path) - len(word)))


def checked_whole(name: str, number: object, least: int = 0, what: str = "") -> int:
    """Return a whole number that a program in the same process gave; numpy's are whole numbers too.

    Args:
        name: name of the argument.
        number: any object.
        least: lowest number.
        what: the rule in words; "" for ``"name" must be a whole number, 0 or more``.

    Raises:
        Refused: it is no whole number, or is out of range.
    """
    rule = what or f'"{name}" must be a whole number, {least} or more'
    try:
        if isinstance(number, bool):
            raise TypeError
        whole = operator.index(number)  # type: ignore[arg-type]  # checked by this very call
    except TypeError:
        raise Refused("bad_argument", f"{rule}, not {shown(repr(number))}", name) from None
    if not least <= whole <= LARGEST_WHOLE:
        raise Refused("out_of_range", f"{rule}, not {whole}", name)
    return whole


def checked_seed(seed: object) -> int:
    """Return a seed of random numbers: a whole number from 0 to `LARGEST_WHOLE`.

    Raises:
        Refused: it is anything else.
    """
    return checked_whole("seed", seed)


def checked_command(port: Port, value: Mapping[str, object]) -> Items:
    """Return one entry for each field of an actuator's port: floats, a text, bytes or a buffer; None for a field that was left out.

    Args:
        port: port of the actuator.
        value: by field name: numbers, lists, texts, bytes, buffers, arrays, or maps that describe bytes and buffers (`unpacked`).

    Raises:
        Refused: unknown field (`bad_argument`), nothing given, wrong type or shape, not finite, out of range, too large.
    """
    if port.direction != "actuator":
        raise Refused("bad_argument", f'"{port.path}" is a sensor and takes no commands: subscribe to it', port.path)
    if type(value) is not dict and not isinstance(value, Mapping):  # the first test is much quicker
        raise Refused("bad_argument", f'"value" must be a map like {{"{port.fields[0].name}": ...}}', port.path)
    try:
        items = tuple(
            [_checked_item(field, value[field.name]) if field.name in value else None for field in port.fields]
        )
    except Refused:
        check_names(port, value)  # a wrong name is reported first; checked late, so that good commands pay nothing
        raise
    if not value or len(value) > len(items) - items.count(None):
        check_names(port, value)
    return items


def check_names(port: Port, value: Mapping[str, object]) -> None:
    """Refuse a command without fields, or with a field that the port does not have."""
    names = [field.name for field in port.fields]
    for key in value:
        if key not in names:
            word = shown(key)
            raise Refused(
                "bad_argument",
                f'"{port.path}" has no field "{word}"{suggestion(word, names)}; it takes: {", ".join(names)}',
                word,
            )
    if not value:
        raise Refused("bad_argument", f'no field is given for "{port.path}"; it takes: {", ".join(names)}', port.path)


def _checked_item(field: Field, value: object) -> Item:
    if field.type in _NUMERIC:
        return _checked_field(field, field.shape, value)
    item = _text(field.name, value) if field.type == "str" else _checked_packed(field, value)
    try:
        size = len(item.encode() if isinstance(item, str) else item.data)
    except UnicodeEncodeError:
        raise Refused(
            "bad_argument", f'"{field.name}" has half a surrogate pair, which cannot be sent as UTF-8', field.name
        ) from None
    if size > field.most_bytes:
        raise Refused(
            "too_large",
            f'"{field.name}" has {size} bytes; at most {field.most_bytes} are allowed: send it in pieces',
            field.name,
        )
    return item


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise Refused("bad_argument", f'"{name}" must be a text, not {_kind(value)}', name)
    return value


def _checked_packed(field: Field, value: object) -> Buffer:
    name, layout = field.name, field.buffer
    try:
        if isinstance(value, dict):
            value = unpacked(value)
        elif isinstance(value, bytes):
            value = Buffer(data=value)
        elif layout and hasattr(value, "dtype") and hasattr(value, "astype"):
            array: Any = value  # an array of a caller in the same process
            value = Buffer.of(array)
        if not isinstance(value, Buffer) or (value.dtype and not layout):
            form = f'"dtype": "{layout.dtype}", "shape": [...], ' if layout else ""
            what = "a buffer" if layout else "bytes"
            raise ValueError(f'must be {what}, in JSON {{{form}"base64": "..."}}, not {_kind(value)}')
        if not layout:
            return value
        if not value.dtype:
            value = layout.shaped(value.data)
    except ValueError as error:
        raise Refused("bad_argument", f'"{name}": {str(error)[:300]}', name) from None
    if not layout.fits(value):
        raise Refused("bad_shape", f'"{name}" must be {layout}, not {value.dtype} {list(value.shape)}', name)
    if not value.is_finite():
        raise Refused("not_finite", f'"{name}" has an item that is not a finite number', name)
    return value


def _checked_field(field: Field, shape: tuple[int, ...], value: object) -> tuple[float, ...]:
    if hasattr(value, "tolist"):
        value = value.tolist()  # an array of a caller in the same process
    if len(shape) == 1 and isinstance(value, list | tuple) and len(value) == shape[0] and _are_plain(field, value):
        return tuple(value)
    flat = _flatten(value, shape, field.name)
    if not all(map(math.isfinite, flat)):
        raise Refused("not_finite", f'"{field.name}" has a component that is not a finite number', field.name)
    if field.minimum is not None or field.maximum is not None:
        _check_range(field, min(flat))
        _check_range(field, max(flat))
    if field.is_rotation and math.hypot(*flat) < 1e-6:
        raise Refused(
            "out_of_range",
            f'"{field.name}" has zero length: a rotation is a quaternion w x y z that is not zero',
            field.name,
        )
    return flat


def _are_plain(field: Field, numbers: Sequence[object]) -> bool:
    """Return whether these are floats within the limits of the field, and not a rotation. Most commands are so, and need no further check.

    This one loop takes a third of the time of the checks that can say what is wrong.
    """
    low = -_LARGEST if field.minimum is None else field.minimum
    high = _LARGEST if field.maximum is None else field.maximum
    for number in numbers:
        if type(number) is not float or not low <= number <= high:
            return False
    return len(numbers) != 4 or not field.is_rotation


def _check_range(field: Field | Argument, number: float) -> None:
    low, high = field.minimum, field.maximum
    if (low is not None and number < low) or (high is not None and number > high):
        bounds = (("at least", low), ("at most", high))
        limits = " and ".join(f"{word} {bound:g}" for word, bound in bounds if bound is not None)
        unit = "" if field.unit == "1" else f" {field.unit}"
        raise Refused("out_of_range", f'"{field.name}" must be {limits}{unit}, not {number:.12g}', field.name)


def _flatten(value: object, shape: Sequence[int], name: str) -> tuple[float, ...]:
    if not shape:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise Refused("bad_shape", f'"{name}" must be a number, not {_kind(value)}', name)
        try:
            return (float(value),)
        except OverflowError:
            raise Refused("not_finite", f'"{name}" is too large', name) from None
    if not isinstance(value, list | tuple) or len(value) != shape[0]:
        found = f"a list of {len(value)}" if isinstance(value, list | tuple) else _kind(value)
        raise Refused("bad_shape", f'"{name}" must be a list of {shape[0]}, not {found}', name)
    return tuple(number for item in value for number in _flatten(item, shape[1:], name))


def _kind(value: object) -> str:
    if value is None:
        return "null"
    names = {
        bool: "a boolean",
        str: "a text",
        dict: "a map",
        list: "a list",
        tuple: "a list",
        int: "a number",
        float: "a number",
        bytes: "bytes",
        Buffer: "a buffer",
    }
    return names.get(type(value), f"a {type(value).__name__}")


def checked_args(service: Service, args: Mapping[str, object]) -> dict[str, Json]:
    """Return the arguments of a call, with defaults filled in.

    Raises:
        Refused: unknown or missing argument, wrong type, not finite, out of range.
    """
    if not isinstance(args, Mapping):
        raise Refused("bad_argument", '"args" must be a map', service.path)
    known = {argument.name: argument for argument in service.arguments}
    for key in args:
        if key not in known:
            takes = ", ".join(known) or "none"
            word = shown(key)
            raise Refused(
                "bad_argument",
                f'"{service.path}" has no argument "{word}"{suggestion(word, known)}; it takes: {takes}',
                word,
            )
    checked: dict[str, Json] = {}
    for name, argument in known.items():
        if name in args:
            checked[name] = _checked_argument(argument, args[name])
        elif argument.required:
            raise Refused("bad_argument", f'"{service.path}" needs "{name}": {argument.doc}', name)
        else:
            checked[name] = argument.default
    return checked


def check_still(service: Service, args: Mapping[str, Json]) -> None:
    """Check arguments again, after a service of the same path has replaced the one that they were checked against.

    Raises:
        Refused: it takes other arguments, or one has the wrong type or is out of range. Arguments of type "json" are not checked again.
    """
    if args.keys() != {argument.name for argument in service.arguments}:
        raise Refused(
            "bad_argument",
            f'"{service.path}" takes other arguments than when this was sent: {", ".join(a.name for a in service.arguments) or "none"}',
            service.path,
        )
    for argument in service.arguments:
        value = args[argument.name]
        is_default = not argument.required and value == argument.default
        if argument.type != "json" and not is_default:
            _checked_argument(argument, value)


def _checked_json(name: str, value: object) -> Json:
    """Return a copy of a value, which must be possible in JSON. Values of binary encodings may hold bytes, which JSON cannot.

    msgspec's compiled code looks for bytes: a Python loop over a long mission would delay a tick.
    """
    try:
        plain: Json = msgspec.to_builtins(value)  # this turns bytes into texts
        is_same = plain == msgspec.to_builtins(value, builtin_types=(bytes, bytearray, memoryview))
    except (TypeError, ValueError, RecursionError) as error:
        raise Refused("bad_argument", f'"{name}" cannot be written as JSON: {str(error)[:200]}', name) from None
    if not is_same:
        raise Refused("bad_argument", f'"{name}" must not hold bytes: send them as a text in base64', name)
    return plain


def _checked_argument(argument: Argument, value: object) -> Json:
    name = argument.name
    if argument.type == "json":
        return _checked_json(name, value)
    if argument.type == "bool":
        if not isinstance(value, bool):
            raise Refused("bad_argument", f'"{name}" must be true or false, not {_kind(value)}', name)
        return value
    if argument.type == "str":
        choice = _text(name, value)
        if argument.choices and choice not in argument.choices:
            word = shown(choice)
            hint = suggestion(word, argument.choices)
            raise Refused("bad_argument", f'"{name}" is one of {", ".join(argument.choices)}, not "{word}"{hint}', name)
        return choice
    flat = _checked_field(Field(name, argument.unit, argument.doc, "", argument.shape), argument.shape, value)
    for number in flat:
        if argument.type == "int" and number != int(number):
            raise Refused("bad_argument", f'"{name}" must be a whole number, not {number:.12g}', name)
        _check_range(argument, number)
    numbers: list[Json] = [int(number) if argument.type == "int" else number for number in flat]
    if argument.shape:
        return numbers
    if argument.type == "int" and isinstance(value, int):
        return value  # not by way of a float, which is not exact above 2**53
    return numbers[0]


def check_values(fields: Sequence[Field], values: Sequence[Value]) -> None:
    """Check that values fit the fields of a sensor; a component may be missing (None).

    Raises:
        ValueError: a wrong number of fields or components, or a wrong type.
    """
    if len(values) != len(fields):
        raise ValueError(f"{len(values)} values for {len(fields)} fields")
    for field, value in zip(fields, values, strict=True):
        if isinstance(value, Buffer):
            fits = field.is_packed and field.holds(value)
        else:
            parts = value if isinstance(value, tuple) else (value,)
            shaped = len(parts) == field.size and isinstance(value, tuple) == bool(field.shape)
            fits = shaped and all(part is None or type(part) in _KINDS[field.type] for part in parts)
        if not fits:
            raise ValueError(f'"{field.name}" has the wrong type or shape')


_KINDS: Mapping[str, tuple[type, ...]] = {
    "float": (float, int), "int": (int,), "bool": (bool,), "str": (str,), "bytes": (), "buffer": (),
}  # fmt: skip


def check_given(fields: Sequence[Field], given: Items) -> None:
    """Check that items are a checked command for these fields.

    Raises:
        ValueError: a wrong number of fields or components, or a wrong type.
        Refused: not finite, or out of range.
    """
    if len(given) != len(fields):
        raise ValueError(f"{len(given)} values for {len(fields)} fields")
    for field, value in zip(fields, given, strict=True):
        if value is None:
            continue
        numeric = field.type != "str" and not field.is_packed
        if numeric != isinstance(value, tuple):
            raise ValueError(f'"{field.name}" has the wrong type')
        if numeric:  # items are flat, and a scalar is a tuple too
            _checked_field(field, field.shape if len(field.shape) == 1 else (field.size,), value)
        else:
            _checked_item(field, value)


def bind(port: str, fields: Sequence[Field], *names: str) -> tuple[int, ...]:
    """Return the places of fields in the value of each sample of a port. A component calls it once, when the world is built.

    Raises:
        ValueError: the port has no such field; the text suggests a similar one and lists all.
    """
    known = [field.name for field in fields]
    for name in names:
        if name not in known:
            raise ValueError(f'"{port}" has no field "{name}"{suggestion(name, known)}; it has: {", ".join(known)}')
    return tuple(known.index(name) for name in names)

"""Makes the pages of the Python interfaces from signatures, type hints and docstrings; `reference_docs.py` writes them."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any, NamedTuple

import msgspec

OURS = ("uwserver", "uwclient")
"""Members that a class has from other packages, such as those of a Mapping, are not listed."""
WIDE = 100
"""Longer signatures have a line for each parameter."""
SECTIONS = ("Args", "Attributes", "Returns", "Yields", "Raises")
_SECTION = re.compile(rf"^({'|'.join(SECTIONS)}):\n", re.M)
_ENTRY = re.compile(r"^(\*{0,2}[\w.]+(?:, \*{0,2}[\w.]+)*): (.*)$", re.S)
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


class Subject(NamedTuple):
    """A part of a page.

    Attributes:
        title: heading.
        module: where its names are imported from.
        names: in their order.
    """

    title: str
    module: str
    names: tuple[str, ...]


class Page(NamedTuple):
    """A page.

    Attributes:
        title: first heading.
        text: introduction.
        subjects: its parts.
    """

    title: str
    text: str
    subjects: tuple[Subject, ...]


PYTHON = Page(
    "Python: worlds in your own process",
    """\
`uwserver.load` gives a world that your program steps. Numbers are SI, angles in rad; N is north-east-down, B the body
(forward, right, down); quaternions are w x y z. `world.describe()` lists what a world has, and `help()` shows the same texts as this page.
The [tutorial](../tutorial.md), [batches](../how-to/batch.md) and [states](../how-to/states.md) show how the parts belong together.""",
    (
        Subject("Load", "uwserver", ("load", "batch")),
        Subject("World", "uwserver", ("World", "Vehicle", "Pose", "Velocity")),
        Subject("Readings and recordings", "uwserver", ("Reading", "Traces", "Trace")),
        Subject("Clients", "uwserver", ("Serving",)),
        Subject("Many worlds", "uwserver", ("Batch",)),
        Subject("Scenarios from Python", "uwserver", ("ScenarioBuilder",)),
        Subject("Errors", "uwserver", ("Refused", "ScenarioError", "Diverged")),
    ),
)
CLIENT = Page(
    "Python: the client",
    """\
`uwclient` talks to a server over TCP or zenoh. It imports nothing of uwserver and needs no other package.
The [client's page](../../clients/python/README.md) has examples and the command `uwclient`.""",
    (
        Subject("Connect", "uwclient", ("connect", "connect_zenoh", "connect_zenoh_async", "tls_context")),
        Subject("Clients", "uwclient", ("Client", "AsyncClient")),
        Subject(
            "What a server has",
            "uwclient",
            ("Description", "Port", "Field", "Propulsor", "Service", "Argument", "Subscription"),
        ),
        Subject("What comes from it", "uwclient", ("Sample", "Buffer", "Event", "Ack", "Progress")),
        Subject("Errors", "uwclient", ("UwError", "CallRefused", "ConnectionLost", "ProtocolError", "Timeout")),
    ),
)
ADAPTERS = Page(
    "Python: adapters",
    """\
[Write an adapter](../how-to/write-an-adapter.md) has a complete one. An adapter imports only `uwserver.adapter`, `uwserver.ports`,
`uwserver.frames`, `uwserver.units` and `uwserver.table`.""",
    (
        Subject(
            "The contract",
            "uwserver.adapter",
            ("Adapter", "AdapterContext", "Subscriber", "AdapterTable", "AdapterStats", "WorldFacts", "VehicleFacts", "Driver", "Order"),
        ),
        Subject(
            "What crosses the wall",
            "uwserver.ports",
            ("Port", "Field", "Propulsor", "Layout", "Service", "Argument", "Sample", "Buffer", "Command", "Call", "Reply", "Progress", "Event",
             "Fault", "Refused", "matches", "matching", "is_stop", "binary_form"),
        ),
        Subject(
            "What the world looks like",
            "uwserver.ports",
            ("SceneState", "EntityList", "Present", "SceneView", "BodyView", "SolidView", "ShapeView", "MeshView", "ModelFileView", "ActuatorView",
             "SensorView", "BeamView", "FanView", "LampView", "BeaconView", "WaterView", "WaveView", "OriginView"),
        ),
        Subject(
            "Find adapters", "uwserver.adapter", ("installed_adapters", "load_adapter", "adapter_entries", "AdapterNotFound")
        ),
        Subject(
            "A base, and conversations",
            "uwserver.adapter",
            ("AdapterBase", "Conversation", "InFlightLimit", "Refusals", "CannotServe", "did_you_mean", "check_path", "install_command"),
        ),
        Subject(
            "Samples",
            "uwserver.adapter",
            ("Readings", "Reading", "SampleBatch", "Origin", "Decimation", "SampleForm", "in_pieces", "raw_field", "port_of", "port_of_kind",
             "field_of", "vehicle_of", "vehicles_of", "choose", "NotMet"),
        ),
        Subject(
            "Listen",
            "uwserver.adapter",
            ("TcpListener", "Connection", "serve_tcp", "serving", "bound_socket", "CannotListen", "cannot_listen", "note_no_descriptors",
             "address_text", "host_here", "host_name", "host_of", "is_host_known", "is_loopback", "may_connect", "Peers", "Peer", "RateMeter",
             "TurnTimes", "within", "SerialPort"),
        ),
        Subject(
            "Access",
            "uwserver.adapter",
            ("OpenTable", "TokenTable", "NodeTable", "Lockout", "Token", "token_for", "known_token", "new_token", "tls_context"),
        ),
        Subject(
            "Framing",
            "uwserver.adapter",
            ("Frames", "Lines", "frame", "line", "json_member", "msgpack_member", "decode", "TooLong", "Undecodable", "FirstBytes", "http_answer"),
        ),
        Subject(
            "Work in turns and in threads",
            "uwserver.adapter",
            ("InputTurns", "DatagramTurns", "BackgroundWork", "Worker", "Inbox", "InOrder", "LogFile"),
        ),
        Subject(
            "Test your own components",
            "uwserver.testing",
            ("check_adapter", "check_codec", "CodecCase", "Requests", "check_sensor", "check_actuator", "check_modifier", "check_current",
             "FakeContext", "FakeGeometry", "MockTime", "Loopback", "TcpPeer", "sample_of"),
        ),
    ),
)  # fmt: skip
PAGES = {"python.md": PYTHON, "python-client.md": CLIENT, "python-adapters.md": ADAPTERS}


def api_page(page: Page) -> str:
    """Return a page as Markdown."""
    lines = [f"# {page.title}", "", page.text, ""]
    for subject in page.subjects:
        lines += ["", f"## {subject.title}", ""]
        module = importlib.import_module(subject.module)
        for name in subject.names:
            lines += _entry(name, getattr(module, name))
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).rstrip() + "\n"


# -- entries ----------------------------------------------------------------------------------------------------------------------------


def _entry(name: str, thing: Any) -> Iterator[str]:
    yield f"### `{name}`"
    yield ""
    if not inspect.isclass(thing):
        yield from _function(name, thing)
        return
    if is_called(thing):
        yield from code(signature(name, thing.__init__, without_self=True, returns=False))
    doc = Docstring(inspect.getdoc(thing) or "")
    yield from doc.lines()
    if is_called(thing) and (made := thing.__init__.__doc__):
        yield from Docstring(inspect.cleandoc(made)).lines(only=("Args", "Raises"))
    members = dict(public_members(thing))
    told = doc.names("Attributes")
    properties = {
        key: value
        for key, value in members.items()
        if isinstance(value, (property, cached_property)) and key not in told
    }
    for key, value in properties.items():
        getter = value.fget if isinstance(value, property) else value.func
        text = " ".join(Docstring(inspect.getdoc(value) or "").whole.replace("``", "`").split())
        yield f"- **`{key}`**{_type(getter.__annotations__.get('return'))} {text}"
    if properties:
        yield ""
    for key, value in members.items():
        if key not in properties and key not in told:
            yield f"#### `{name}.{key}`"
            yield ""
            yield from _function(key, value)


def _function(name: str, function: Any) -> Iterator[str]:
    bound = inspect.ismethod(function) and function.__self__ is not None
    raw = (
        function.__func__
        if isinstance(function, (classmethod, staticmethod)) or inspect.ismethod(function)
        else function
    )
    yield from code(signature(name, raw, without_self=bound or not isinstance(function, staticmethod)))
    yield from Docstring(inspect.getdoc(raw) or "").lines()


def is_called(thing: type[Any]) -> bool:
    """Return whether users make objects of a class, so that its parameters are shown: one that is documented, or plain data."""
    is_plain = dataclasses.is_dataclass(thing) or issubclass(thing, (msgspec.Struct, tuple, BaseException))
    own = thing.__dict__.get("__init__")
    return not is_plain and own is not None and "Args:" in (own.__doc__ or "")


def public_members(thing: type[Any]) -> Iterator[tuple[str, Any]]:
    """Yield methods and properties of a class that are ours and public, in the order of the source, the class before its bases."""
    seen: set[str] = set()
    for owner in thing.__mro__:
        if owner.__module__.partition(".")[0] not in OURS:
            continue
        for name, value in vars(owner).items():
            is_member = inspect.isfunction(value) or isinstance(
                value, (property, cached_property, classmethod, staticmethod)
            )
            if is_member and not name.startswith("_") and name not in seen:
                seen.add(name)
                yield name, value


# -- signatures -------------------------------------------------------------------------------------------------------------------------


def signature(name: str, function: Any, *, without_self: bool = False, returns: bool = True) -> str:
    """Return a signature with its type hints as they stand in the source."""
    known = inspect.signature(function)
    parameters = list(known.parameters.values())
    if without_self and parameters and parameters[0].name in ("self", "cls"):
        parameters = parameters[1:]
    parts: list[str] = []
    before = None
    for parameter in parameters:
        if before is inspect.Parameter.POSITIONAL_ONLY and parameter.kind is not before:
            parts.append("/")
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY and before not in (
            parameter.kind,
            inspect.Parameter.VAR_POSITIONAL,
        ):
            parts.append("*")
        before = parameter.kind
        parts.append(_parameter(parameter))
    if before is inspect.Parameter.POSITIONAL_ONLY:
        parts.append("/")
    result = "" if not returns or known.return_annotation is known.empty else f" -> {_text(known.return_annotation)}"
    line = f"{name}({', '.join(parts)}){result}"
    return line if len(line) <= WIDE else f"{name}(\n" + "".join(f"    {part},\n" for part in parts) + f"){result}"


def _parameter(parameter: inspect.Parameter) -> str:
    star = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    hint = "" if parameter.annotation is parameter.empty else f": {_text(parameter.annotation)}"
    if parameter.default is parameter.empty:
        return f"{star}{parameter.name}{hint}"
    return f"{star}{parameter.name}{hint}{' = ' if hint else '='}{_ADDRESS.sub('', repr(parameter.default))}"


def _text(annotation: object) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def _type(annotation: object) -> str:
    return ":" if annotation is None else f" (`{_text(annotation)}`):"


def code(text: str) -> Iterable[str]:
    """Return a block of Python."""
    return ("```python", text, "```", "")


# -- docstrings -------------------------------------------------------------------------------------------------------------------------


class Docstring:
    """A docstring in Google style, as Markdown."""

    def __init__(self, text: str) -> None:
        """Take a cleaned docstring."""
        pieces = _SECTION.split(text)
        self.whole = pieces[0].strip()
        self._sections: dict[str, list[str]] = {}
        for title, body in zip(pieces[1::2], pieces[2::2], strict=True):
            section, rest = _until_dedent(body)
            self._sections[title] = _entries(section)
            self.whole = f"{self.whole}\n\n{rest}".strip()

    def names(self, section: str) -> set[str]:
        """Return the names that a section lists."""
        found = (_ENTRY.match(entry) for entry in self._sections.get(section, ()))
        return {name.strip() for match in found if match for name in match[1].split(",")}

    def lines(self, only: Iterable[str] | None = None) -> Iterator[str]:
        """Yield lines of Markdown: the text and its sections, or some sections alone."""
        if only is None and self.whole:
            yield from _prose(self.whole)
            yield ""
        for title in SECTIONS if only is None else only:
            entries = self._sections.get(title)
            if entries:
                yield f"**{title}**"
                yield ""
                for entry in entries:
                    match = _ENTRY.match(entry) if title not in ("Returns", "Yields") else None
                    yield f"- `{match[1].replace(', ', '`, `')}`: {match[2]}" if match else f"- {entry}"
                yield ""


def _until_dedent(body: str) -> tuple[str, str]:
    lines = body.split("\n")
    end = next((k for k, line in enumerate(lines) if line and not line.startswith(" ")), len(lines))
    return "\n".join(lines[:end]), "\n".join(lines[end:]).strip()


def _entries(section: str) -> list[str]:
    """Return the entries of a section, each on one line."""
    entries: list[str] = []
    text = inspect.cleandoc("\n" + section)
    for line in text.split("\n"):
        if line.startswith(" ") and entries:
            entries[-1] += " " + line.strip()
        elif line.strip():
            entries.append(line.strip())
    return [entry.replace("``", "`") for entry in entries]


def _prose(text: str) -> Iterator[str]:
    """Yield paragraphs, with blocks of code after ``::`` between fences."""
    is_code = False
    for paragraph in text.split("\n\n"):
        block = is_code and paragraph.startswith("    ")
        if is_code and not block:
            is_code = False
        if block:
            yield from code(inspect.cleandoc("\n" + paragraph))
            continue
        begins = paragraph.rstrip().endswith("::")
        plain = paragraph.rstrip().removesuffix("::") + ":" if begins else paragraph
        if plain.lstrip().startswith(">>>"):
            yield from code(plain)
        else:
            yield " ".join(plain.replace("``", "`").split())
            yield ""
        is_code = begins

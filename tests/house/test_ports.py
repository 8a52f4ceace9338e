"""What a port says of its fields: units, frames, texts. The only rules for which something is imported: a world with one of every kind."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping

import pytest

from uwserver.adapter import installed_adapters
from uwserver.ports import Field, Port
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.world import World

UNITS = {
    "1", "m", "m/s", "m/s^2", "rad", "rad/s", "rad/s^2", "N", "N m", "Pa", "degC", "s", "Hz", "kg", "T", "V", "A", "W", "m^3",
    "mm", "m^2/s^2", "J", "N s", "S/m", "m^2", "ns", "dB", "N, N m",
}  # fmt: skip


@pytest.fixture(scope="module")
def whole() -> World:
    """The world of `one_of_everything`."""
    from uwserver.actuators import ForceTorqueConfig
    from uwserver.sensors import SensorConfig

    world = build(load("one_of_everything", adapters=installed_adapters()))
    kinds = {port.kind for port in world.ports.values()}
    tags = {str(config.__struct_config__.tag) for config in (*SensorConfig.__args__, ForceTorqueConfig)}  # type: ignore[attr-defined]
    assert tags <= kinds, "one_of_everything has lost a kind"
    return world


def fields(ports: Mapping[str, Port]) -> Iterable[tuple[str, Port, Field]]:
    """Each with where it is."""
    return ((f"{path}.{field.name}", port, field) for path, port in ports.items() for field in port.fields)


def test_every_field_has_unit_and_text(whole: World) -> None:
    """A number without unit is a guess."""
    for where, _, field in fields(whole.ports):
        assert field.unit in UNITS, f'{where}: unit "{field.unit}"'
        assert field.doc.strip(), where


def is_list(port: Port, field: Field) -> bool:
    """Whether its numbers are of things of one kind: its name is plural, or its text says their order. Or they are of the six axes of a vehicle, by
    which its autopilot is told what to do: these are of B by their nature."""
    named = field.name.endswith("s") or "order: " in field.doc
    return bool(field.shape) and (named or (port.kind == "autopilot" and field.shape == (6,)))


def misframed(ports: Mapping[str, Port]) -> list[str]:
    """Fields that have no frame though they need one, or the other way round. Three components without frame are a guess; one number has none."""
    return [
        f'{where} has the frame "{field.frame}"'
        for where, port, field in fields(ports)
        if (field.frame != "") != (bool(field.shape) and not is_list(port, field))
    ]


def test_every_vector_has_a_frame_and_no_list_has_one(whole: World) -> None:
    assert misframed(whole.ports) == []


def misnamed(ports: Mapping[str, Port]) -> list[str]:
    """Fields whose names do not end in their frame. Of places, velocities and attitudes the name says of what they are too (`p_NB`), but for those
    of many things (`velocities_N`), and for an autopilot's, which are of its own vehicle."""
    wrong = []
    for where, port, field in fields(ports):
        if field.frame in ("B", "S"):
            word = rf"\w+_{field.frame}"
        else:
            word = r"[pqv](_ref)?_NB?" if port.kind == "autopilot" else r"(\w+_)?[pqv]_N[BS]|\w+s_N"
        if field.frame and not re.fullmatch(word, field.name):
            wrong.append(f"{where} in {field.frame}")
    return wrong


def test_names_of_vectors_end_in_their_frame(whole: World) -> None:
    """Monogram notation: what is seen on the wire says in which frame it is."""
    assert misnamed(whole.ports) == []


def port_of(kind: str, field: Field) -> dict[str, Port]:
    return {"rov/it": Port("rov/it", "sensor", kind, (field,), "it")}


def test_a_field_that_says_too_little_is_found() -> None:
    def field(name: str, frame: str = "", shape: tuple[int, ...] = (3,), doc: str = "it") -> Field:
        return Field(name, unit="m/s", frame=frame, shape=shape, doc=doc)

    for wrong in (field("v"), field("v", shape=(6,)), field("speeds", "B"), field("speed", "B", ())):
        assert len(misframed(port_of("imu", wrong))) == 1
    for right in (field("v_B", "B"), field("speeds"), field("u", doc="order: a, b, c"), field("speed", shape=())):
        assert misframed(port_of("imu", right)) == []
    for wrong in (field("v", "B"), field("v_S", "B"), field("v_N", "N"), field("place_N", "N"), field("x_NB", "N")):
        assert len(misnamed(port_of("imu", wrong))) == 1
    for right in (field("v_water_S", "S"), field("p_NB", "N"), field("gps_v_NS", "N"), field("velocities_N", "N")):
        assert misnamed(port_of("imu", right)) == []


def test_every_service_and_argument_has_a_text(whole: World) -> None:
    for path, service in whole.services.items():
        assert inspect.cleandoc(service.doc).endswith("."), path
        for argument in service.arguments:
            assert argument.doc, f"{path} {argument.name}"
            assert argument.unit, f"{path} {argument.name}"

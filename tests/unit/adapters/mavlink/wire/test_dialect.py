"""The dialect: numbers of enumerations and their names."""

from __future__ import annotations

import pytest
from uwserver_adapters.mavlink.vehicle.modes import CAPABILITIES, MODES

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from uwserver_adapters.mavlink.wire.dialect import Dialect, Entry


@pytest.fixture(scope="module")
def dialect() -> Dialect:
    return Dialect()


def test_a_name_is_sent_as_its_number(dialect):
    layout = dialect.by_name["COMMAND_ACK"]
    named = {"command": "MAV_CMD_DO_SET_SERVO", "result": "MAV_RESULT_DENIED"}
    assert layout.encode(named) == layout.encode({"command": 183, "result": 2})


def test_a_name_that_the_dialect_has_not_is_a_mistake_of_ours(dialect):
    with pytest.raises(KeyError):
        dialect.by_name["COMMAND_ACK"].encode({"result": "MAV_RESULT_PERHAPS"})
    with pytest.raises(KeyError):
        dialect.entry("MAV_CMD_DO_PERHAPS")


@pytest.mark.parametrize(("number", "name"), [(183, "MAV_CMD_DO_SET_SERVO"), (65_000, "")])
def test_a_number_comes_with_its_name_if_it_has_one(dialect, number, name):
    layout = dialect.by_name["COMMAND_LONG"]
    assert layout.decode(layout.encode({"command": number}), 255, 190).entry("command") == Entry(number, name)


def test_names_of_modes_and_capabilities_are_in_the_dialect(dialect):
    assert [dialect.numbers[mode.entry] for mode in MODES] == [0, 1, 2, 3, 4, 9, 16, 19, 21]
    assert sum(dialect.numbers[f"MAV_PROTOCOL_CAPABILITY_{name}"] for name in CAPABILITIES) == 0x29EF

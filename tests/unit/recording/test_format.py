"""The format of a recording by itself: entries, the head record both ways, channels and their schemas. What is written is in test_recorder."""

from __future__ import annotations

import io
import json

import jsonschema
import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from uwserver.physics import PHYSICS
from uwserver.physics.collision import engine
from uwserver.physics.collision.engine import chosen_engine
from uwserver.ports import Buffer, Call, Command, Event, Field, Layout, Port, Sample
from uwserver.recording.format import (
    EVENTS,
    FORMAT,
    HASHES,
    REQUESTS,
    Request,
    StateHash,
    head_of,
    metadata,
    versions_here,
)
from uwserver.recording.states import JUMPS
from uwserver.recording.writer import RecordingWriter
from uwserver.simulation.clock import Timing

SENSOR = Port(
    "rov/eye", "sensor", "eye",
    (
        Field("range", "m", "distance"),
        Field("w_S", "rad/s", "rate", "S", (3,)),
        Field("matrix", "1", "matrix", shape=(2, 3)),
        Field("name", "1", "of what is seen", type="str"),
        Field("picture", "1", "picture", type="buffer", buffer=Layout("uint8", (-1, 2))),
    ),
    "Eye.", 10.0,
)  # fmt: skip
ACTUATOR = Port("rov/arm", "actuator", "arm", (Field("angle", "rad", "of the joint"),), "Arm.")
PICTURE = Buffer.of(np.array([[1, 2], [3, 4]], np.uint8))


@pytest.mark.parametrize(
    "item", [Command("rov/arm", ((0.5,),), "tcp:1"), Call("world/restore", {"name": "a"}, "tcp:2"), Call("world/reset", {}, "")]
)  # fmt: skip
def test_a_request_is_the_command_or_call_again(item: Command | Call):
    request = Request.of(item, 7, 3, 240)
    assert (request.index, request.batch, request.tick, request.source) == (7, 3, 240, item.source)
    assert request.item == item
    again = msgspec.json.decode(msgspec.json.encode(request), type=Request)
    assert json.loads(msgspec.json.encode(again)) == json.loads(msgspec.json.encode(request))


def test_the_head_comes_back_as_the_run_it_was(resolved):
    timing = Timing(mode="freerun", paused=True)
    head = head_of(metadata(resolved, 42, timing))
    assert (head.seed, head.timing["mode"], head.timing["paused"]) == (42, "freerun", True)
    assert msgspec.structs.replace(head.versions, started_utc="") == msgspec.structs.replace(
        versions_here(), started_utc=""
    )
    assert head.resolved.name == resolved.name
    world = msgspec.structs.replace(resolved.scenario.world, engine=chosen_engine())
    assert head.resolved.scenario == msgspec.structs.replace(resolved.scenario, world=world)
    assert head.resolved.vehicles["rov"].vehicle == resolved.vehicles["rov"].vehicle
    assert head.resolved.materials == resolved.materials


@pytest.mark.parametrize(("installed", "named"), [("pybullet", "bullet"), ("coal", "coal")])
def test_the_engine_that_auto_stands_for_is_named(resolved, installed: str, named: str, monkeypatch):
    """So that a replay where another one would be chosen does not go otherwise."""
    monkeypatch.setattr(engine, "find_spec", lambda name: name if name == installed else None)
    assert resolved.scenario.world.engine == "auto"
    assert head_of(metadata(resolved, 1, Timing())).resolved.scenario.world.engine == named


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("format", "uwserver-recording-1", f"whose format is uwserver-recording-1; here it is {FORMAT}"),
        ("physics", "0", f"whose physics is 0; here it is {PHYSICS}"),
        ("physics", None, "whose physics is 1; here it is"),
        ("scenario", None, "does not fit uwserver"),
        ("scenario", "{", "does not fit uwserver"),
        ("seed", "many", "does not fit uwserver"),
        ("timing", "[", "does not fit uwserver"),
        ("solids", "x", "does not fit uwserver"),
    ],
)
def test_another_head_is_refused_with_its_reason(resolved, key: str, value: str | None, told: str):
    record = metadata(resolved, 42, Timing())
    if value is None:
        del record[key]
    else:
        record[key] = value
    with pytest.raises(ValueError) as refused:
        head_of(record)
    assert told in str(refused.value)


def written() -> bytes:
    file = io.BytesIO()
    ports = {port.path: port for port in (SENSOR, ACTUATOR)}
    writer = RecordingWriter(file, {"format": FORMAT}, {SENSOR.path: SENSOR})
    value = (1.5, (0.0, None, 2.0), (1.0,) * 6, "wall", PICTURE)
    writer.sample(Sample(SENSOR.path, 2**32 + 1, 10, 30, True, value), ports)
    writer.sample(Sample(SENSOR.path, 2**32 + 2, 20, 40, False, (None,) * 5), ports)
    writer.request(Request.of(Command(ACTUATOR.path, ((0.5,),), "tcp:1"), 0, 0, 3), 12, ports)
    writer.request(Request.of(Call("world/reset", {}, "tcp:1"), 1, 1, 4), 16, ports)
    writer.hash(StateHash(2, 4, "ab"), 16)
    writer.event(Event("reset", 0, 16, "the world was reset"))
    writer.finish()
    return file.getvalue()


def test_every_message_stands_on_its_channel_at_its_time_and_fits_its_schema():
    found: dict[str, list[tuple[int, int, dict[str, object]]]] = {}
    for schema, channel, message in make_reader(io.BytesIO(written()), validate_crcs=True).iter_messages():
        said = json.loads(message.data)
        jsonschema.validate(said, json.loads(schema.data))
        found.setdefault(channel.topic, []).append((message.log_time, message.publish_time, said))
    assert set(found) == {SENSOR.path, ACTUATOR.path, REQUESTS, HASHES, EVENTS, JUMPS}
    assert found[JUMPS] == found[EVENTS], "where time was set"
    (log, published, first), (_, _, second) = found[SENSOR.path]
    assert (log, published) == (30, 10), "in the order in which samples were heard; with the time of which they tell"
    assert (first["seq"], first["valid"], first["value"]["range"]) == (2**32 + 1, True, 1.5)
    assert first["value"]["w_S"] == [0.0, None, 2.0]
    assert second["value"]["picture"] is None
    assert found[ACTUATOR.path] == [(12, 12, {"tick": 3, "source": "tcp:1", "value": {"angle": 0.5}})]
    assert [entry["index"] for _, _, entry in found[REQUESTS]] == [0, 1]
    assert found[HASHES][0][2] == {"index": 2, "tick": 4, "hash": "ab"}


def test_a_sample_of_another_number_of_values_is_a_fault_not_a_record():
    writer = RecordingWriter(io.BytesIO(), {"format": FORMAT}, {SENSOR.path: SENSOR})
    with pytest.raises(ValueError, match="zip"):
        writer.sample(Sample(SENSOR.path, 0, 1, 1, True, (1.0,)), {SENSOR.path: SENSOR})


def test_a_recording_of_the_format_before_is_still_replayed(resolved):
    """It has no states, of which a replay needs none."""
    record = {**metadata(resolved, 42, Timing()), "format": "uwserver-recording-2"}
    assert head_of(record).seed == 42
    with pytest.raises(ValueError, match="uwserver-recording-1"):
        head_of({**record, "format": "uwserver-recording-1"})

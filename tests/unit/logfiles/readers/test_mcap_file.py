"""MCAP files of ours and of others. Also of uwserver.logfiles.readers.mcap_records."""

import io
import json
import struct
import sys
from contextlib import closing

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.writer import Writer as ProtobufWriter

from uwserver.adapter.foxglove import SceneChannels
from uwserver.logfiles import LogError, open_log
from uwserver.logfiles.readers.mcap_file import OURS
from uwserver.packages import install_command
from uwserver.ports import Event, Field, Port, Sample
from uwserver.recording import writer as recording

S = 1_000_000_000
UTC = 1_760_000_000 * S
POSE = Port(
    "rov/truth/pose",
    "sensor",
    "pose",
    (Field("p_NB", "m", "Where.", "N", (3,)), Field("q_NB", "1", "How.", "NB", (4,))),
    "Pose.",
)


class Viewers:
    """The channels for viewers, of which only that of events is written."""

    def of(self, item, port=None):
        if isinstance(item, Event):
            yield SceneChannels({}.__getitem__, {}.__getitem__).event(item)

    def shows(self, port):
        return False


def ours(times_ns, finish=True, foxglove=None):
    """A recording of a pose at these times, by the recorder's own writer."""
    file = io.BytesIO()
    head = {"format": "x", "scenario": json.dumps({"scenario": {"world": {"epoch_utc": "2026-01-01T00:00:00Z"}}})}
    writer = recording.RecordingWriter(file, head, {POSE.path: POSE}, foxglove)
    for k, t in enumerate(times_ns):
        value = ((0.1 * k, 0.0, 2.0), (1.0, 0.0, 0.0, 0.0))
        writer.sample(Sample(POSE.path, k, t, t, True, value), {POSE.path: POSE})
        if k % 50 == 0:
            writer.flush()
    writer.event(Event("paused", 1, times_ns[-1], "by hand"))
    if finish:
        writer.finish()
    else:
        writer.flush()
    return file.getvalue()


def theirs(compression=CompressionType.ZSTD, chunked=True, count=200, index=True, schema=True):
    file = io.BytesIO()
    writer = Writer(file, chunk_size=1024, compression=compression, use_chunking=chunked, use_statistics=index)
    writer.start("", "test")
    text = {
        "type": "object",
        "properties": {"x": {"type": "number"}, "pose": {"type": "object", "properties": {"y": {"type": "number"}}}},
    }
    number = writer.register_schema("Thing", "jsonschema", json.dumps(text).encode()) if schema else 0
    channels = [writer.register_channel(f"/thing/{k}", "json", number) for k in range(2)]
    for k in range(count):
        data = json.dumps({"x": k, "pose": {"y": -k}}).encode()
        writer.add_message(channels[k % 2], UTC + k * S // 10, data, UTC)
    writer.finish()
    return file.getvalue()


def test_our_own_recording(opened):
    assert OURS == recording.METADATA
    log = opened(ours([k * 20_000_000 for k in range(5, 200)]))
    assert log.kind == "uwserver"
    assert (log.start_ns, log.end_ns) == (100_000_000, 199 * 20_000_000)
    assert log.epoch_ns == 1_767_225_600 * S
    topic = log.topics[POSE.path]
    assert topic.count == 195
    fields = {f.name: f for f in topic.fields}
    assert (fields["value.p_NB"].unit, fields["value.p_NB"].frame, fields["value.p_NB"].type) == ("m", "N", "number[3]")
    data = list(log.read({POSE.path}, start_ns=S, end_ns=2 * S))
    assert [d.t_ns for d in data] == list(range(S, 2 * S + 1, 20_000_000))
    assert data[0].value["value"]["p_NB"] == [4.5, 0.0, 2.0]
    assert log.remarks == ()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_those_of_others_whatever_they_use(opened, compression, chunked):
    raw = theirs(compression, chunked)
    log = opened(raw)
    expected = [
        (c.topic, m.log_time - UTC, json.loads(m.data)) for _, c, m in make_reader(io.BytesIO(raw)).iter_messages()
    ]
    assert [(d.topic, d.t_ns, d.value) for d in log.read()] == expected
    assert (log.kind, log.epoch_ns, log.end_ns) == ("mcap", UTC, 19_900_000_000)
    assert [f.name for f in log.topics["/thing/1"].fields] == ["x", "pose.y"]
    assert [t.count for t in log.topics.values()] == [100, 100]


def test_without_index_or_schema_it_is_read_the_same(opened):
    whole = list(opened(theirs()).read())
    log = opened(theirs(index=False, schema=False))
    assert list(log.read()) == whole
    assert log.topics["/thing/0"].fields == ()


def test_a_damaged_index_is_not_needed(opened):
    raw = theirs()
    whole = list(opened(raw).read())
    start = struct.unpack_from("<Q", raw, len(raw) - 28)[0]
    log = opened(raw[: start + 9] + b"\xff" * 30 + raw[start + 39 :])
    assert list(log.read()) == whole
    assert "no whole index" in log.remarks[0]


def test_messages_that_were_written_out_of_order_come_in_order_of_their_times(opened):
    """Within a chunk, and over chunks that overlap; a jump back over many is told."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=300)
    writer.start("", "test")
    channel = writer.register_channel("/x", "json", 0)
    times = [(k * 7919) % 100 for k in range(100)]
    for t in times:
        writer.add_message(channel, UTC + t * S, json.dumps({"t": t}).encode(), UTC)
    writer.finish()
    log = opened(file.getvalue())
    assert [d.value["t"] for d in log.read()] == list(range(100))
    assert [d.value["t"] for d in log.read(start_ns=10 * S, end_ns=20 * S)] == list(range(10, 21))
    assert "log times go back within the file" in log.remarks[0]


def test_two_reads_at_once(opened):
    log = opened(theirs())
    one, two = log.read(), log.read({"/thing/1"})
    for _ in range(100):
        assert next(two).topic == "/thing/1"
        next(one)
    assert len(list(one)) == 100


def test_a_cut_file_gives_what_is_whole(opened):
    raw = ours([k * 20_000_000 for k in range(300)], finish=False)
    whole = list(opened(raw).read())
    assert len(whole) == 301
    for cut in range(800, len(raw), 611):
        try:
            log = opened(raw[:cut])
        except LogError:
            assert cut < 3000
            continue
        some = list(log.read())
        assert some == whole[: len(some)]
        assert "no whole index" in log.remarks[0]
        log.close()


def test_a_reset_of_our_world_is_told_and_time_goes_on(opened):
    times = [k * 20_000_000 for k in range(200)] * 2
    log = opened(ours(times))
    data = list(log.read({POSE.path}))
    assert len(data) == 400
    assert (np.diff([d.t_ns for d in data]) >= 0).all()
    assert log.end_ns == 2 * 199 * 20_000_000
    assert log.remarks[0] == "the clock was set back by 3.980 s at 3.980 s"


@pytest.mark.parametrize("finish", [True, False])
def test_a_recording_of_ours_needs_no_protobuf(tmp_path, monkeypatch, finish):
    """Its channels for viewers are in protobuf, and repeat what its own channels say."""
    (tmp_path / "run.mcap").write_bytes(ours([k * S // 10 for k in range(20)], finish, Viewers()))
    for module in ("google.protobuf", "google.protobuf.descriptor_pb2", "google.protobuf.descriptor_pool"):
        monkeypatch.setitem(sys.modules, module, None)
    with closing(open_log(tmp_path / "run.mcap")) as log:
        assert any(topic.schema.startswith("foxglove.") for topic in log.topics.values())
        assert not [remark for remark in log.remarks if "protobuf" in remark]


def test_a_log_of_others_says_what_is_missing_for_protobuf(tmp_path, monkeypatch):
    file = io.BytesIO()
    writer = ProtobufWriter(file)
    writer.write_message("/pose", PoseInFrame(), UTC)
    writer.finish()
    (tmp_path / "dive.mcap").write_bytes(file.getvalue())
    for module in ("google.protobuf", "google.protobuf.descriptor_pb2", "google.protobuf.descriptor_pool"):
        monkeypatch.setitem(sys.modules, module, None)
    with closing(open_log(tmp_path / "dive.mcap")) as log:
        (remark,) = log.remarks
    command = install_command("uwserver[logs]")
    assert remark == (
        f"/pose: its schema cannot be used: the package protobuf is missing: {command}; until then its messages are given as bytes"
    )


def test_protobuf_by_the_descriptors_in_the_file(tmp_path, read_log):
    with (tmp_path / "run.mcap").open("wb") as file, ProtobufWriter(file) as writer:
        for k in range(20):
            message = PoseInFrame(frame_id="N_enu")
            message.pose.position.x = k
            message.pose.orientation.w = 1.0
            writer.write_message("/pose", message, log_time=UTC + k * S, publish_time=UTC)
    log = read_log(tmp_path / "run.mcap")
    data = list(log.read())
    assert data[7].value["pose"]["position"] == {"x": 7.0, "y": 0.0, "z": 0.0}
    assert data[7].value["frame_id"] == "N_enu"
    assert "pose.orientation.w" in {f.name for f in log.topics["/pose"].fields}
    assert log.topics["/pose"].schema == "foxglove.PoseInFrame"


def test_what_cannot_be_decoded_is_given_as_bytes_and_told(opened):
    file = io.BytesIO()
    writer = Writer(file)
    writer.start("", "test")
    kinds = [
        ("flatbuffer", "flatbuffer", b"x"),
        ("protobuf", "protobuf", b"\xff\xff"),
        ("cdr", "ros2msg", b"!!"),
        ("json", "jsonschema", b"{"),
    ]
    for name, schema, text in kinds:
        number = writer.register_schema("evil/msg/A", schema, text)
        channel = writer.register_channel(f"/{name}", name, number)
        writer.add_message(channel, UTC, b"\x01\x02", UTC)
    writer.finish()
    log = opened(file.getvalue())
    assert all(d.value == {"data": b"\x01\x02"} for d in log.read())
    assert len(log.remarks) == 4
    assert all("bytes" in remark for remark in log.remarks)


def test_names_of_types_never_become_code(opened):
    file = io.BytesIO()
    writer = Writer(file)
    writer.start("", "test")
    for k, name in enumerate(('a/msg/B"""\nimport os\nos._exit(7)\n"""', "a/msg/B:\n  x=1", "../x")):
        number = writer.register_schema(name, "ros2msg", b"float64 x\n")
        writer.add_message(writer.register_channel(f"/{k}", "cdr", number), UTC, b"\0" * 12, UTC)
    writer.finish()
    log = opened(file.getvalue())
    assert sum("not a name of a ROS message type" in remark for remark in log.remarks) == 3


def test_a_zip_bomb_is_refused_before_it_is_unpacked(opened):
    file = io.BytesIO()
    writer = Writer(file, chunk_size=1 << 22)
    writer.start("", "test")
    channel = writer.register_channel("/zeros", "json", 0)
    for _ in range(60):
        writer.add_message(channel, UTC, b" " * (1 << 20), UTC)
    writer.finish()
    raw = file.getvalue()
    assert len(raw) < 100_000
    with pytest.raises(LogError, match="zip bomb"):
        opened(raw, expansion=10, record_bytes=1 << 23)
    with pytest.raises(LogError, match="claims"):
        list(opened(raw, record_bytes=1 << 20, expansion=1_000_000).read())


def test_a_chunk_that_unpacks_to_more_than_it_claims(opened):
    raw = bytearray(theirs())
    at = raw.index(struct.pack("<I", 4) + b"zstd") - 12  # size unpacked of the first chunk
    raw[at : at + 8] = struct.pack("<Q", 100)
    log = opened(bytes(raw))
    with pytest.raises(LogError, match="claims 100 bytes, the index says"):
        list(log.read())
    log = opened(bytes(raw[:-20]))  # without index it is scanned
    assert "left out" in log.remarks[1]


@pytest.mark.parametrize(
    "make", [lambda: theirs(count=60), lambda: theirs(CompressionType.NONE, count=60), lambda: ours([0, S, 2 * S])]
)
def test_flipped_bytes_never_crash(opened, make):
    raw = make()
    rng = np.random.default_rng(5)
    for _ in range(150):
        hurt = bytearray(raw)
        for at in rng.integers(8, len(raw), 3):
            hurt[at] = int(rng.integers(0, 256))
        try:
            log = opened(bytes(hurt))
            times = [d.t_ns for d in log.read()]
        except LogError:
            continue
        assert times == sorted(times)


def test_not_one_record(opened):
    with pytest.raises(LogError, match="not one whole record"):
        opened(b"\x89MCAP0\r\n")

"""Messages are decoded by the schemas in a log."""

from __future__ import annotations

import struct

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from uwserver.logfiles import LogError
from uwserver.logfiles.readers.decoding import decoding, ros_decoding


def fan(of):
    """A schema whose every message has twelve fields of another, by name."""
    files = FileDescriptorSet()
    file = files.file.add(name="a.proto", syntax="proto3")
    for name, nested in of.items():
        message = file.message_type.add(name=name)
        for k in range(12):
            if nested:
                message.field.add(name=f"f{k}", number=k + 1, type=11, label=1, type_name=f".{nested}")
    return files.SerializeToString()


@pytest.mark.parametrize(
    ("of", "count"),
    [
        ({"A": "A"}, 12),
        ({"A": "B", "B": "A"}, 144),
        ({**dict(zip("ABCDEFGHIJ", "BCDEFGHIJK", strict=True)), "K": ""}, 400),
    ],
)
def test_protobuf_types_that_hold_each_other_end(of, count):
    """Without a bound 12 to the 8th fields, none of which is a value."""
    fields = decoding("protobuf", "A", "protobuf", fan(of)).fields
    assert len(fields) == count
    assert fields[0].type in of


LINE = "\n" + "=" * 80 + "\n"


def ros(*texts, is_ros1=False):
    first, *others = texts
    return ros_decoding("a/msg/A", LINE.join([first, *(f"MSG: a/{text}" for text in others)]), False, is_ros1)


def test_nested_types_are_decoded():
    known = ros("E[2] x\nE[] y\nstring[2] z", "E\nuint8 v", is_ros1=True)
    raw = bytes([1, 2]) + struct.pack("<I", 1) + b"\x03" + struct.pack("<I", 1) + b"p" + struct.pack("<I", 1) + b"q"
    assert known.decode(raw) == {"x": [{"v": 1}, {"v": 2}], "y": [{"v": 3}], "z": ["p", "q"]}
    assert [(f.name, f.type) for f in known.fields] == [
        ("x", "a/msg/E[2]"),
        ("y", "a/msg/E[]"),
        ("z", "string[2]"),
    ]


@pytest.mark.parametrize(
    ("texts", "told"),
    [
        (["\n".join(f"a/A f{k}" for k in range(12))], "contains itself"),
        (["E x", "E\nA[] y"], "contains itself"),
        (["E[3000000] x", "E\n"], "has no bytes"),
        (["E[] x", "E\n"], "has no bytes"),
        (["E x\nE y", "E\nF x\nF y", "F\n"], "has no bytes"),
        (["E[2000000000] x", "E\nuint8 v"], "more than 4096 entries"),
        (["string[5000] x"], "more than 4096 entries"),
        (["E x", "E\nG y"], "is not defined"),
    ],
)
@pytest.mark.parametrize("ros1", [True, False])
def test_what_could_ask_for_any_memory_is_refused(texts, told, ros1):
    with pytest.raises(LogError, match=told):
        ros(*texts, is_ros1=ros1)


def test_fields_of_many_types_in_many_types_are_bounded():
    """12 to the 8th: would never end."""
    chain = ["\n".join(f"B f{k}" for k in range(12))]
    chain += [
        f"{a}\n" + "\n".join(f"{b} f{k}" for k in range(12)) for a, b in zip("BCDEFGHIJ", "CDEFGHIJK", strict=True)
    ]
    assert len(ros(*chain, "K\nuint8 v").fields) == 400

"""Schemas of channels: what they describe, and those that are made to keep a reader busy."""

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from uwserver.logfiles.decoding import decoding


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

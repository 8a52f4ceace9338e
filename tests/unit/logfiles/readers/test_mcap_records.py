"""Decompression of chunks and messages up to a limit, and of data that are cut."""

import bz2

import lz4.frame
import pytest
import zstandard

from uwserver.logfiles.readers.mcap_records import decompressed

DATA = b"depth 12.5 m " * 100
COMPRESS = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}


@pytest.mark.parametrize("kind", list(COMPRESS))
def test_data_come_back_up_to_the_limit(kind):
    packed = COMPRESS[kind](DATA)
    assert decompressed(kind, packed, len(DATA)) == DATA
    assert decompressed(kind, packed, len(DATA) - 1) is None


@pytest.mark.parametrize("kind", ["lz4", "bz2"])
def test_truncated_data_are_not_taken_for_whole_ones(kind):
    assert decompressed(kind, COMPRESS[kind](DATA)[:-5], len(DATA)) is None


def test_without_compression_the_data_are_returned():
    assert decompressed("", DATA, 0) == DATA


def test_an_unknown_compression_is_named():
    with pytest.raises(ValueError, match="'rar' is unknown"):
        decompressed("rar", DATA, 100)

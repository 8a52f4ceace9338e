"""Lines of samples are what an encoder makes of the same samples as objects."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.adapter import SampleForm
from uwserver.modifiers.columns import columns_of
from uwserver.modifiers.lines import SEQ, T_NS, T_SENT_NS, VALID, LineWriter, pieces_of
from uwserver.ports import Field, Port
from uwserver.ports.told import Log, Origin, Told
from uwserver.step.streams import ENTRY

MIXED = Port(
    "rov/mixed",
    "sensor",
    "mixed",
    (
        Field("mode", "1", "Mode.", type="str"),
        Field("depth", "m", "Depth."),
        Field("C", "m", "Deep.", shape=(2, 1, 3)),
        Field("flags", "1", "Flags.", shape=(3,), type="bool"),
        Field("armed", "1", "Armed.", type="bool"),
        Field("count", "1", "Count.", type="int"),
        Field("counts", "1", "Counts.", shape=(2,), type="int"),
        Field("why \"so\"", "1", "Reason.", type="str"),
    ),
    "Mixed.",
)  # fmt: skip
PLAIN = Port("rov/plain", "sensor", "plain", (Field("x", "m", "x", shape=(3,)),), "Plain.")
PORTS = (MIXED, PLAIN)
TEXTS = ("known", 'the "first"'), ("known", None), (None, "third")


def told(count: int) -> Told:
    """Samples of both in turn, now and then without a number or a text, or with texts of their origin; the log begins with one of somebody else."""
    rng = np.random.default_rng(3)
    columns = [columns_of(port.fields) for port in PORTS]
    both = enumerate(zip(PORTS, columns, strict=True))
    origins = {k: Origin(port.path, c.width, c.values, TEXTS if c.loose else ()) for k, (port, c) in both}
    log, at = Log(np.zeros(count + 1, ENTRY), np.zeros(20 * (count + 1))), 2
    for place in range(1, count + 1):
        k = place % 2
        values: list[Any] = []
        for field in PORTS[k].fields:
            numbers: list[Any] = rng.normal(size=field.size).tolist()
            if field.type in ("bool", "int"):
                numbers = [
                    (place + i) % 3 == 0 if field.type == "bool" else int(n * 1e6) for i, n in enumerate(numbers)
                ]
            if place % 5 == 0:
                numbers[0] = None
            text = None if place % 7 == 0 else f'a "text" \u2248 {place % 4}'
            values.append(text if field.type == "str" else tuple(numbers) if field.shape else numbers[0])
        texts = place // 2 % (len(TEXTS) + 1) if columns[k].loose else 0
        log.entries[place] = (place * 20 + 3, texts, k, place, -place, place % 4 != 0, at)
        columns[k].pack(values, log.numbers[at : at + columns[k].width])
        if columns[k].loose and not texts:
            log.loose[place] = columns[k].loose_of(values)
        at += columns[k].width
    return Told(origins, log, 1, count + 1)


@pytest.mark.parametrize("selected", [None, ("counts", "depth"), ('why "so"', "C", "x")])
def test_lines_are_those_of_the_encoder(selected: tuple[str, ...] | None) -> None:
    writer, samples = LineWriter(), told(60)
    forms = []
    for port in PORTS:
        values = pieces_of(port, selected)
        assert values is not None
        forms.append(writer.add((SEQ, b" ", T_NS, b" ", T_SENT_NS, b" ", VALID, b" ", *values, b"\n")))
    streams = samples.streams
    lines = writer.write(samples, np.arange(1, 61), np.array(forms)[streams])
    ways = [SampleForm(port, selected) for port in PORTS]
    wanted = b"".join(
        b"%d %d %d %s %s\n"
        % (s.seq, s.t_ns, s.t_sent_ns, b"true" if s.valid else b"false", msgspec.json.encode(ways[stream].value(s)))
        for s, stream in zip(samples, streams, strict=True)
    )
    assert lines == wanted


def test_forms_come_while_others_are_in_use_and_lines_may_be_long() -> None:
    writer, samples = LineWriter(), told(4)
    first = writer.add((SEQ, b"\n"))
    assert writer.write(samples, np.array([1, 3]), np.array([first, first])) == b"1\n3\n"
    long = writer.add((b"x" * 200_000, SEQ))
    assert writer.write(samples, np.array([2, 1]), np.array([long, first])) == b"x" * 200_000 + b"21\n"


def test_bytes_and_pictures_take_more() -> None:
    for field in (Field("raw", "1", "Raw.", type="bytes"), Field("image", "1", "Image.", type="buffer")):
        assert pieces_of(Port("rov/p", "sensor", "p", (field,), "P.")) is None


def test_a_text_without_an_encoding_is_told() -> None:
    writer, samples = LineWriter(), told(2)
    samples.log.entries["order"][2], samples.log.loose[2] = 0, ("\ud800", "")
    values = pieces_of(MIXED)
    assert values is not None
    form = writer.add(values)
    with pytest.raises(ValueError, match="surrogates"):
        writer.write(samples, np.array([2]), np.array([form]))

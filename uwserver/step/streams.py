"""Streams of samples as rows of numbers, for compiled code and Python: the state of each stream, and the samples in flight."""

from __future__ import annotations

import numpy as np

from uwserver.modifiers.operations import OPERATION, READING
from uwserver.physics.kernel.layout import Forms, columns
from uwserver.sensors.compiled import HEAD

HELD = np.dtype(
    [
        ("there", "i8"),  # 1: a reading exists
        ("valid", "i8"),
        ("t_ns", "i8"),  # time of the last reading that was not lost
    ]
)
"""The last reading of a stream."""

STREAM = np.dtype(
    [
        ("first", "i8"),  # place of the last reading, errors included, in `numbers`
        ("width", "i8"),
        ("source", "i8"),  # place of the reading of the sensor, before errors
        ("exact", "i8"),  # 1: `source` is what a sensor without errors would read
        ("ready_made", "i8"),  # 1: Python has put the present reading there, errors included
        ("operation_first", "i8"),
        ("operation_count", "i8"),
        ("newest_first", "i8"),  # place of the newest delivered sample in `numbers`
        ("dt", "f8"),
        ("frozen", "i8"),  # 1: a fault makes the stream repeat its last reading
        ("use", "i8"),  # READ: somebody reads the samples; LISTENED: only compiled code does; KEPT: nobody does
        (
            "loose",
            "i8",
        ),  # SMALL or LARGE: values that are no numbers (texts, or pictures) wait in Python for each sample; 0: there are none
        (
            "texts",
            "i8",
        ),  # number of the texts of the last reading, plus 1, if compiled code has written it (`sensors.others.Writing`); else 0
        ("decimation_first", "i8"),  # rows of `decimations`: which samples are enough for the readers
        ("decimation_count", "i8"),  # 0: every sample is read
        ("unordered", "i8"),  # 1: samples were delivered in another order than that of their times
        ("reading", READING),
        ("held", HELD),
        ("newest", "i8"),  # 1: a newest sample exists, with the fields below
        ("seq", "i8"),
        ("t_ns", "i8"),
        ("t_sent_ns", "i8"),
        ("valid", "i8"),
    ]
)
"""A stream of samples: that of the sensor itself, or a further one of the same sensor."""

ENTRY = np.dtype(
    [
        ("t_sent_ns", "i8"),
        ("order", "i8"),  # order of samples with the same `t_sent_ns`
        ("stream", "i8"),
        ("seq", "i8"),
        ("t_ns", "i8"),
        ("valid", "i8"),
        ("slot", "i8"),  # row of the values
    ]
)
"""A sample in flight, or delivered."""

DECIMATION = np.dtype([("rate_hz", "f8"), ("start_ns", "i8"), ("interval", "i8")])
"""A `uwserver.ports.decimation.Decimation`, and the newest interval that had a sample."""
NO_INTERVAL = -(2**62)
"""Earlier than every interval."""

COUNTS = np.dtype(
    [
        ("pending", "i8"),  # samples in flight
        ("delivered", "i8"),  # samples that this tick has delivered to somebody
        ("order", "i8"),  # samples that were ever in flight
        ("next_ns", "i8"),  # time at which the next one in flight arrives
        ("read", "i8"),  # of `delivered`: samples that somebody reads
        ("loose", "i8"),  # of `delivered`: samples with values that are no numbers
        ("logged", "i8"),  # entries in the log
        ("log_width", "i8"),  # numbers in the log
    ]
)

READ, LISTENED, KEPT = 1, 2, 3
SMALL, LARGE = 1, 2

NEVER = np.iinfo(np.int64).max

FORMS: Forms = {
    "counts": COUNTS,  # at which each tick looks
    "heads": HEAD,
    "streams": STREAM,
    "operations": OPERATION,
    "numbers": columns(np.float64),
    "pending": ENTRY,
    "free": columns(np.int64),
    "delivered": ENTRY,
    "decimations": DECIMATION,
    "loose": columns(np.int64),
    "log": ENTRY,
    "log_numbers": columns(np.float64),
    "team": columns(np.int64),
}
"""The arrays in the table of a world's sensors. `log` holds the samples that somebody reads, tick after tick: `slot` of an entry is the place of its
first number in `log_numbers`, and `order` is `texts` of its stream. A log without room takes no samples."""

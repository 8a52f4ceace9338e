"""Streams of samples as rows of numbers: what compiled code and Python know of each, and of samples on their way."""

from __future__ import annotations

import numpy as np

from uwserver.modifiers.operations import OPERATION, READING
from uwserver.physics.kernel.layout import Forms, columns
from uwserver.sensors.bank import HEAD

HELD = np.dtype(
    [
        ("there", "i8"),  # 1: there was a reading
        ("valid", "i8"),
        ("t_ns", "i8"),  # when the last one that was not lost was true
    ]
)
"""What is known of the last reading of a stream."""

STREAM = np.dtype(
    [
        ("first", "i8"),  # place of its last reading, errors included, among the numbers
        ("width", "i8"),
        ("source", "i8"),  # place of what the sensor has read
        ("exact", "i8"),  # 1: that is what an ideal one would have read
        ("ready_made", "i8"),  # 1: the reading of this instant, with its errors, was put there by others
        ("operation_first", "i8"),
        ("operation_count", "i8"),
        ("newest_first", "i8"),  # place of the newest delivered sample among those
        ("dt", "f8"),
        ("frozen", "i8"),  # 1: a fault makes it repeat itself
        ("wanted", "i8"),  # READ: somebody reads its samples; HEARD: compiled code alone does; KEPT: nobody does
        (
            "wordy",
            "i8",
        ),  # SMALL or LARGE: such values, that are no numbers, wait in Python for each of its samples; 0: none do
        (
            "texts",
            "i8",
        ),  # those of the last reading, if compiled code has written it (`sensors.writing.Writing`), and 1; else 0
        ("thinning_first", "i8"),  # of those that say which samples are enough for who reads it
        ("thinning_count", "i8"),  # 0: all are read
        ("unordered", "i8"),  # 1: samples were delivered in another order than they were true in
        ("reading", READING),
        ("held", HELD),
        ("newest", "i8"),  # 1: there is a newest sample, with what follows
        ("seq", "i8"),
        ("t_ns", "i8"),
        ("t_sent_ns", "i8"),
        ("valid", "i8"),
    ]
)
"""A stream of samples: the sensor's own, or one beside it."""

ENTRY = np.dtype(
    [
        ("t_sent_ns", "i8"),
        ("order", "i8"),  # among those of one time
        ("stream", "i8"),
        ("seq", "i8"),
        ("t_ns", "i8"),
        ("valid", "i8"),
        ("slot", "i8"),  # row of its values
    ]
)
"""A sample on its way, or delivered."""

THINNING = np.dtype([("rate_hz", "f8"), ("start_ns", "i8"), ("interval", "i8")])
"""`uwserver.ports.thinning.Thinning`, and the newest interval in which there was a sample."""
NO_INTERVAL = -(2**62)
"""Before all."""

COUNTS = np.dtype(
    [
        ("pending", "i8"),  # samples on their way
        ("told", "i8"),  # delivered in this tick to somebody
        ("order", "i8"),  # on their way before
        ("next_ns", "i8"),  # when the next one arrives
        ("read", "i8"),  # of those delivered, how many are read
        ("wordy", "i8"),  # of those delivered, how many have values that are no numbers
        ("logged", "i8"),  # entries of the log
        ("log_width", "i8"),  # their numbers
    ]
)

READ, HEARD, KEPT = 1, 2, 3
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
    "told": ENTRY,
    "thinnings": THINNING,
    "wordy": columns(np.int64),
    "log": ENTRY,
    "log_numbers": columns(np.float64),
    "team": columns(np.int64),
}
"""Of the table of a world's sensors. `log`: samples that somebody reads, one tick after the other; `slot` of each is the place of its first number
in `log_numbers`, `order` the `texts` of its stream. One without room takes none."""

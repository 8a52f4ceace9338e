"""A log of any origin behind one face: topics, and data in the order of one time base.

`open_log` (uwserver.logfiles) finds the reader of a file; what a reader gives is as it stands in the log, in the log's own units and frames. Only
`uwserver.logfiles.mapping` turns it into NED, SI units and our names.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from msgspec import Struct

Kind = Literal["uwserver", "mcap", "tlog", "bin", "alog", "bag", "rosbag2", "ulg", "csv", "parquet"]
"""Formats of logs: our own recording, other MCAP files, MAVLink telemetry, ArduPilot dataflash, MOOS, ROS 1, ROS 2, PX4, and tables."""


class LogError(ValueError):
    """A file that cannot be read as a log; the text names the file, what is wrong and what to do. The only error that readers raise."""


class LogField(Struct, frozen=True):
    """One value of a topic.

    Attributes:
        name: with dots where messages are nested: ``pose.position.x``.
        type: in the words of its format: ``float64``, ``char[10]``, ``string``.
        unit: as the log or its dialect says it; "" when nobody does.
        frame: of a vector's components; "" when nobody says it.
    """

    name: str
    type: str
    unit: str = ""
    frame: str = ""


class Topic(Struct, frozen=True):
    """What one source wrote into a log.

    Attributes:
        name: unique in the log; ``1/1/ATTITUDE`` (system, component, message) of MAVLink.
        schema: name of the type of its data; "" where there is none.
        fields: of each datum, as far as they are known before it is read.
        count: number of data; None when only reading all would tell.
        first_ns, last_ns: times of the first and the last datum; None when only reading all would tell.
    """

    name: str
    schema: str
    fields: tuple[LogField, ...]
    count: int | None
    first_ns: int | None
    last_ns: int | None


class Datum(NamedTuple):
    """One entry of a log: its time on the log's time base, ns; its topic; its fields, nested where the message is."""

    t_ns: int
    topic: str
    value: Mapping[str, object]


class Limits(Struct, frozen=True):
    """What a log may ask of the machine; a file that asks for more is refused with a `LogError`.

    Attributes:
        record_bytes: of one record, also after decompression.
        expansion: how many times the bytes of the file decompression may give in all, besides one record.
        topics: in one log.
    """

    record_bytes: int = 256 << 20
    expansion: int = 1000
    topics: int = 65_535


class Log(Protocol):
    """An open log. Not for use by two threads at a time; several `read` may go on side by side."""

    @property
    def path(self) -> Path:
        """The file; of a ROS 2 bag the folder, or its one file."""
        ...

    @property
    def kind(self) -> Kind:
        """Its format."""
        ...

    @property
    def topics(self) -> Mapping[str, Topic]:
        """By name, in the order in which they appear."""
        ...

    @property
    def start_ns(self) -> int:
        """Time of the first datum. Time 0 is the start of the scenario in our own recordings, elsewhere the first datum."""
        ...

    @property
    def end_ns(self) -> int:
        """Time of the last datum; 0 when there are none."""
        ...

    @property
    def epoch_ns(self) -> int | None:
        """UTC of time 0, ns since 1970; None when the log does not know it."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to know before trusting it, one sentence each: gaps, resets of the clock, records left out, a cut end."""
        ...

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """Data of some topics (None: all) from `start_ns` to `end_ns` (both included), in the order of their times.

        Where the clock of the log was set back or far ahead, the times go on from the last one before, so that time never runs back; `remarks`
        tells where.

        Raises:
            LogError: the file is damaged where it was not yet read. A topic that the log has not is no error: it has no data.
        """
        ...

    def close(self) -> None:
        """Close the file; nothing can be read afterwards. Twice does no harm."""
        ...


def member(value: object, name: str) -> object:
    """The value under a dotted name of a nested message; an index stands for an entry of a list: ``pose.covariance.0``. None where there is none.

    A column of a table may have dots in its own name.
    """
    if isinstance(value, Mapping) and name in value:
        return value[name]
    for word in name.split("."):
        if isinstance(value, Mapping):
            if word not in value:
                return None
            value = value[word]
        elif hasattr(value, "__getitem__") and not isinstance(value, str | bytes) and word.isdecimal():
            k = int(word[:9])
            if k >= len(value):  # type: ignore[arg-type]
                return None
            value = value[k]
        else:
            return None
    return value

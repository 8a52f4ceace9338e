"""The interface of an open log of any format: its topics, its data in the order of one time base, and its only error.

`open_log` (uwserver.logfiles) chooses the reader for a file. A reader gives the data as they are in the log, in the log's own units and frames.
Only `uwserver.logfiles.mapping` converts them to NED, SI units and our names.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from msgspec import Struct

from uwserver.packages import install_command

Kind = Literal["uwserver", "mcap", "tlog", "bin", "alog", "bag", "rosbag2", "ulg", "csv", "parquet"]
"""Log formats: our own recordings, other MCAP files, MAVLink telemetry, ArduPilot dataflash, MOOS, ROS 1, ROS 2, PX4, and tables."""
_LONGEST = 300
_PACKAGES = {"google": "protobuf"}
"""The package of a module, where their names differ."""


class LogError(ValueError):
    """A file that cannot be read as a log. The text names the file, what is wrong and what to do. Readers raise no other error."""


class LogField(Struct, frozen=True):
    """One value of a topic.

    Attributes:
        name: the field's name; nested messages are written with dots: ``pose.position.x``.
        type: the type as its format calls it: ``float64``, ``char[10]``, ``string``.
        unit: the unit that the log or its dialect gives; "" when it gives none.
        frame: the frame of a vector's components; "" when the log gives none.
    """

    name: str
    type: str
    unit: str = ""
    frame: str = ""


class Topic(Struct, frozen=True):
    """The data that one source wrote into a log.

    Attributes:
        name: unique in the log; for MAVLink ``1/1/ATTITUDE`` (system, component, message).
        schema: name of the data type; "" when there is none.
        fields: the fields of each datum, as far as they are known before the data are read.
        count: number of data; None when it is not known without reading the whole log.
        first_ns, last_ns: times of the first and the last datum; None when they are not known without reading the whole log.
    """

    name: str
    schema: str
    fields: tuple[LogField, ...]
    count: int | None
    first_ns: int | None
    last_ns: int | None


class Datum(NamedTuple):
    """One entry of a log: its time on the log's time base (ns), its topic, and its fields (nested where the message is nested)."""

    t_ns: int
    topic: str
    value: Mapping[str, object]


class Limits(Struct, frozen=True):
    """The resources that a log may use. A file that needs more is refused with a `LogError`.

    Attributes:
        record_bytes: largest size of one record, also after decompression.
        expansion: largest ratio of all decompressed bytes to the size of the file; one record more is allowed.
        topics: largest number of topics in one log.
    """

    record_bytes: int = 256 << 20
    expansion: int = 1000
    topics: int = 65_535


class Log(Protocol):
    """An open log. Only one thread may use it at a time; several `read` iterators may be active at once."""

    @property
    def path(self) -> Path:
        """Return the path of the file; for a ROS 2 bag the folder, or its only file."""

    @property
    def kind(self) -> Kind:
        """Return the format."""

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Return the topics by name, in the order in which they appear."""

    @property
    def start_ns(self) -> int:
        """Return the time of the first datum. Time 0 is the start of the scenario in our recordings, and the first datum elsewhere."""

    @property
    def end_ns(self) -> int:
        """Return the time of the last datum; 0 when there are no data."""

    @property
    def epoch_ns(self) -> int | None:
        """Return the UTC of time 0 in ns since 1970; None when the log does not contain it."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return what a user should know before trusting the log, one sentence each: gaps, clock resets, skipped records, a truncated end."""

    def read(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Datum]:
        """Yield the data of some topics (None: all) from `start_ns` to `end_ns` (both included), in the order of their times.

        Where the clock of the log was set back or far ahead, the times continue from the last time before, so that time never runs backwards;
        `remarks` says where. A topic that is not in the log has no data; this is not an error.

        Raises:
            LogError: a part of the file that had not been read before is damaged.
        """

    def close(self) -> None:
        """Close the file. Nothing can be read afterwards; a second call does nothing."""


def member(value: object, name: str) -> object:
    """Return the value under a dotted name of a nested message; None when there is none.

    A number selects an entry of a list: ``pose.covariance.0``. A table column may have dots in its own name.
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


def matches(value: object, where: Mapping[str, object]) -> bool:
    """Return whether the members of a message have these values."""
    return all(member(value, name) == wanted for name, wanted in where.items())


@contextmanager
def foreign(path: Path, what: str) -> Iterator[None]:
    """Turn every error in the block into a `LogError` that names the file and says what failed."""
    try:
        yield
    except LogError:
        raise
    except OSError as error:
        raise LogError(f"{path}: {what}: {error.strerror or error}") from error
    except ImportError as error:
        module = (error.name or str(error)).split(".")[0]
        package = _PACKAGES.get(module, module)
        raise LogError(
            f"{path}: {what}: the package {package} is missing: {install_command('uwserver[logs]')}"
        ) from error
    except Exception as error:
        text = " ".join(str(error).split())[:_LONGEST]
        raise LogError(f"{path}: {what}: {text or 'damaged'} ({type(error).__name__})") from error

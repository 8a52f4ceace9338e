"""Logs that are made of a list, for what works on any log."""

from pathlib import Path

from uwserver.logfiles import Datum, LogField, Topic


class MadeLog:
    """A log of given data; each topic is (schema, names of its fields)."""

    def __init__(self, kind, data, topics=None):
        self.path, self.kind, self.remarks, self.epoch_ns = Path("made"), kind, (), None
        self._data = sorted(data, key=lambda d: d[0])
        self.topics = {}
        for name in dict.fromkeys(d[1] for d in self._data):
            schema, fields = (topics or {}).get(name, ("", ()))
            times = [d[0] for d in self._data if d[1] == name]
            made = tuple(
                LogField(f, "float64") if isinstance(f, str) else LogField(f[0], "float64", f[1]) for f in fields
            )
            self.topics[name] = Topic(name, schema, made, len(times), times[0], times[-1])
        self.start_ns, self.end_ns = (self._data[0][0], self._data[-1][0]) if self._data else (0, 0)

    def read(self, topics=None, start_ns=None, end_ns=None):
        for t_ns, topic, value in self._data:
            if (topics is None or topic in topics) and (start_ns or 0) <= t_ns <= (
                end_ns if end_ns is not None else 1 << 62
            ):
                yield Datum(t_ns, topic, value)

    def close(self):
        pass

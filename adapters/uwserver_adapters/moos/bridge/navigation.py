"""Collects what instruments, or the truth, say of one vehicle, and publishes the conventional set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from uwserver.adapter import CannotServe, port_of
from uwserver.ports import Port, Sample
from uwserver_adapters.moos.codec import Fix, Pairs, navigation, period_ns
from uwserver_adapters.moos.config import NavTable

_FIELDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "position": ("p_N", ("p_NB", "p_NS")),
    "attitude": ("q_NB", ("q_NB", "q_NS")),
    "velocity": ("v_B", ("v_NB_B", "v_S")),
    "depth": ("depth", ("depth",)),
    "altitude": ("altitude", ("altitude", "range")),
}
"""What of `Fix` each entry of the table fills, and from which fields."""


class Raster:
    """Which samples are due when at most `rate_hz` of each port are wanted: on an even raster of simulation time, so that rates do not drift."""

    def __init__(self, rate_hz: float) -> None:
        self._period = period_ns(rate_hz)
        self._next: dict[str, int] = {}

    def is_due(self, key: str, t_ns: int) -> bool:
        """Whether this one is; it counts then."""
        due = self._next.get(key, 0)
        if t_ns < due:
            return False
        late = (t_ns - due) % self._period
        self._next[key] = t_ns - late + self._period
        return True

    def reset(self) -> None:
        """Time begins anew."""
        self._next.clear()


class Navigation:
    """The conventional set of one vehicle.

    Args:
        table: from which ports.
        ports: what there is.
        vehicle: whose.

    Attributes:
        fix: what is known now.

    Raises:
        CannotServe: a port is not there, or says nothing of the kind.
    """

    def __init__(self, table: NavTable, ports: Mapping[str, Port], vehicle: str) -> None:
        self.fix = Fix(water_depth=table.water_depth_m)
        self._table = table
        self._raster = None if table.rate_hz is None else Raster(table.rate_hz)
        self._sources: dict[str, list[tuple[str, int]]] = {}
        for entry, (known, names) in _FIELDS.items():
            given = getattr(table, entry)
            if given:
                port = port_of(f"nav.{entry}", given, ports, vehicle, "sensor")
                self._sources.setdefault(port.path, []).append((known, _index(entry, port, names)))
        self._leader = next(iter(self._sources), "")

    def reset(self) -> None:
        """Time begins anew."""
        if self._raster is not None:
            self._raster.reset()

    def pairs(self, samples: Sequence[Sample]) -> Pairs:
        """The set when it is due: with each valid sample of the first port, within the rate."""
        is_due = False
        for sample in samples:
            sources = self._sources.get(sample.port)
            if sources is None or not sample.valid:
                continue
            for known, index in sources:
                value = sample.value[index]
                if not (value is None or (isinstance(value, tuple) and None in value)):
                    setattr(self.fix, known, value)
            if sample.port == self._leader:
                is_due |= self._raster is None or self._raster.is_due("", sample.t_sent_ns)
        return navigation(self.fix, self._table.prefix, self._table.origin_deg) if is_due else []


def _index(entry: str, port: Port, names: tuple[str, ...]) -> int:
    for index, field in enumerate(port.fields):
        if field.name in names:
            return index
    raise CannotServe(f'nav.{entry}: "{port.path}" has none of the fields {", ".join(names)}')

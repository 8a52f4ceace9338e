"""Collects what instruments, or the truth, say of one vehicle, and publishes the conventional set."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from msgspec.structs import replace

from uwserver.adapter import CannotServe, port_of
from uwserver.ports import Port, Sample
from uwserver_adapters.moos.codec import Fix, Pairs, navigation, period_ns
from uwserver_adapters.moos.config import NavTable

_FIELDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "position": ("p_N", ("p_NB", "p_NS")),
    "attitude": ("q_NB", ("q_NB", "q_NS")),
    "velocity": ("v_B", ("v_NB_B", "v_S")),
    "flow": ("flow_B", ("v_NW_B",)),
    "through_water": ("v_water_B", ("v_water_S",)),
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


_ENTRIES = ("position", "attitude", "velocity", "depth", "altitude")
TRUTH: Mapping[str, str] = {"position": "truth/pose", "attitude": "truth/pose", "velocity": "truth/velocity"}
FLOW = "truth/flow"


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
        self._ports, self._vehicle = ports, vehicle
        for entry in _ENTRIES:
            self._find(entry, getattr(table, entry), entry)
        self._leader = next(iter(self._sources), "")
        self._is_truth = bool(table.position) and ports[self._leader].is_truth
        self._find_flow()
        self._truth = self._of_truth() if table.ground_truth else None

    def follow(self, ports: Mapping[str, Port]) -> str:
        """The ports changed: what each entry of the table needs is read where it is now, and stands still where it is not.

        Returns what is missing; "" for nothing.
        """
        self._ports = ports
        self._sources.clear()
        missing = "" if self._truth is None else self._truth.follow(ports)
        for entry in (*_ENTRIES, "flow"):
            try:
                self._find_flow() if entry == "flow" else self._find(entry, getattr(self._table, entry), entry)
            except CannotServe as error:
                missing = missing or str(error)
        return missing

    @property
    def wanted(self) -> Collection[str]:
        """Ports that are read."""
        return self._sources.keys() | (frozenset() if self._truth is None else self._truth.wanted)

    def _find(self, entry: str, given: str | None, key: str) -> None:
        if given:
            known, names = _FIELDS[entry]
            port = port_of(f"nav.{key}", given, self._ports, self._vehicle, "sensor")
            self._sources.setdefault(port.path, []).append((known, _index(key, port, names)))

    def _find_flow(self) -> None:
        table, ports = self._table, self._ports
        if table.flow is None:
            if table.velocity == TRUTH["velocity"] and f"{self._vehicle}/{FLOW}" in ports:
                self._find("flow", FLOW, "flow")
            return
        port = port_of("nav.flow", table.flow, ports, self._vehicle, "sensor")
        measured = any(field.name in _FIELDS["through_water"][1] for field in port.fields)
        self._find("through_water" if measured else "flow", table.flow, "flow")

    def _of_truth(self) -> Navigation:
        table = replace(self._table, **TRUTH, depth=None, altitude=None, flow=None, ground_truth=False)
        return Navigation(replace(table, prefix=f"{table.prefix}_GT"), self._ports, self._vehicle)

    def reset(self) -> None:
        """Time begins anew."""
        self.fix.t_ns = -1
        if self._raster is not None:
            self._raster.reset()
        if self._truth is not None:
            self._truth.reset()

    def known(self) -> Pairs:
        """The set as it is now."""
        return navigation(self.fix, self._table.prefix, self._table.origin_deg)

    def pairs(self, samples: Sequence[Sample]) -> Pairs:
        """The set when it is due: with each valid sample of the first port, within the rate."""
        is_due = False
        pairs: Pairs = []
        if self._truth is not None:
            self._truth.fix.water_depth = self.fix.water_depth
            pairs += self._truth.pairs(samples)
        for sample in samples:
            sources = self._sources.get(sample.port)
            if sources is None or not sample.valid:
                continue
            for known, index in sources:
                value = sample.value[index]
                if not (value is None or (isinstance(value, tuple) and None in value)):
                    setattr(self.fix, known, value)
            if sample.port == self._leader:
                self.fix.t_ns = sample.t_ns
                is_due |= self._raster is None or self._raster.is_due("", sample.t_sent_ns)
        if is_due:
            pairs += self.known()
            if self._is_truth and self.fix.p_N is not None:
                north, east, _ = self.fix.p_N
                pairs += [("TRUE_X", east), ("TRUE_Y", north)]
        return pairs


def _index(entry: str, port: Port, names: tuple[str, ...]) -> int:
    for index, field in enumerate(port.fields):
        if field.name in names:
            return index
    raise CannotServe(f'nav.{entry}: "{port.path}" has none of the fields {", ".join(names)}')

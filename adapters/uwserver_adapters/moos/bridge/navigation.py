"""Collects what instruments, or the truth, tell of one vehicle, and publishes the conventional set of variables."""

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
"""Entry of the table -> the attribute of `Fix` that it fills, and the fields of ports from which it is filled."""


class Decimator:
    """Picks samples so that those of each port keep a rate: on an even raster of simulation time, so that rates do not drift.

    Args:
        rate_hz: highest rate; None for all samples.
    """

    def __init__(self, rate_hz: float | None) -> None:
        self._period = None if rate_hz is None else period_ns(rate_hz)
        self._next: dict[str, int] = {}

    def is_due(self, port: str, t_ns: int) -> bool:
        """Return whether a sample is picked."""
        if self._period is None:
            return True
        due = self._next.get(port, 0)
        if t_ns < due:
            return False
        late = (t_ns - due) % self._period
        self._next[port] = t_ns - late + self._period
        return True

    def reset(self) -> None:
        """Start again at another time."""
        self._next.clear()


_ENTRIES = ("position", "attitude", "velocity", "depth", "altitude")
TRUTH: Mapping[str, str] = {"position": "truth/pose", "attitude": "truth/pose", "velocity": "truth/velocity"}
FLOW = "truth/flow"


class Navigation:
    """The conventional set of one vehicle.

    Args:
        table: ports of the instruments.
        ports: those of the context.
        vehicle: the vehicle.

    Attributes:
        fix: what is known of the vehicle now.

    Raises:
        CannotServe: a port is missing, or has none of the needed fields.
    """

    def __init__(self, table: NavTable, ports: Mapping[str, Port], vehicle: str) -> None:
        self.fix = Fix(water_depth=table.water_depth_m)
        self._table = table
        self._decimator = Decimator(table.rate_hz)
        self._sources: dict[str, list[tuple[str, int]]] = {}
        self._ports, self._vehicle = ports, vehicle
        for entry in (*_ENTRIES, "flow"):
            self._find(entry)
        self._leader = next(iter(self._sources), "")
        self._is_truth = bool(table.position) and ports[self._leader].is_truth
        self._truth: Navigation | None = None
        if table.ground_truth:
            truth = replace(table, **TRUTH, depth=None, altitude=None, flow=None, ground_truth=False)
            self._truth = Navigation(replace(truth, prefix=f"{table.prefix}_GT"), ports, vehicle)

    def follow(self, ports: Mapping[str, Port]) -> str:
        """Read the instruments where they are after a change of the ports. The values of a missing instrument stand still.

        Returns:
            What is missing, or "".
        """
        self._ports = ports
        self._sources.clear()
        missing = "" if self._truth is None else self._truth.follow(ports)
        for entry in (*_ENTRIES, "flow"):
            try:
                self._find(entry)
            except CannotServe as error:
                missing = missing or str(error)
        return missing

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports that are read."""
        return self._sources.keys() | (frozenset() if self._truth is None else self._truth.subscriptions)

    def _find(self, entry: str) -> None:
        """Find the port of an entry of the table, where the table or a default names one."""
        table, quantity = self._table, entry
        path: str | None = getattr(table, entry)
        if entry == "flow" and path is None:
            is_there = table.velocity == TRUTH["velocity"] and f"{self._vehicle}/{FLOW}" in self._ports
            path = FLOW if is_there else None
        if not path:
            return
        port = port_of(f"nav.{entry}", path, self._ports, self._vehicle, "sensor")
        places = {field.name: place for place, field in enumerate(port.fields)}
        if entry == "flow" and "v_water_S" in places:  # a log measures the velocity through the water itself
            quantity = "through_water"
        known, names = _FIELDS[quantity]
        place = next((place for name, place in places.items() if name in names), None)
        if place is None:
            raise CannotServe(f'nav.{entry}: "{port.path}" has none of the fields {", ".join(names)}')
        self._sources.setdefault(port.path, []).append((known, place))

    def reset(self) -> None:
        """Start again at another time."""
        self.fix.t_ns = -1
        self._decimator.reset()
        if self._truth is not None:
            self._truth.reset()

    def known(self) -> Pairs:
        """Return the set as it is now."""
        return navigation(self.fix, self._table.prefix, self._table.origin_deg)

    def pairs(self, samples: Sequence[Sample]) -> Pairs:
        """Take samples. Returns the set when it is due: with each valid sample of the first port, within the rate."""
        is_due = False
        pairs: Pairs = []
        if self._truth is not None:
            self._truth.fix.water_depth = self.fix.water_depth
            pairs += self._truth.pairs(samples)
        for sample in samples:
            sources = self._sources.get(sample.port)
            if sources is None or not sample.valid:
                continue
            for known, place in sources:
                value = sample.value[place]
                if not (value is None or (isinstance(value, tuple) and None in value)):
                    setattr(self.fix, known, value)
            if sample.port == self._leader:
                self.fix.t_ns = sample.t_ns
                is_due |= self._decimator.is_due("", sample.t_sent_ns)
        if is_due:
            pairs += self.known()
            if self._is_truth and self.fix.p_N is not None:
                north, east, _ = self.fix.p_N
                pairs += [("TRUE_X", east), ("TRUE_Y", north)]
        return pairs

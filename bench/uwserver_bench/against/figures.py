"""Figures of both versions with their verdicts, and the report of all figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Literal

from uwserver_bench.against.intervals import median_interval

FORMAT = "uwserver-bench-against-1"
MARGIN = 1.05
"""Ours counts as worse if it takes more than this times what theirs takes."""

Verdict = Literal["ok", "better", "worse", "open", "few", "both miss", "absent"]
MEANING: Mapping[Verdict, str] = {
    "worse": f"ours takes more: the interval lies wholly above {MARGIN:g}; of what has a bar: only theirs meets it, and the interval lies above 1",
    "open": f"the interval reaches beyond {MARGIN:g}, of what misses its bar below 1: more pairs or a quieter machine would tell",
    "both miss": "neither version meets the bar here: the machine is too busy, or the bar too high for it",
    "few": "too few pairs for an interval",
}


@dataclass(frozen=True)
class Figure:
    """A cost of this version and of the other one; less is better.

    Attributes:
        group: part of the report.
        name: what was measured.
        unit: unit of the values.
        ours, theirs: one value for each pair, in their order; empty if the figure could not be measured.
        bar: largest allowed median, for latencies and for the import. All other figures are judged by their ratios.
        note: why it could not be measured.
    """

    group: str
    name: str
    unit: str
    ours: tuple[float, ...]
    theirs: tuple[float, ...]
    bar: float | None = None
    note: str = ""

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ours over theirs for each pair, without the pairs in which theirs is zero."""
        return tuple(a / b for a, b in zip(self.ours, self.theirs, strict=False) if b > 0.0)

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % confidence interval of the median of the ratios."""
        return median_interval(self.ratios)

    @property
    def verdict(self) -> Verdict:
        """The verdict. A figure with a bar is judged by the bar and must be worse beyond chance; all others are judged by the interval."""
        if not self.ratios:
            return "absent"
        if self.bar is not None:
            if median(self.ours) <= self.bar:
                return "ok"
            if median(self.theirs) > self.bar:
                return "both miss"
        if self.interval is None:
            return "few"
        low, high = self.interval
        if self.bar is not None:
            return "worse" if low > 1.0 else "open"
        if low > MARGIN:
            return "worse"
        if high < 1.0 / MARGIN:
            return "better"
        return "ok" if high <= MARGIN else "open"


@dataclass(frozen=True)
class Comparison:
    """All figures of one run.

    Attributes:
        quick: whether it was made with --quick; then it only shows that everything runs.
        machine: see `uwserver_bench.report.machine_facts`.
        versions: facts of each installation, for "ours" and "theirs".
    """

    quick: bool
    pairs: int
    machine: Mapping[str, object]
    versions: Mapping[str, Mapping[str, object]]
    figures: tuple[Figure, ...]

    @property
    def worse(self) -> tuple[Figure, ...]:
        """The figures that are worse."""
        return tuple(figure for figure in self.figures if figure.verdict == "worse")

    def as_json(self) -> dict[str, object]:
        """Return plain values: all figures with their raw values."""
        figures = [
            {
                **asdict(f),
                "ratio": median(f.ratios) if f.ratios else None,
                "interval": f.interval,
                "verdict": f.verdict,
            }
            for f in self.figures
        ]
        return {
            "format": FORMAT, "quick": self.quick, "pairs": self.pairs, "margin": MARGIN, "machine": self.machine,
            "versions": self.versions, "figures": figures,
        }  # fmt: skip

    def table(self) -> str:
        """Return a table with a line for each figure, by groups, and an explanation of the verdicts."""
        lines = [f"{side:6} {_version_line(facts)}" for side, facts in self.versions.items()]
        if len({facts["folder"] for facts in self.versions.values()}) == 1:
            lines.append("both sides are the same installation: what differs is the noise of the measurement")
        if len({(facts["python"], str(facts["packages"])) for facts in self.versions.values()}) > 1:
            lines.append("Python or a package differs between the sides: the ratios are of these too")
        if self.quick:
            lines.append("--quick: too short to judge speed by")
        width = max(len(figure.name) for figure in self.figures)
        for group in dict.fromkeys(figure.group for figure in self.figures):
            head = f"{'ours':>9}  {'theirs':>9}  {'':6}  {'ratio':>6}  {'95 % interval':15}  {'bar':>7}  verdict"
            lines += ["", f"{group:{width}}  {head}"]
            lines += [_line(figure, width) for figure in self.figures if figure.group == group]
        seen = {figure.verdict for figure in self.figures}
        lines += ["", *(f"{verdict}: {text}" for verdict, text in MEANING.items() if verdict in seen)]
        lines.append(f"worse: {len(self.worse)} of {len(self.figures)}")
        return "\n".join(lines)


def _version_line(facts: Mapping[str, object]) -> str:
    packages = facts["packages"]
    assert isinstance(packages, Mapping)
    told = ", ".join(f"{name} {version}" for name, version in packages.items())
    # Each installed distribution is a further folder that every start searches.
    return f"{facts['folder']}, Python {facts['python']}, {told}, {facts['distributions']} distributions"


def _line(figure: Figure, width: int) -> str:
    if not figure.ratios:
        return f"{figure.name:{width}}  not measured: {figure.note}"
    interval = "" if figure.interval is None else "{:.3f} .. {:.3f}".format(*figure.interval)
    ours, theirs = _digits(figure.ours), _digits(figure.theirs)
    bar = "" if figure.bar is None else f"<= {figure.bar:.3g}"
    return (
        f"{figure.name:{width}}  {ours:>9}  {theirs:>9}  {figure.unit:6}  {median(figure.ratios):6.3f}  {interval:15}  {bar:>7}  "
        f"{figure.verdict}"
    )


def _digits(values: Sequence[float]) -> str:
    value = median(values)
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"

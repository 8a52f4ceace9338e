"""The whole comparison of two versions: all figures, in pairs."""

from __future__ import annotations

import tempfile
from pathlib import Path

from uwserver.simulation.clock import SystemTime
from uwserver_bench.against.figures import Comparison
from uwserver_bench.against.installation import EXTRAS, ours, theirs
from uwserver_bench.against.pairs import Pairs, Say
from uwserver_bench.against.servers import Servers
from uwserver_bench.against.worlds import Worlds, measure_fresh
from uwserver_bench.processes import BenchFailed
from uwserver_bench.report import machine_facts

PAIRS, QUICK_PAIRS = 15, 1
MINUTES = 60.0
_ORDER = {"loading": 0, "ticks": 1, "state": 2, "start": 3, "server": 4, "latencies": 5}


def compare(venv: Path, pairs: int, minutes: float, quick: bool, only: str, say: Say) -> Comparison:
    """Compare this version with the one in another virtual environment.

    Args:
        venv: folder of the other environment.
        pairs: largest number of pairs.
        minutes: after this time no pair begins.
        quick: very little work in each measurement.
        only: only figures whose group and name contain this text are measured.
        say: gets lines of progress.

    Raises:
        BenchFailed: there is no such version, our version fails, or `only` matches no figure.
    """
    versions = {"ours": ours(), "theirs": theirs(venv)}
    machine, values, clock = machine_facts(), Pairs(only), SystemTime()
    with tempfile.TemporaryDirectory(prefix="uwserver-bench-") as folder:
        place = Path(folder)
        facts = {side: version.facts(place) for side, version in versions.items()}
        extras = [name for name in EXTRAS if all(name in told["extras"] for told in facts.values())]
        worlds, servers = Worlds(versions, place, quick), Servers(versions, place, quick, extras)
        worlds.warm_up(values, say)
        begin, done = clock.now_ns(), 0
        while done < pairs and (spent := (clock.now_ns() - begin) * 1e-9 / 60.0) < minutes:
            left = f", about {min(spent / done * (pairs - done), minutes - spent):.0f} minutes more" if done else ""
            say(f"pair {done + 1} of {pairs}{left}")
            worlds.measure(done, values)
            measure_fresh(versions, worlds.files, place, done, values)
            servers.measure(done, values)
            done += 1
    figures = tuple(values.figures(_ORDER))
    if not figures:
        raise BenchFailed(f'no figure has "{only}" in its name')
    return Comparison(quick, done, machine, facts, figures)

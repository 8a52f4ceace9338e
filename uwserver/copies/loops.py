"""Loops over all copies that let sensors of one kind read, made of the loop of the kind. Imports numba."""

from __future__ import annotations

from functools import cache
from typing import Any

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import entry
from uwserver.physics.kernel.deferred import Deferred
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.rays.hits import miss
from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.bank import Bank
from uwserver.step import streams

_heads, _numbers = array_at(streams.FORMS, "heads"), array_at(streams.FORMS, "numbers")


def _part(loop: Deferred) -> Any:
    return Deferred(loop.py_func, "compiled").made()


def _plain(bank: Bank) -> Any:
    run, rows_at = _part(bank.run), array_at({"rows": bank.record}, "rows")

    @entry
    def read(which: Array, senses: Array, rows: Array, nows: Array, ts: Array, due: Array) -> None:
        for i in which:
            run(_heads(senses[i]), rows_at(rows[i]), _numbers(senses[i]), due, nows[i], ts[i])

    return read


def _by_rays(bank: Bank) -> Any:
    """In open water, where what one loop has aimed at decides nothing for the next."""
    first_aim, last_aim = _part(bank.aims[0]), _part(bank.aims[-1])
    aims_twice, run, rows_at = len(bank.aims) > 1, _part(bank.run), array_at({"rows": bank.record}, "rows")

    @entry
    def read(
        which: Array, senses: Array, rows: Array, nows: Array, ts: Array, due: Array, rays: Array, first: Array, hits: Hits
    ) -> None:  # fmt: skip
        origin, direction = rays[0], rays[1]
        for i in which:
            heads, records, numbers, now, t = _heads(senses[i]), rows_at(rows[i]), _numbers(senses[i]), nows[i], ts[i]
            miss(hits)
            first_aim(heads, records, numbers, due, now, t, origin, direction, first, hits)
            if aims_twice:
                last_aim(heads, records, numbers, due, now, t, origin, direction, first, hits)
                miss(hits)
            run(heads, records, numbers, due, now, t, direction, first, hits)

    return read


@cache
def loop_of(bank: Bank) -> Any:
    """The loop over all copies for sensors of a kind; made once."""
    return _by_rays(bank) if bank.aims else _plain(bank)

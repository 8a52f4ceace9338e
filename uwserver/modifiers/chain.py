"""Carries out the operations of a stream one after the other, in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.modifiers.bias import BIAS, SCALE, bias, scale
from uwserver.modifiers.delivery import CLOCK_DRIFT, DELAY, DROPOUT, REORDER, clock_drift, delay, dropout, reorder
from uwserver.modifiers.drift import DRIFT, drift
from uwserver.modifiers.misalignment import MISALIGNMENT, misalign
from uwserver.modifiers.noise import GAUSS_MARKOV, OUTLIER, WHITE, gauss_markov, outlier, white
from uwserver.modifiers.operations import OPERATION, READING
from uwserver.modifiers.quantise import QUANTISE, SATURATE, quantise, saturate
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import entry, separate


@separate
def disturb(op: Any, numbers: Array, row: Array, reading: Any, dt: float) -> None:
    """Carry out one operation.

    Args:
        op: OPERATION.
        numbers: memory of the operations.
        row: values of the stream, packed by `columns`.
        reading: READING, or a record with the same fields.
        dt: sample interval, s.
    """
    code = op.code
    if code == WHITE:
        white(op, row, reading, dt)
    elif code == GAUSS_MARKOV:
        gauss_markov(op, numbers, row, reading, dt)
    elif code == OUTLIER:
        outlier(op, row, reading)
    elif code == BIAS:
        bias(op, numbers, row)
    elif code == SCALE:
        scale(op, numbers, row)
    elif code == DRIFT:
        drift(op, numbers, row, reading, dt)
    elif code == QUANTISE:
        quantise(op, row)
    elif code == SATURATE:
        saturate(op, row, reading)
    elif code == MISALIGNMENT:
        misalign(op, numbers, row)
    elif code == DELAY:
        delay(op, reading)
    elif code == DROPOUT:
        dropout(op, reading)
    elif code == REORDER:
        reorder(op, numbers, reading, dt)
    elif code == CLOCK_DRIFT:
        clock_drift(op, numbers, reading, dt)


@entry
def disturb_alone(ops: Array, numbers: Array, row: Array, readings: Array, dt: float) -> None:
    """Carry out the operations of one modifier on one reading, outside a world."""
    for op in ops:
        disturb(op, numbers, row, readings[0], dt)


def load() -> None:
    """Make `disturb_alone` ready: compile it, or load it from the cache."""
    disturb_alone.made().load(np.zeros(0, OPERATION), np.empty(0), np.empty(0), np.zeros(0, READING), 0.0)

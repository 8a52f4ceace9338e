"""From readings to samples, in compiled code: the errors of each stream, the samples in flight, and the delivery of a tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.modifiers import chain
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.kernel.sharing import share
from uwserver.physics.kernel.straight import address_of
from uwserver.ports.decimation import ROUNDING_NS
from uwserver.step.streams import FORMS, NEVER, READ

_LEAST = 16
"""Sensors whose errors a thread makes in one go: about 5 us."""

_heads, _streams, _operations = array_at(FORMS, "heads"), array_at(FORMS, "streams"), array_at(FORMS, "operations")
_numbers, _pending, _free = array_at(FORMS, "numbers"), array_at(FORMS, "pending"), array_at(FORMS, "free")
_delivered, _counts, _team = array_at(FORMS, "delivered"), array_at(FORMS, "counts"), array_at(FORMS, "team")
_decimations, _loose = array_at(FORMS, "decimations"), array_at(FORMS, "loose")
_log, _log_numbers = array_at(FORMS, "log"), array_at(FORMS, "log_numbers")


_carry_out = chain.disturb.made()


@compiled
def _earlier(pending: Array, a: int, b: int) -> bool:
    x, y = pending[a], pending[b]
    return bool(x.t_sent_ns < y.t_sent_ns or (x.t_sent_ns == y.t_sent_ns and x.order < y.order))


@compiled
def _swap(pending: Array, a: int, b: int) -> None:
    x, y = pending[a], pending[b]
    x.t_sent_ns, y.t_sent_ns = y.t_sent_ns, x.t_sent_ns
    x.order, y.order = y.order, x.order
    x.stream, y.stream = y.stream, x.stream
    x.seq, y.seq = y.seq, x.seq
    x.t_ns, y.t_ns = y.t_ns, x.t_ns
    x.valid, y.valid = y.valid, x.valid
    x.slot, y.slot = y.slot, x.slot


@compiled
def _rise(pending: Array, k: int) -> None:
    """Move entry k, the last of a heap, up to its place."""
    while k > 0 and _earlier(pending, k, (k - 1) // 2):
        _swap(pending, k, (k - 1) // 2)
        k = (k - 1) // 2


@compiled
def _sink(pending: Array, count: int) -> None:
    """Restore a heap of `count` entries whose first is gone, with the entry at place `count`. Children move up into the gap until that entry fits, as
    swaps would write twice as much."""
    k = 0
    while True:
        child = 2 * k + 1
        if child >= count:
            break
        if child + 1 < count and _earlier(pending, child + 1, child):
            child += 1
        if not _earlier(pending, child, count):
            break
        pending[k] = pending[child]
        k = child
    if count > 0:
        pending[k] = pending[count]


@compiled
def _is_taken(table: Array, stream: Any, t_ns: int) -> bool:
    """Return whether a sample of time `t_ns` is the first in its interval (`Decimation.interval`) for one of the readers of the stream."""
    decimations, is_taken = _decimations(table), False
    for n in range(stream.decimation_first, stream.decimation_first + stream.decimation_count):
        decimation = decimations[n]
        interval = int((t_ns - decimation.start_ns + ROUNDING_NS) * decimation.rate_hz // 1e9)
        if interval > decimation.interval:
            decimation.interval, is_taken = interval, True
    return is_taken


@compiled
def _log_in(table: Array, delivered: Any, values: Array, first: int, width: int, texts: int) -> None:
    """Append a delivered sample to the log. `delivered.slot` becomes its place there; it stays -1 where the log has no room."""
    counts, log, log_numbers = _counts(table)[0], _log(table), _log_numbers(table)
    n, begin = counts.logged, counts.log_width
    if n >= len(log) or begin + width > len(log_numbers):
        return
    on = log[n]
    on.t_sent_ns, on.order, on.stream, on.seq = delivered.t_sent_ns, texts, delivered.stream, delivered.seq
    on.t_ns, on.valid, on.slot = delivered.t_ns, delivered.valid, begin
    for i in range(width):
        log_numbers[begin + i] = values[first + i]
    delivered.slot = n
    counts.logged, counts.log_width = n + 1, begin + width
    counts.read += 1


@compiled
def _tell(
    table: Array, values: Array, delivered_values: Array, k: int, seq: int, t_ns: int, sent: int, valid: int, first: int, texts: int
) -> None:  # fmt: skip
    """Deliver a sample of stream k, whose values begin at `values[first]`. `texts` names its texts; 0: they wait in Python."""
    stream, numbers, counts = _streams(table)[k], _numbers(table), _counts(table)[0]
    if stream.newest != 0 and t_ns < stream.t_ns:
        # A reader begins its intervals anew when time goes back far, so every sample counts from here on.
        stream.unordered = 1
    stream.newest, stream.seq, stream.t_ns, stream.t_sent_ns, stream.valid = 1, seq, t_ns, sent, valid
    for i in range(stream.width):
        numbers[stream.newest_first + i] = values[first + i]
    if stream.use != 0:
        delivered = _delivered(table)[counts.delivered]
        delivered.t_sent_ns, delivered.stream, delivered.seq, delivered.t_ns, delivered.valid, delivered.slot = (
            sent,
            k,
            seq,
            t_ns,
            valid,
            -1,
        )
        for i in range(stream.width):
            delivered_values[counts.delivered, i] = values[first + i]
        is_whole = stream.decimation_count == 0 or stream.unordered != 0
        if stream.use == READ and (is_whole or _is_taken(table, stream, t_ns)):
            _log_in(table, delivered, values, first, stream.width, texts)
        if stream.loose != 0 and texts == 0:
            _loose(table)[counts.loose] = counts.delivered
            counts.loose += 1
        counts.delivered += 1


@compiled
def _arrive(table: Array, values: Array, delivered_values: Array, t_ns: int) -> None:
    """Deliver the samples in flight whose time has come."""
    pending, free, counts = _pending(table), _free(table), _counts(table)[0]
    flat = values.reshape(values.size)
    while counts.pending > 0 and pending[0].t_sent_ns <= t_ns:
        first = pending[0]
        slot = first.slot
        _tell(
            table, flat, delivered_values, first.stream, first.seq, first.t_ns, first.t_sent_ns, first.valid,
            slot * values.shape[1], 0,
        )  # fmt: skip
        counts.pending -= 1
        _sink(pending, counts.pending)
        free[counts.pending] = slot


@compiled
def _send(table: Array, values: Array, delivered_values: Array, k: int, seq: int, t_ns: int) -> None:
    """Deliver the present reading of stream k, or put it in flight if it has a delay."""
    stream, numbers, counts = _streams(table)[k], _numbers(table), _counts(table)[0]
    reading = stream.reading
    stamp, sent = max(0, reading.t_ns + reading.stamp_ns), reading.t_ns + reading.delay_ns
    if sent <= t_ns:
        _tell(table, numbers, delivered_values, k, seq, stamp, sent, stream.held.valid, stream.first, stream.texts)
        return
    n = counts.pending
    slot = _free(table)[n]
    for i in range(stream.width):
        values[slot, i] = numbers[stream.first + i]
    counts.order += 1
    on = _pending(table)[n]
    on.t_sent_ns, on.order, on.stream, on.seq, on.t_ns = sent, counts.order, k, seq, stamp
    on.valid, on.slot = stream.held.valid, slot
    counts.pending = n + 1
    _rise(_pending(table), n)


@compiled
def _disturb(table: Array, head: Any, k: int, t_ns: int, work: Array) -> None:
    """Make the reading of stream k: the reading of its sensor with the errors of the stream."""
    stream, numbers = _streams(table)[k], _numbers(table)
    reading = stream.reading
    for i in range(stream.width):
        work[i] = numbers[stream.source + i]
    if stream.ready_made == 0:
        reading.t_ns, reading.number = t_ns - head.since_ns, head.number
        reading.delay_ns, reading.stamp_ns = head.delay_ns + head.latency_ns, 0
        reading.valid = head.exact_valid if stream.exact != 0 else head.valid
        reading.dropped = 0
        operations = _operations(table)
        for n in range(stream.operation_first, stream.operation_first + stream.operation_count):
            _carry_out(operations[n], numbers, work, reading, stream.dt)
    if reading.dropped != 0:
        return
    held = stream.held
    held.t_ns = reading.t_ns
    if stream.frozen == 0 or held.there == 0:
        for i in range(stream.width):
            numbers[stream.first + i] = work[i]
        held.there, held.valid = 1, reading.valid


@compiled
def _disturb_range(first: int, end: int, me: int, table: Array, due: Array, t_ns: int, width: int) -> None:
    """Make the readings of all streams of the sensors `due[first:end]`."""
    heads, work = _heads(table), np.empty(width)
    for n in range(first, end):
        head = heads[due[n]]
        if head.ready != 0:
            for s in range(head.stream_first, head.stream_first + head.stream_count):
                _disturb(table, head, s, t_ns, work)


@entry
def deliver(table: Array, due: Array, t_ns: int, begins: bool, values: Array, delivered_values: Array) -> int:
    """Make samples of the readings of some sensors, and deliver those whose time has come.

    Args:
        table: made by `FORMS`.
        due: numbers of heads, in their order.
        t_ns: simulation time.
        begins: this is the first call in a tick. Samples in flight are then delivered first, as they are older than anything measured now.
        values: (n, w) numbers of the samples in flight, by slot.
        delivered_values: (m, w) receives the numbers of delivered samples of streams that somebody reads or hears. Their entries are in `delivered`.
            Samples that are read are appended to `log` as well; `slot` of the entry is the place there. `loose` receives the places in `delivered` of
            the samples with values that are no numbers.

    Returns:
        How many samples of this tick are in `delivered`.
    """
    heads, streams, counts = _heads(table), _streams(table), _counts(table)[0]
    share(_team(table), _disturb_range, (table, due, t_ns, values.shape[1]), len(due), _LEAST)
    if begins:
        counts.delivered = counts.read = counts.loose = 0
        _arrive(table, values, delivered_values, t_ns)
    for k in due:
        head = heads[k]
        if head.ready == 0:
            continue
        for s in range(head.stream_first, head.stream_first + head.stream_count):
            if streams[s].reading.dropped == 0:
                _send(table, values, delivered_values, s, head.number, t_ns)
        head.number += 1
    counts.next_ns = _pending(table)[0].t_sent_ns if counts.pending > 0 else NEVER
    return int(counts.delivered)


def code() -> int:
    """Return the address of `deliver`, once it is loaded, for kernels that call it (`kernel.calling`)."""
    return address_of(deliver, "int64")


def load() -> None:
    """Make the kernel ready, so that no tick waits for it: compile it, or load it from the cache."""
    kernel: Any = deliver
    values = np.empty((0, 1))
    kernel.load(np.zeros((0, 2), np.int64), np.zeros(0, np.int64), 0, True, values, values)

"""The arrays of all sensors: they grow while samples are on their way, and give each stream its newest sample."""

from __future__ import annotations

import numpy as np
from sensing_rig import Rig, slot_of

from uwserver.step.streams import NEVER


def test_arrays_grow_under_samples_on_their_way() -> None:
    """Sensors come one by one, rows move, and nothing that is on its way is lost or changed."""
    rig, expected = Rig(), []
    for n in range(1, 40):
        rig.slots[f"s{n}"] = slot_of(path=f"s{n}", divisor=n, latency_ns=10_000 - 10 * n)
        rig.sensors_changed()
        assert rig.samples(n) == []
        expected += [(f"s{k}", 10 * n) for k in range(1, n + 1) if n % k == 0]
    for slot in rig.slots.values():
        slot.active = False
    rig.sensing.schedule()
    samples = rig.samples(2000)
    assert sorted((s.port, s.t_ns) for s in samples) == sorted(expected)
    assert all(s.value == (s.seq + 1.0,) for s in samples), "numbers of another sample"
    assert rig.sensor_arrays.next_ns == NEVER


def test_rows_are_used_again() -> None:
    rig = Rig(slot_of(path="stays"))
    arrays = rig.sensor_arrays
    pools = arrays.heads, arrays.streams, arrays.operations, arrays.numbers
    for k in range(3):
        rig.slots["goes"] = slot_of(path="goes")
        rig.sensors_changed()
        rig.tick(k + 1)
        del rig.slots["goes"]
        rig.sensors_changed()
    sizes = [len(pool.rows) for pool in pools]
    for k in range(100):
        rig.slots["goes"] = slot_of(path="goes")
        rig.sensors_changed()
        rig.tick(k + 4)
        del rig.slots["goes"]
        rig.sensors_changed()
    assert [len(pool.rows) for pool in pools] == sizes


def test_what_was_read_at_another_time_is_forgotten() -> None:
    rig = Rig(slot_of(latency_ns=-3))
    rig.tick(1)
    newest = rig.sensing.newest("rov/x")
    assert newest is not None
    assert (newest.seq, newest.t_ns, newest.valid, newest.value) == (0, 10, True, (1.0,))
    rig.sensor_arrays.forget_newest()
    assert rig.sensing.newest("rov/x") is None


def test_samples_on_their_way_can_be_put_back() -> None:
    rig, other = (Rig(slot_of(path="a", latency_ns=95), slot_of(path="b", latency_ns=85)) for _ in range(2))
    for n in (1, 2, 3):
        rig.tick(n)
    order, entries, numbers = rig.sensor_arrays.in_flight()
    other.sensor_arrays.put_in_flight(order, entries, numbers)
    again = other.sensor_arrays.in_flight()
    assert again[0] == order == 6
    assert again[2].tolist() == numbers.tolist() == [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    names = [name for name in entries.dtype.names if name != "slot"]
    assert again[1][names].tolist() == entries[names].tolist()
    other.sensor_arrays.put_in_flight(order, entries[:0], np.zeros(0))
    assert len(other.sensor_arrays.in_flight()[1]) == 0


def test_one_body_is_seen_by_all_its_sensors_alike() -> None:
    rig = Rig()
    scopes = rig.sensor_arrays.scopes(70, with_rates=False)
    assert scopes(0, None) is scopes(0, None)
    assert (scopes(0, None).t_ns, scopes(0, None).nu_dot) == (70, (0.0,) * 6)
    rig.sensor_arrays.nu_dot, rig.sensor_arrays.tau = np.arange(6.0)[None], np.ones((1, 6))
    assert rig.sensor_arrays.scopes(70, with_rates=True)(0, None).nu_dot == (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)

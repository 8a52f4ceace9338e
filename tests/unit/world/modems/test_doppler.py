"""Doppler: who moves too fast against each other does not understand, and who can measure tells the relative speed."""

from __future__ import annotations

import numpy as np
import pytest
from modem_rig import asked, counts, listen, world_of

NEAR = {"a": (0.0, 0.0, 20.0), "b": (300.0, 400.0, 20.0)}
LEVEL = (1.0, 0.0, 0.0, 0.0)


def moving(world, **speeds):
    """Vehicles that move along (0.6, 0.8), the line between them, m/s."""
    for name, speed in speeds.items():
        vehicle = world.vehicles[name]
        vehicle.hydro.state[vehicle.row, 3:7] = LEVEL
        vehicle.hydro.state[vehicle.row, 7:10] = (0.6 * speed, 0.8 * speed, 0.0)


@pytest.mark.parametrize(("a", "b", "parting"), [(2.0, 0.0, -2.0), (0.0, 2.0, 2.0), (-1.5, 1.5, 3.0), (2.0, 2.0, 0.0)])
def test_the_speed_is_that_with_which_they_part(a, b, parting):
    """The sender's when it sent, the receiver's when it heard: held so long, but for what the water takes within a tick."""
    world = world_of(NEAR, ideal=True, speed_sigma_mps=0.1)
    world.step(2)
    moving(world, a=a, b=b)
    world.command("a/modem/send", destination=2, data=b"x")
    told = []
    while not told:
        moving(world, a=a, b=b)
        told = listen(world, 1.0 / 240)
    assert told[0].speed == pytest.approx(parting, abs=0.06)


def test_an_answer_tells_it_too_and_so_does_a_range():
    world = world_of(NEAR, ideal=True, speed_sigma_mps=0.0)
    replies = asked(world, "a/modem/range", destination=2)
    told = []
    while not any(m.by == "a" for m in told):
        moving(world, b=1.0)
        told += listen(world, 1.0 / 240)
    assert told[-1].speed == pytest.approx(1.0, abs=0.02)
    assert replies[0].result["relative_speed"] == told[-1].speed


def test_it_has_the_error_of_the_device():
    world = world_of({"a": (0.0, 0.0, 20.0), "b": (20.0, 0.0, 20.0)}, speed_sigma_mps=0.25, overhead_s=0.0)
    told = []
    for _ in range(200):
        world.command("a/modem/send", destination=2, data=b"x")
        told += listen(world, 0.05)
    # They drift against each other by millimetres a second.
    speeds = [m.speed for m in told]
    assert np.std(speeds) == pytest.approx(0.25, rel=0.15)
    assert abs(np.mean(speeds)) < 0.08


def test_a_modem_that_does_not_measure_tells_none():
    world = world_of(NEAR)
    world.command("a/modem/send", destination=2, data=b"x")
    assert listen(world, 1.0)[0].speed is None


def test_beyond_its_limit_a_packet_is_lost_and_counted():
    found = {}
    for speed in (1.8, 2.2, -1.8, -2.2):
        world = world_of(NEAR, doppler_limit_mps=2.0)
        world.command("a/modem/send", destination=2, data=b"x")
        told = []
        for _ in range(120):
            moving(world, b=speed)
            told += listen(world, 1.0 / 240)
        found[speed] = (len(told), counts(world, "b"))
    understood, lost = (1, {"heard": 1}), (0, {"doppler": 1})
    assert found == {1.8: understood, 2.2: lost, -1.8: understood, -2.2: lost}


def test_a_packet_that_was_lost_by_doppler_still_disturbs():
    world = world_of({**NEAR, "c": (305.0, 390.0, 20.0)}, doppler_limit_mps=2.0, overhead_s=0.5)
    world.command("a/modem/send", destination=2, data=bytes(60))
    world.command("c/modem/send", destination=2, data=bytes(60))
    for _ in range(300):
        moving(world, c=6.0, a=0.0, b=0.0)
        listen(world, 1.0 / 240)
    assert counts(world, "b") == {"collided": 1, "doppler": 1}

"""What is measured is what the report says: vehicles under command, sensors on or off, peers that really move."""

from __future__ import annotations

import math

import pytest
from uwserver_bench.engine import physics
from uwserver_bench.engine.peers import (
    LINEAR_DAMPING,
    PUSH,
    QUADRATIC_DAMPING,
    BulletWithNumpy,
    MujocoFluid,
    MujocoVehicle,
)
from uwserver_bench.engine.physics import OpenWater, bench_physics


def test_without_sensors_nothing_is_measured_and_with_them_all_are() -> None:
    for sensors in (False, True):
        contender = OpenWater(2, sensors)
        contender.prepare()
        contender.run(240)
        world = contender._world
        said = {path for path in world.sensors if world.read(path) is not None}
        assert said == (set(world.sensors) if sensors else set())
        assert len(world.sensors) == 6


def test_every_vehicle_is_driven_and_its_commands_change() -> None:
    contender = OpenWater(30)
    contender.prepare()
    world = contender._world
    thrusters = [slot for path, slot in world.actuators.items() if path.endswith("/thrusters")]
    before = [slot.last_value for slot in thrusters]
    contender.run(240)
    assert len(thrusters) == 30
    assert all(was != slot.last_value for was, slot in zip(before, thrusters, strict=True))
    assert all(slot.timeouts == 0 for slot in world.actuators.values())
    assert all(math.hypot(*vehicle.nu) > 1e-3 for vehicle in world.vehicles.values())


def test_commands_go_on_changing_from_one_short_run_to_the_next() -> None:
    """As the swarm is timed: a hundred milliseconds at a time."""
    contender = OpenWater(2)
    contender.prepare()
    slot = contender._world.actuators[contender._ports[1]]
    given = []
    for _ in range(4):
        contender.run(physics.COMMAND_EVERY)
        given.append(slot.last_value)
    assert len(set(given)) == 4


def test_a_repeat_begins_where_the_last_began() -> None:
    contender = OpenWater(1)
    hashes = []
    for _ in range(2):
        contender.prepare()
        contender.run(100)
        hashes.append(contender._world.call("world/state_hash"))
    assert hashes[0] == hashes[1]


def test_a_peer_that_is_not_installed_has_a_row_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(vehicles: int) -> None:
        raise ImportError("No module named 'peer'")

    absent.name = "a peer"  # type: ignore[attr-defined]
    monkeypatch.setattr(physics, "_PEERS", ((absent, "peer"),))
    monkeypatch.setattr(physics, "_interleaved", lambda contenders, *_: [])
    (row,) = bench_physics(quick=True, say=lambda line: None)
    assert (row.name, row.verdict) == ("a peer", "absent")
    assert "pip install peer" in row.note


def test_the_bullet_peer_reaches_the_terminal_velocity_of_its_push() -> None:
    pytest.importorskip("pybullet")
    peer = BulletWithNumpy(2)
    try:
        peer._push[:] = [PUSH[0], 0, 0, 0, 0, 0]
        peer.run(240 * 10)
        velocity, _ = peer._bullet.getBaseVelocity(peer._bodies[1], physicsClientId=peer._client)
    finally:
        peer.close()
    linear, quadratic = LINEAR_DAMPING[0], QUADRATIC_DAMPING[0]
    expected = (-linear + math.sqrt(linear**2 + 4 * quadratic * PUSH[0])) / (2 * quadratic)
    assert velocity[0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("kind", [MujocoFluid, MujocoVehicle])
def test_the_mujoco_peers_feel_water(kind: type[MujocoFluid]) -> None:
    pytest.importorskip("mujoco")
    peer = kind(3)
    peer.prepare()
    peer.run(1000)
    for k in range(3):
        velocity, drag = peer._state.qvel[6 * k : 6 * k + 3], peer._state.qfrc_passive[6 * k : 6 * k + 3]
        assert math.hypot(*velocity) > 1e-2
        assert float(velocity @ drag) < 0.0

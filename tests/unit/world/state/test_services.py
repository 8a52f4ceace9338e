"""Services of the world and its components, called in process."""

from __future__ import annotations

import pytest

from uwserver.ports import Call, Refused, Reply, Service


def test_every_component_has_its_services(world):
    for path in world.ports:
        for name in ("get", "set", "activate", "deactivate"):
            assert f"{path}/{name}" in world.services


def test_a_deactivated_sensor_is_silent_and_its_neighbours_are_not(world):
    world.call("rov/depth/deactivate")
    ports = {s.port for s in world.step(60)}
    assert "rov/depth" not in ports
    assert "rov/imu" in ports
    world.call("rov/depth/activate")
    assert "rov/depth" in {s.port for s in world.step(60)}


def test_a_rate_is_set_told_and_checked(world):
    world.call("rov/imu/set", rate_hz=24)
    assert world.ports["rov/imu"].rate_hz == 24
    assert world.call("rov/imu/get")["rate_hz"] == 24
    world.step(240 - world.tick % 240)
    assert sum(s.port == "rov/imu" for s in world.step(240)) == 24
    with pytest.raises(Refused, match="near it are"):
        world.call("rov/imu/set", rate_hz=7)
    with pytest.raises(Refused, match="does not divide"):
        world.call("rov/imu/set", rate_hz=1000)


def test_a_deactivated_actuator_is_neutral_and_refuses(world):
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(20)
    world.call("rov/thrusters/deactivate")
    assert not world.hydro.thrusters["command"].any()
    replies = []
    from uwserver.ports import Command

    world.submit(Command("rov/thrusters", ((0.5,) * 8,), "me"), replies.append)
    world.step()
    assert replies[0].fault.code == "denied"
    world.call("rov/thrusters/activate")
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step()
    assert world.call("rov/thrusters/get")["value"] == {"u": [0.5] * 8}


def test_the_watchdog_time_is_a_property(world):
    world.call("rov/thrusters/set", timeout_s=0.1)
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(20)
    assert world.hydro.thrusters["command"].all()
    world.step(10)
    assert not world.hydro.thrusters["command"].any()
    assert world.call("rov/thrusters/get")["timeouts"] == 1
    world.call("rov/thrusters/set", timeout_s=0)
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(1000)
    assert world.hydro.thrusters["command"].all()


def test_current_carries_the_vehicle_away(world):
    world.call("world/set_current", velocity_N=[0.2, 0.0, 0.0])
    world.step(240 * 20)
    assert world.vehicles["rov"].p_NB[0] > 1.0


@pytest.mark.parametrize(
    ("args", "phrase"),
    [
        ({}, "needs"),
        ({"velocity_N": [1, 2]}, "list of 3"),
        ({"velocity_N": [1, 2, "x"]}, "number"),
        ({"velocity_N": [1, 2, 99]}, "at most 20"),
        ({"velocity": [1, 2, 3]}, "did you mean"),
    ],
)
def test_arguments_are_checked(world, args, phrase):
    with pytest.raises(Refused, match=phrase):
        world.call("world/set_current", **args)


def test_an_unknown_service_suggests(world):
    with pytest.raises(Refused, match=r'did you mean "world/reset"'):
        world.call("world/rest")


def test_everybody_is_told_when_time_is_set(world):
    world.call("world/snapshot", name="here")
    world.call("world/restore", name="here")
    assert [(event.event, "here" in event.text) for event in world.flush().events] == [("reset", True)]


def test_the_name_of_a_snapshot_and_the_watchdog_time_are_bounded(world):
    assert world.call("world/snapshot", name="x" * 64)["name"] == "x" * 64
    with pytest.raises(Refused, match="at most 64 characters, not 65"):
        world.call("world/snapshot", name="x" * 65)
    with pytest.raises(Refused, match="at most 1e\\+06 s"):
        world.call("rov/thrusters/set", timeout_s=1e7)
    with pytest.raises(Refused) as caught:
        world.call("world/restore", name="y" * 10_000)
    assert len(caught.value.fault.text) < 300


def test_an_unexpected_fault_in_a_service_is_its_reply_and_the_world_goes_on(world, caplog):
    def breaks(_):
        raise ZeroDivisionError("somewhere inside")

    world.offer(Service("world/breaks", "Fail."), breaks)
    replies: list[Reply] = []
    world.submit(Call("world/breaks", {}), replies.append)
    world.submit(Call("world/state_hash", {}), replies.append)
    world.step(2)
    assert world.tick == 2
    assert [reply.fault and reply.fault.code for reply in replies] == ["internal", None]
    assert "world/breaks failed" in caplog.text
    assert "somewhere inside" in caplog.text

"""Which ports of a vehicle the telemetry is made of."""

from __future__ import annotations

from msgspec.structs import replace

from uwserver.ports import Field, Port


def test_the_world_is_told_what_the_telemetry_is_made_of(bench):
    rov = bench.rov
    assert rov.subscriptions == {path for path, port in rov.ports.items() if port.direction == "sensor"}
    field = (Field("x", "1", "x"),)
    others = [
        Port(path, "sensor", kind, field, "x", 1.0) for path, kind in (("rov/sonar", "sonar"), ("rov2/gps", "gps"))
    ]
    second = replace(rov.ports["rov/echo"], path="rov/echo2")
    before = rov.subscriptions
    rov.set_ports([*rov.ports.values(), *others, second])
    assert rov.subscriptions == before, "no sonar, no other vehicle, and of each kind the first"
    rov.set_ports([port for port in rov.ports.values() if port.path != "rov/echo"])
    assert rov.subscriptions == before - {"rov/echo"} | {"rov/echo2"}


def test_a_vehicle_without_instruments_needs_samples_that_tell_the_time(bench):
    made = bench
    clock = Port("rov/clock", "sensor", "clock", (Field("x", "1", "x"),), "x", 1.0, message="TimeReference")
    made.rov.set_ports([clock, made.rov.ports["rov/thrusters"]])
    assert made.router.subscriptions is None
    assert made.rov.subscriptions >= {"rov/clock"}

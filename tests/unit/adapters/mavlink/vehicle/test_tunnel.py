"""TUNNEL messages go through the vehicle's modem, and what it hears comes out of all links."""

from __future__ import annotations

import pytest

from uwserver.ports import Buffer, Port, Sample
from uwserver.sensors import AcousticModemConfig, Pose
from uwserver.sensors.modem import Modem
from uwserver.world.modems.send import Send

SEND = Send(AcousticModemConfig(rate_hz=1, max_bytes=200).build(Pose()), lambda *message: None, lambda: 0.0)
PORTS = {
    "rov/modem/send": Port("rov/modem/send", "actuator", "acoustic_modem", SEND.fields, SEND.doc),
    "rov/modem/received": Port(
        "rov/modem/received", "sensor", "acoustic_modem", Modem.fields, Modem.doc, 1.0, message="AcousticPacket"
    ),
}


@pytest.fixture
def bench(make_bench):
    made = make_bench()
    made.rov.ports = {**made.rov.ports, **PORTS}
    made.vehicle.tunnel.open_ports()
    return made


def put(station, kind, data, size=None):
    station.send("TUNNEL", 1, 1, kind, len(data) if size is None else size, list(data.ljust(128, b"\0")))


def sent(bench):
    return [(c.value[0], c.value[1].data) for c in bench.rov.commands if c.port == "rov/modem/send"]


def heard(event, data):
    return Sample(
        "rov/modem/received", 0, 10**9, 10**9, True, (event, 7, 1, Buffer(data=data), 1.0, 1.0, None, None, None, None)
    )


async def test_a_payload_is_sent_to_its_address_or_to_all(bench):
    station = bench.station()
    put(station, 32768 + 3, b"to three\0")
    put(station, 0, b"to all")
    assert sent(bench) == [((3.0,), b"to three\0"), (None, b"to all")]


async def test_other_protocols_and_wrong_lengths_are_counted(bench):
    station = bench.station()
    put(station, 200, b"of a gimbal")
    put(station, 0, b"x", size=200)
    assert sent(bench) == []
    assert (bench.counters["tunnel_type"], bench.counters["tunnel_length"]) == (1, 1)


async def test_what_cannot_be_sent_is_told(bench):
    station = bench.station()
    put(station, 32768 + 9999, b"x")
    assert sent(bench) == []
    assert any("destination" in text for text in station.texts())


async def test_what_is_heard_goes_to_all_in_pieces(bench):
    stations = bench.station(), bench.station(system=254)
    long = bytes(range(130))
    bench.router.put_samples([heard("data", long), heard("failed", b"mine")])
    for station in stations:
        first, second = station.of("TUNNEL")
        assert (first.payload_type, first.payload_length, second.payload_length) == (32768 + 7, 128, 2)
        assert bytes(first.payload[:128]) + bytes(second.payload[:2]) == long
    assert "rov/modem/received" in bench.router.subscriptions


async def test_without_a_modem_it_is_counted(make_bench):
    bench = make_bench()
    put(bench.station(), 0, b"x")
    assert bench.counters["tunnel_without_modem"] == 1

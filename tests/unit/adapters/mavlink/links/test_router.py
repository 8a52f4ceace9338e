"""Several links: who hears what (MAVLink routing), and that nothing goes round in circles."""

from __future__ import annotations

from uwserver_adapters.mavlink.links.router import ROUTES, Routes


def test_broadcasts_go_to_all_others_unaltered(bench):
    a, b, c = bench.station(255), bench.station(254), bench.station(253)
    data = a.bytes_of("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    bench.router.receive(a.channel, data)
    assert bytes(b.last("HEARTBEAT")._msgbuf) == data
    assert bytes(c.last("HEARTBEAT")._msgbuf) == data
    assert not a.of("HEARTBEAT")


def test_addressed_messages_go_where_the_addressee_was_seen(bench):
    a, b, c = bench.station(255), bench.station(254), bench.station(253)
    for station in (a, b, c):
        station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    a.send("PARAM_REQUEST_LIST", 253, 0)
    assert c.of("PARAM_REQUEST_LIST")
    assert not b.of("PARAM_REQUEST_LIST")
    a.send("PARAM_REQUEST_LIST", 77, 0)
    assert bench.counters["not_for_us"] == 1
    a.send("PARAM_REQUEST_READ", 1, 1, b"JS_GAIN_DEFAULT", -1)
    assert a.of("PARAM_VALUE")
    assert not b.of("PARAM_REQUEST_READ")


def test_a_component_of_our_system_on_another_link_is_reached(bench):
    a, camera = bench.station(255), bench.station(1, 100)
    camera.send("HEARTBEAT", 30, 8, 0, 0, 4, 3)
    assert a.last("HEARTBEAT").get_srcComponent() == 100
    a.send("COMMAND_LONG", 1, 100, 520, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert camera.last("COMMAND_LONG").command == 520
    assert not a.of("COMMAND_ACK")


def test_our_own_messages_that_come_back_are_dropped(bench):
    a, b = bench.station(255), bench.station(254)
    echo = bench.station(1, 1)
    echo.send("COMMAND_LONG", 1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert not bench.rov.calls
    assert not a.heard
    assert not b.heard


def test_radio_status_stays_on_its_link(bench):
    a, b = bench.station(51, 68), bench.station(254)
    a.send("RADIO_STATUS", 1, 1, 1, 1, 1, 1, 1)
    assert not b.of("RADIO_STATUS")


def test_a_closed_channel_is_forgotten_and_the_table_is_bounded():
    routing = Routes(1, 1)
    for system in range(2, 3 * ROUTES):
        routing.destinations(system, (system % 256, 1), (0, 0), "HEARTBEAT", ())
    assert len(routing._seen) == ROUTES
    routing.destinations(7, (9, 1), (0, 0), "HEARTBEAT", ())
    assert routing.destinations(1, (255, 190), (9, 0), "PARAM_SET", (1, 7)).to == (7,)
    routing.forget(7)
    assert routing.destinations(1, (255, 190), (9, 0), "PARAM_SET", (1, 7)).to == ()


def test_a_flood_of_one_peer_is_bounded_and_seen(make_bench):
    bench = make_bench(frames_per_s=100)
    flood, calm = bench.station(255), bench.station(254)
    for _ in range(300):
        flood.send("PARAM_REQUEST_READ", 1, 1, b"JS_GAIN_DEFAULT", -1)
    calm.send("PARAM_REQUEST_READ", 1, 1, b"JS_GAIN_DEFAULT", -1)
    assert len(flood.of("PARAM_VALUE")) == 100
    assert len(calm.of("PARAM_VALUE")) == 1
    bench.run(1.1)
    details = bench.rov.stats.details
    assert details["counters"]["flood"] == 200
    assert details["bad_input"] == 200


def test_a_flood_is_not_even_decoded(make_bench, monkeypatch):
    bench = make_bench(frames_per_s=100)
    flood = bench.station(255)
    seen = []
    decoder = flood.channel.decoder
    next_event = decoder.next_event

    def counted():
        seen.append(1)
        return next_event()

    monkeypatch.setattr(decoder, "next_event", counted)
    for _ in range(20):
        bench.router.receive(flood.channel, b"\xfd" * 65_507)
    assert len(seen) == 1024, "of one datagram, and then of none"
    bench.run(1.1)
    assert bench.rov.stats.details["counters"]["flood"] == 20
    flood.send("PARAM_REQUEST_READ", 1, 1, b"JS_GAIN_DEFAULT", -1)
    assert len(flood.of("PARAM_VALUE")) == 1


def test_bad_input_is_counted_and_shown(bench):
    station = bench.station()
    good = station.bytes_of("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    bench.router.receive(station.channel, b"hello" + good[:-1] + bytes((good[-1] ^ 1,)) + good)
    bench.run(1.1)
    counters = bench.rov.stats.details["counters"]
    assert counters["garbage_bytes"] == 5
    assert counters["checksum"] >= 1
    assert bench.rov.stats.peers == 1

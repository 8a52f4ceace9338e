"""A world that makes no more samples than its subscribers' rates take: each client gets the same ones as from a world that makes all of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
from uwserver_adapters.native.codec import JsonCodec
from uwserver_adapters.native.fanout import Fanout
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.shares import Subscription

from uwserver.adapter import AdapterStats
from uwserver.modifiers import ClockDrift, Delay, Dropout, Reorder
from uwserver.ports import Call, Port
from uwserver.ports.checks import checked_args
from uwserver.ports.crossing import TickOutput
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import ImuConfig, PressureConfig
from uwserver.simulation import bus as bus_module
from uwserver.simulation.bus import Bus
from uwserver.simulation.mailbox import Steering
from uwserver.simulation.readers import Readers
from uwserver.world import World

LATE = 5
"""Ticks after which the loop delivers: so many are under way when somebody leaves, or when the time is set."""


def small() -> World:
    """One port of each sort of delivery: at once, late and lossy, in another order, by a clock that is ahead."""
    sensors = {
        "plain": ImuConfig(rate_hz=120.0),
        "lossy": ImuConfig(rate_hz=80.0, modifiers={"link": Delay(latency_s=0.1), "loss": Dropout(probability=0.3)}),
        "mixed": PressureConfig(
            rate_hz=120.0,
            modifiers={"link": Delay(latency_s=1.5, jitter_s=0.8), "order": Reorder(probability=0.1, behind=200)},
        ),
        "ahead": PressureConfig(rate_hz=60.0, modifiers={"clock": ClockDrift(offset_s=0.3, drift=0.01)}),
    }
    entry = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 10.0), sensors=sensors)
    scenario = Scenario(schema=1, seed=7, world=WorldTable(rate_hz=240.0), vehicles={"rov": entry})
    return build(load(scenario, adapters={}))


@dataclass
class Context:
    """As much of a server as routes of samples need."""

    bus: Bus
    world: World
    stats: AdapterStats = field(default_factory=AdapterStats)

    @property
    def ports(self) -> Any:
        return self.bus.ports or self.world.ports

    def subscriptions_changed(self) -> None:
        self.bus.subscriptions_changed()


class Client:
    """Speaks JSON to nobody; keeps what it is sent."""

    def __init__(self, served: Served) -> None:
        self.codec, self.subscriptions = JsonCodec(), dict[int, Subscription]()
        self.received: list[bytes] = []
        self.outbox = Outbox(self.received.append, print, 1024, AdapterStats())
        self._served, self._fanout = served, served.fanout
        served.fanout.admit(self)

    def subscribe(self, serial: int, pattern: str, rate_hz: float | None) -> None:
        """Samples that are under way to others already may be fewer than all: they come before the world has heard of this one."""
        self._served.deliver()
        subscription = self.subscriptions[serial] = Subscription(serial, pattern, rate_hz, None, "ring")
        self._fanout.add(self, subscription)

    def unsubscribe(self, serial: int) -> None:
        self._fanout.remove(self, self.subscriptions.pop(serial))


class Served:
    """A world, and a loop that comes late in the same way each time."""

    def __init__(self) -> None:
        self.world, self.wakes = small(), list[Callable[[], None]]()
        self.bus = Bus(self.wakes.append)
        self.readers = Readers(self.world, self.bus, Steering(threading.Event()))
        self.fanout = Fanout(Context(self.bus, self.world))  # type: ignore[arg-type]  # the part of it that is used
        self.bus.attach(self.fanout)
        self.ticks = 0

    def call(self, service: str, **args: Any) -> None:
        """For the next tick."""
        self.world.submit(Call(service, checked_args(self.world.services[service], args), "me"))

    def run(self, count: int) -> None:
        for _ in range(count):
            self.readers.begin()
            self.bus.publish(self.world.advance())
            self.ticks += 1
            if self.ticks % LATE == 0:
                self.deliver()

    def deliver(self) -> None:
        while self.wakes:
            self.wakes.pop(0)()


def _calm(served: Served, one: Client, other: Client) -> None:
    """One slow reader of everything."""
    one.subscribe(1, "rov/*", 10.0)
    served.run(1200)


def _rates_change(served: Served, one: Client, other: Client) -> None:
    """Another reader comes to ports under way, at another rate, then whole; and a live subscription gets another rate."""
    one.subscribe(1, "rov/*", 10.0)
    served.run(403)
    other.subscribe(1, "rov/*", 7.0)
    served.run(351)
    other.subscribe(2, "rov/plain", None)
    served.run(123)
    other.unsubscribe(2)
    served.run(222)
    one.unsubscribe(1)
    one.subscribe(2, "rov/*", 3.0)
    served.run(600)
    other.unsubscribe(1)
    served.run(301)


def _time_is_set(served: Served, one: Client, other: Client) -> None:
    """Back by much and by little, and forward; while samples and wishes are under way."""
    one.subscribe(1, "rov/*", 10.0)
    served.run(501)
    served.call("world/snapshot", name="here")
    served.run(53)
    served.call("world/restore", name="here")
    served.run(7)
    other.subscribe(1, "rov/*", 4.0)
    served.run(460)
    served.call("world/reset")
    served.run(433)
    served.call("world/restore", name="here")
    served.run(3)
    one.unsubscribe(1)
    one.subscribe(2, "rov/l*", 9.0)
    served.run(431)


def _ports_change(served: Served, one: Client, other: Client) -> None:
    """A sensor measures at another rate: its port is another, and all begin anew."""
    one.subscribe(1, "rov/*", 10.0)
    other.subscribe(1, "rov/plain", 3.0)
    served.run(400)
    served.call("rov/plain/set", rate_hz=40.0)
    served.run(402)
    served.call("rov/lossy/set", rate_hz=20.0)
    served.run(2)
    other.subscribe(2, "rov/lossy", 5.0)
    served.run(399)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Ports of the samples that the world made."""
    ports: list[str] = []

    publish = Bus.publish

    def counted(bus: Bus, output: TickOutput, wake: bool = True) -> None:
        ports.extend(() if output.batch is None else output.batch.ports)
        ports.extend(sample.port for sample in output.made)
        publish(bus, output, wake)

    monkeypatch.setattr(Bus, "publish", counted)
    return ports


@pytest.mark.parametrize("play", [_calm, _rates_change, _time_is_set, _ports_change])
def test_clients_get_what_they_got_from_a_world_that_makes_all(
    play: Callable[[Served, Client, Client], None], made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def played() -> tuple[list[bytes], list[bytes], int]:
        served = Served()
        clients = Client(served), Client(served)
        made.clear()
        play(served, *clients)
        served.deliver()
        one, other = (b"".join(client.received).splitlines() for client in clients)
        return one, other, len(made)

    one, other, fewer = played()
    monkeypatch.setattr(bus_module, "merged_decimations", lambda readers, paths: {})
    all_one, all_other, whole = played()
    assert len(all_one) > 100
    assert one == all_one
    assert other == all_other
    assert fewer < 0.9 * whole, "it was not decimated"


def test_what_is_decimated_is_what_is_sent(made: list[str]) -> None:
    """In a calm world one sample is made for each that is sent, but where the order of delivery is not that of time."""
    served = Served()
    client = Client(served)
    client.subscribe(1, "rov/*", 10.0)
    served.run(480)
    made.clear()
    served.run(2400)
    ports: dict[str, Port] = dict(served.world.ports)
    assert {path: made.count(path) for path in ("rov/plain", "rov/ahead")} == {"rov/plain": 100, "rov/ahead": 101}
    assert 90 <= made.count("rov/lossy") <= 100
    assert made.count("rov/mixed") > 0.9 * 10 * (ports["rov/mixed"].rate_hz or 0.0)


def test_a_loop_that_has_not_heard_of_a_reset_thins_nothing_behind_it(made: list[str]) -> None:
    """What is enough was said of the samples before: until the loop answers, all are made."""
    served = Served()
    Client(served).subscribe(1, "rov/plain", 10.0)
    served.run(480)
    assert served.bus.subscriptions is not None
    assert served.bus.subscriptions.decimations.keys() == {"rov/plain"}
    served.call("world/reset")
    made.clear()
    for tick in range(240):  # nobody delivers
        if tick == 7:  # says again what was enough before
            served.bus.add_reader(SimpleNamespace(subscriptions=("rov/ahead",)))
            assert served.bus.subscriptions.decimations.keys() == {"rov/plain"}
        served.readers.begin()
        served.bus.publish(served.world.advance())
    assert made.count("rov/plain") == 120
    served.deliver()
    served.run(120)
    made.clear()
    served.run(480)
    assert made.count("rov/plain") == 20

"""What a server tells of itself: the status while it runs, waits and has failed, and the same numbers for Prometheus."""

from __future__ import annotations

import asyncio
import contextlib
import json

import numpy as np
from prometheus_client.parser import text_string_to_metric_families
from simulation_rig import Rig, profiling_of, running

from uwserver.scenario.scene.scenery import Scenery
from uwserver.server.context import Context, Hub
from uwserver.server.state_files import StateFiles
from uwserver.server.status import Metrics, Monitor
from uwserver.simulation.clock import Timing


def watched(rig: Rig) -> tuple[Hub, Monitor]:
    files = StateFiles(None, rig.simulation, rig.mailbox, lambda function: function())
    scenery = Scenery(rig.resolved, rig.world)
    hub = Hub("pool", rig.simulation, rig.bus, rig.mailbox, print, dict, files, profiling_of(rig), scenery)
    return hub, Monitor(lambda: hub, lambda: 0)


def numbers(hub: Hub, monitor: Monitor) -> dict[tuple[str, str], float]:
    """Every sample of the exposition, by its name and its adapter or bucket."""
    return {
        (sample.name, sample.labels.get("adapter", sample.labels.get("le", ""))): sample.value
        for family in text_string_to_metric_families(Metrics(hub, monitor).text().decode())
        for sample in family.samples
    }


def test_the_status_says_where_the_world_is(resolved):
    with running(resolved, Timing(speed=3.0, paused=True)) as rig:
        hub, monitor = watched(rig)
        context = Context(hub, "tcp", False)
        context.stats.peers = 2
        rig.call("world/step", n=24)
        status = monitor.status()
        assert (status["server"], status["scenario"]) == ("pool", rig.world.name)
        assert (status["tick"], status["t_ns"], status["t_s"]) == (24, 100_000_000, 0.1)
        assert (status["mode"], status["speed"], status["paused"], status["failure"]) == ("realtime", 3.0, True, "")
        assert status["vehicles"] == ["rov"]
        assert status["lockstep_waits_for"] == []
        assert status["adapters"]["tcp"]["peers"] == 2
        assert status["stops"] == {"room": 1}, "what ticks have needed Python for, and nothing that they have not"
        assert json.loads(json.dumps(status)) == status
        context.stats.peers = 3
        assert status["adapters"]["tcp"]["peers"] == 2, "an answer does not change while it is sent"


def test_the_status_names_who_is_waited_for(resolved):
    timing = Timing(mode="lockstep", lockstep_clients=("b", "a"), lockstep_timeout_s=0.0)
    with running(resolved, timing) as rig:
        _, monitor = watched(rig)
        assert monitor.status()["lockstep_waits_for"] == ["a", "b"]
        answers, _ = rig.begin("world/step", client="a", n=1)
        rig.final(rig.begin("world/set_speed", speed=1.0)[0])  # carried out behind it
        assert monitor.status()["lockstep_waits_for"] == ["b"]
        rig.begin("world/step", client="b", n=1)
        rig.final(answers)


def test_a_failure_is_told_until_the_world_runs_again(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        _, monitor = watched(rig)
        rig.simulation.steer(lambda: rig.world.hydro.state.__setitem__((0, 7), np.nan))
        rig.begin("world/step", n=1)
        rig.event("diverged")
        assert '"rov" diverged' in monitor.status()["failure"]
        assert monitor.status()["paused"] is True


def test_the_real_time_factor_is_simulated_over_wall_time(resolved, monkeypatch):
    """Between two looks 50 ms of simulation and 25 ms of the clock pass; a world that was put back in time does not run backwards."""
    with running(resolved, Timing(paused=True)) as rig:
        hub, _ = watched(rig)
        now, looks = iter((0, 25_000_000, 50_000_000)), []
        monitor = Monitor(lambda: hub, lambda: next(now))

        async def look(_: float) -> None:
            looks.append(monitor.real_time_factor)
            if len(looks) == 1:
                rig.call("world/step", n=12)
            elif len(looks) == 2:
                rig.simulation.steer(lambda: rig.world.jump(0))
                rig.final(rig.begin("world/set_speed", speed=1.0)[0])
            else:
                raise asyncio.CancelledError

        monkeypatch.setattr("uwserver.server.status.asyncio.sleep", look)
        task = monitor.run()
        with contextlib.suppress(asyncio.CancelledError):
            task.send(None)
        assert looks == [0.0, 2.0, 0.0]


def test_metrics_are_the_same_numbers(resolved):
    with running(resolved, Timing(paused=True)) as rig:
        hub, monitor = watched(rig)
        for k, name in enumerate(("tcp", "moos")):
            stats = Context(hub, name, False).stats
            stats.peers, stats.samples_sent, stats.restarts = 1 + k, 100 + k, k
        rig.call("world/step", n=24)
        rig.simulation.lateness.add(1_500_000)
        found = numbers(hub, monitor)
        assert found["uwserver_ticks_total", ""] == 24
        assert found["uwserver_simulation_time_seconds", ""] == 0.1
        assert found["uwserver_paused", ""] == 1
        assert found["uwserver_overruns_total", ""] == found["uwserver_command_conflicts_total", ""] == 0
        assert found["uwserver_bus_dropped_samples_total", ""] == 0
        assert found["uwserver_adapter_peers", "tcp"] == 1
        assert found["uwserver_adapter_peers", "moos"] == 2
        assert found["uwserver_adapter_samples_sent_total", "moos"] == 101
        assert found["uwserver_adapter_restarts_total", "moos"] == 1
        buckets = [value for (name, _), value in found.items() if name == "uwserver_tick_lateness_seconds_bucket"]
        assert buckets == sorted(buckets), "buckets add up"
        assert (
            found["uwserver_tick_lateness_seconds_bucket", "+Inf"]
            == found["uwserver_tick_lateness_seconds_count", ""]
            == 1
        )

"""What is wanted of the clock: a pause takes back what its own client wanted, and nothing else."""

from __future__ import annotations

import threading

from uwserver.simulation.steering import Steering


def test_a_pause_overtakes_and_withdraws_the_requests_of_its_client_alone() -> None:
    wake, done, told = threading.Event(), [], []
    steering = Steering(wake)
    steering.add(lambda: done.append("other"), "robots:2", lambda _: told.append("other"))
    steering.add(lambda: done.append("resume"), "robots:1", lambda _: told.append("resume"))
    steering.add(lambda: done.append("cancel"), "robots:1 (name)", always=True)
    assert wake.is_set()
    withdrawn = steering.stop(lambda: done.append("pause"), "robots:1 (name)", lambda _: told.append("pause"))
    for on_reply in withdrawn:
        on_reply(None)  # type: ignore[arg-type]
    while (each := steering.take()) is not None:
        each.action()
    assert done == ["pause", "other", "cancel"], "what nobody waits for is carried out"
    assert told == ["resume"]

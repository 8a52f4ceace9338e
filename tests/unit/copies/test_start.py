"""Scenarios that cannot be copied are refused, and the text names the reason."""

from __future__ import annotations

import pytest

import uwserver
from uwserver.ports import Refused
from uwserver.scenario.builder import ScenarioBuilder


def begun():
    return ScenarioBuilder("made").vehicle("rov", "bluerov2_heavy")


@pytest.mark.parametrize(
    ("scenario", "names"),
    [
        (lambda: begun().sensor("rov", "eye", "camera", rate_hz=2).build(), [r"pictures.*rov/eye"]),
        (lambda: begun().sensor("rov", "talk", "acoustic_modem", rate_hz=10, address=3).build(), [r"modems.*rov/talk"]),
        (lambda: begun().adapter("bus", "zenoh").build(), [r"adapters\.bus \(zenoh\)"]),
    ],
)
def test_it_names_what_it_refuses(scenario, names):
    for name in names:
        with pytest.raises(Refused, match=name):
            uwserver.batch(scenario(), 2)


def test_an_adapter_that_only_lets_clients_in_is_left_out():
    assert uwserver.batch(begun().adapter("tcp", "sockets").adapter("view", "web").build(), 1, sensors=()).n == 1

"""What copies do not act out is refused by its name."""

import pytest

import uwserver
from uwserver.ports import Refused
from uwserver.scenario.builder import ScenarioBuilder


def begun():
    return ScenarioBuilder("made").vehicle("rov", "bluerov2_heavy")


@pytest.mark.parametrize(
    ("scenario", "names"),
    [
        (
            lambda: (
                begun()
                .seabed("flat", depth_m=10)
                .structure("wall", "box", size_m=[1, 2, 3], position_ned_m=[9, 0, 5])
                .build()
            ),
            ["solid things.*seabed", "solid things.*wall"],
        ),
        (lambda: begun().adapter("bus", "zenoh").build(), [r"adapters\.bus \(zenoh\)"]),
        (
            lambda: begun().sensor("rov", "rpm", "rpm", rate_hz=10, members=["t1"]).build(),
            [r"plain Python.*rov/rpm \(rpm\)"],
        ),
    ],
)
def test_it_names_what_it_refuses(scenario, names):
    for name in names:
        with pytest.raises(Refused, match=name):
            uwserver.batch(scenario(), 2)


def test_an_adapter_that_only_lets_clients_in_is_left_out():
    assert uwserver.batch(begun().adapter("tcp", "sockets").adapter("view", "web").build(), 1, sensors=()).n == 1

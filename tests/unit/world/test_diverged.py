"""What a diverged world says: body, tick, state and the newest commands."""

from __future__ import annotations

import pytest

import uwserver
from uwserver.ports.crossing import TickOutput
from uwserver.world import Diverged
from uwserver.world.diverged import report


def test_the_report_names_body_tick_and_commands():
    world = uwserver.load("bluerov2_pool")
    world.command("bluerov2/wrench", force_B=[1, 2, 3])
    world.step()
    world.hydro.state[world.vehicles["bluerov2"].row, 0] = float("nan")
    with pytest.raises(Diverged) as caught:
        world.step()
    text = str(caught.value)
    assert text.startswith('body "bluerov2" diverged in tick ')
    assert "bluerov2/wrench" in text
    assert isinstance(caught.value.output, TickOutput)
    assert report(7, 0, None, world._commands) == "a body that is no longer there diverged in tick 7"

"""One more way: a server in a process of its own, driven over a socket, with a recorder and eight subscribers to everything."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

from server_process import Audience, Peer, serving
from stories import Story
from traces import STATE_EVERY, Trace
from ways import ODD

SUBSCRIBERS = 8


def served(story: Story, path: Path) -> Trace:
    """Its states; its samples are in its recording."""
    trace = Trace()
    options = ("--paused", "--mode", "freerun", "--record", str(path))
    with serving(story.scenario, *options) as (address, _):
        audience, peer = Audience(address, SUBSCRIBERS), Peer(address)
        try:
            _drive(story, peer, trace)
            assert audience.heard > 100 * story.steps
        finally:
            audience.leave()
            peer.close()
    return trace


def _drive(story: Story, peer: Peer, trace: Trace) -> None:
    step, sizes = 0, cycle(ODD)
    while step < story.steps:
        for _, act in story.numbered(step):
            if act.is_command:
                peer.ask("command", port=act.path, value=act.given)
            elif act.path.endswith("/goto"):
                peer.begin(act.path, **act.given)
                peer.call("world/faults")  # so that it was carried out before the next step
            else:
                peer.call(act.path, **act.given)
        end = min(story.next_after(step), (step // STATE_EVERY + 1) * STATE_EVERY)
        while step < end:
            n = min(next(sizes), end - step)
            reply = peer.ask("step", n=n)
            assert "result" in reply, reply
            step += n
        if step % STATE_EVERY == 0 or step == story.steps:
            state = peer.call("world/state_hash")["result"]["value"]
            trace.states[str(step)] = (state["tick"], state["hash"])

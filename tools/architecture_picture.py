"""Draws docs/images/architecture.png: the rooms of the house, the two threads, and the ways of a sample and of a command between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PICTURE = Path(__file__).parents[1] / "docs/images/architecture.png"
WIDTH, HEIGHT = 132.0, 88.0
INK, GREY, SAMPLE, COMMAND, LOAD = "#1a1a1a", "#5f6670", "#0b62a8", "#c2540a", "#6b4d9c"


class Box(NamedTuple):
    """A room or a part of one: left, bottom, width, height, its name, what it does."""

    x: float
    y: float
    w: float
    h: float
    name: str
    text: str = ""
    fill: str = "white"


BANDS = (
    Box(27, 61, 103, 25, "the asyncio loop: all input and output", "", "#e8f1fa"),
    Box(27, 14, 103, 38, "the simulation thread: never waits for a peer", "", "#eaf5ea"),
    Box(2, 14, 20, 72, "before the start", "", "#f1ecf8"),
)
LOOP = (
    *(
        Box(30 + 13 * k, 74, 12, 7, name, "adapters/", "#ffffff")
        for k, name in enumerate(("sockets", "zenoh", "MAVLink", "MOOS", "ArduPilot, PX4"))
    ),
    Box(97, 74, 13, 7, "yours", "an entry point", "#ffffff"),
    Box(
        30,
        63,
        80,
        7,
        "uwserver/adapter, uwserver/server",
        "the contract of adapters; one context each: ports, checks, replies, status",
    ),
    Box(113, 63, 14.5, 18, "uwserver/\nrecording", "a sink like\nany other;\nreplay"),
)
CROSSING = (
    Box(33, 53.5, 31, 6, "Mailbox", "uwserver/simulation", "#fdeee2"),
    Box(81, 53.5, 46.5, 6, "Bus", "uwserver/simulation: one wake-up a tick", "#e1eefa"),
)
TICK = (
    Box(30, 31, 20, 15, "uwserver/world", "faults, commands and\ncalls, watchdogs,\nsnapshots", "#ffffff"),
    Box(53, 39, 21, 7, "uwserver/actuators", "limits, neutral"),
    Box(53, 31, 21, 6, "uwserver/autopilot", "steers where told"),
    Box(81, 31, 21, 15, "uwserver/sensors", "what an instrument\nmeasures, at its rate,\nwith its timing", "#ffffff"),
    Box(106, 31, 21.5, 15, "uwserver/modifiers", "noise, bias, delay,\nloss: seeded", "#ffffff"),
    Box(
        30,
        16,
        58,
        11.5,
        "uwserver/physics",
        "compiled: bodies in water, collision, contact, rays;\nall state in arrays",
        "#ffffff",
    ),
    Box(91, 16, 36.5, 11.5, "uwserver/environment", "sea water, currents, waves,\nsound, Earth", "#ffffff"),
)
LOADING = (
    Box(4, 72, 16, 8, "*.toml", "scenario, vehicles,\ndevices"),
    Box(4, 57, 16, 10, "scenario/files", "TOML to tables:\nplaces of keys,\nall faults at once"),
    Box(4, 42, 16, 10, "scenario/load", "profiles, defaults,\nchecks; degrees\nto radians"),
    Box(4, 27, 16, 10, "scenario/build", "the only place that\nknows concrete\nclasses"),
)
WORDS = "the vocabulary of every wall: Port, Field, Sample, Command, Call, Reply, Buffer; SI, radians, nanoseconds; N = NED, B = FRD"
GROUND = Box(2, 2, 128, 9, "uwserver/ports, frames, units", WORDS, "#f4f4f4")

ARROWS: tuple[tuple[str, tuple[float, float], tuple[float, float]], ...] = (
    (COMMAND, (49, 74), (49, 70)),
    (COMMAND, (49, 63), (49, 59.5)),
    (COMMAND, (42, 53.5), (42, 46)),
    (COMMAND, (50, 42.5), (53, 42.5)),
    (COMMAND, (50, 34), (53, 34)),
    (COMMAND, (63.5, 37), (63.5, 39)),
    (COMMAND, (77, 42.5), (77, 27.5)),
    (SAMPLE, (85, 27.5), (85, 31)),
    (SAMPLE, (97, 27.5), (97, 31)),
    (SAMPLE, (102, 38.5), (106, 38.5)),
    (SAMPLE, (117, 46), (117, 53.5)),
    (SAMPLE, (95, 59.5), (95, 63)),
    (SAMPLE, (75, 70), (75, 74)),
    (SAMPLE, (120, 59.5), (120, 63)),
    (GREY, (91, 21.5), (88, 21.5)),
    (LOAD, (12, 72), (12, 67)),
    (LOAD, (12, 57), (12, 52)),
    (LOAD, (12, 42), (12, 37)),
    (LOAD, (20, 32), (30, 36)),
)


def _box(axes: Any, box: Box) -> None:
    axes.add_patch(
        FancyBboxPatch((box.x, box.y), box.w, box.h, "round,pad=0,rounding_size=0.8", fc=box.fill, ec=GREY, lw=0.9)
    )
    lines = box.text.count("\n") + 1 if box.text else 0
    names = box.name.count("\n") + 1
    top = box.y + box.h / 2 + (lines * 1.05 if lines else 0.0)
    axes.text(box.x + box.w / 2, top, box.name, ha="center", va="center", fontsize=8.4, weight="bold", color=INK)
    if lines:
        below = top - 1.1 * names - 1.05 * lines + (0.2 if lines == 1 else 0.1)
        axes.text(
            box.x + box.w / 2, below, box.text, ha="center", va="center", fontsize=7.2, color=INK, linespacing=1.25
        )


def draw() -> Figure:
    """The whole picture."""
    figure = Figure(figsize=(12.0, 8.0), dpi=130)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axes.axis("off")
    for band in BANDS:
        axes.add_patch(
            FancyBboxPatch((band.x, band.y), band.w, band.h, "round,pad=0,rounding_size=1.2", fc=band.fill, ec="none")
        )
        x = band.x + (24.0 if band.h == 38 else 1.5)  # beside the way of a command
        axes.text(x, band.y + band.h - 1.9, band.name, fontsize=8.6, color=GREY, style="italic", va="center")
    for box in (*LOOP, *CROSSING, *TICK, *LOADING, GROUND):
        _box(axes, box)
    for colour, start, end in ARROWS:
        axes.add_patch(
            FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=13, lw=2.0, color=colour, shrinkA=0, shrinkB=0)
        )
    # The line from the actuators to the kernel has a corner.
    axes.plot((74, 77), (42.5, 42.5), color=COMMAND, lw=2.0, solid_capstyle="butt")
    for colour, x, y, text in (
        (COMMAND, 50.2, 61.5, "a command"),
        (SAMPLE, 96.2, 61.5, "a sample"),
        (LOAD, 12.8, 69.5, "a key"),
    ):
        axes.text(x, y, text, fontsize=8.0, color=colour, weight="bold", va="center")
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, metadata={"Software": None})

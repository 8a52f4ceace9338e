"""Draws docs/images/architecture.png: the rooms, the two threads, and the paths of a sample and of a command between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PICTURE = Path(__file__).parents[1] / "docs/images/architecture.png"
WIDTH, HEIGHT = 132.0, 88.0
INK, GREY, SAMPLE, COMMAND, LOAD = "#1a1a1a", "#5f6670", "#0b62a8", "#c2540a", "#6b4d9c"


class Box(NamedTuple):
    """A room or a part of one: left, bottom, width, height, name, and what it does."""

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
    Box(33, 53.5, 31, 6, "Mailbox", "uwserver/simulation: commands and calls", "#fdeee2"),
    Box(81, 53.5, 46.5, 6, "Bus", "uwserver/simulation: samples as rows; wakes the loop", "#e1eefa"),
)
STEP = Box(
    53, 15.5, 76, 32.5, "uwserver/step: the order of a tick, compiled; it releases the interpreter lock", "", "#d6ead6"
)
TICK = (
    Box(
        30,
        30,
        20,
        16,
        "uwserver/world",
        "faults, commands and\ncalls, watchdogs;\nparts in Python,\nsnapshots",
        "#ffffff",
    ),
    Box(55, 32, 16.5, 10, "autopilot", "estimates,\nsteers", "#ffffff"),
    Box(74, 32, 16, 10, "actuators", "commands become\nforces", "#ffffff"),
    Box(92.5, 32, 16, 10, "sensors", "readings that\nare due", "#ffffff"),
    Box(111, 32, 16, 10, "modifiers", "noise, bias,\ndelay, loss", "#ffffff"),
    Box(55, 18, 42, 10, "physics", "bodies in water, collision, contact, rays;\nall state in arrays", "#ffffff"),
    Box(100, 18, 27, 10, "environment", "sea water, currents, waves,\nsound, Earth", "#ffffff"),
)
LOADING = (
    Box(4, 72, 16, 8, "*.toml", "scenario, vehicles,\ndevices"),
    Box(4, 57, 16, 10, "scenario/files", "TOML to tables:\nlines of keys,\nall mistakes at once"),
    Box(4, 42, 16, 10, "scenario/load", "profiles, defaults,\nchecks; degrees\nto radians"),
    Box(4, 27, 16, 10, "scenario/build", "the only place that\nknows concrete\nclasses"),
)
WORDS = "types that all rooms share: Port, Field, Sample, Command, Call, Reply, Buffer; SI, radians, nanoseconds; N = NED, B = FRD"
GROUND = Box(2, 2, 128, 9, "uwserver/ports, frames, units", WORDS, "#f4f4f4")

ARROWS: tuple[tuple[str, tuple[float, float], tuple[float, float]], ...] = (
    (COMMAND, (49, 74), (49, 70)),
    (COMMAND, (49, 63), (49, 59.5)),
    (COMMAND, (42, 53.5), (42, 46)),
    (COMMAND, (50, 37), (55, 37)),
    (COMMAND, (71.5, 37), (74, 37)),
    (COMMAND, (82, 32), (82, 28)),
    (SAMPLE, (95, 28), (95, 32)),
    (SAMPLE, (104, 28), (104, 32)),
    (SAMPLE, (108.5, 37), (111, 37)),
    (SAMPLE, (119, 42), (119, 53.5)),
    (SAMPLE, (95, 59.5), (95, 63)),
    (SAMPLE, (75, 70), (75, 74)),
    (SAMPLE, (120, 59.5), (120, 63)),
    (GREY, (100, 23), (97, 23)),
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
    """Return the whole picture."""
    figure = Figure(figsize=(12.0, 8.0), dpi=130)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axes.axis("off")
    for band in (*BANDS, STEP):
        axes.add_patch(
            FancyBboxPatch((band.x, band.y), band.w, band.h, "round,pad=0,rounding_size=1.2", fc=band.fill, ec="none")
        )
        x = band.x + (26.0 if band.h == 38 else 1.5)  # beside the path of a command
        axes.text(x, band.y + band.h - 1.9, band.name, fontsize=8.6, color=GREY, style="italic", va="center")
    for box in (*LOOP, *CROSSING, *TICK, *LOADING, GROUND):
        _box(axes, box)
    for colour, start, end in ARROWS:
        axes.add_patch(
            FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=13, lw=2.0, color=colour, shrinkA=0, shrinkB=0)
        )
    for colour, x, y, text in (
        (COMMAND, 50.2, 61.5, "a command"),
        (SAMPLE, 96.2, 61.5, "a sample"),
        (LOAD, 12.8, 69.5, "a key"),
    ):
        axes.text(x, y, text, fontsize=8.0, color=colour, weight="bold", va="center")
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, metadata={"Software": None})

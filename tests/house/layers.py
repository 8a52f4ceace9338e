"""The parts of uwserver, one above the other."""

from __future__ import annotations

LAYERS: tuple[tuple[str, ...], ...] = (
    ("__main__",),
    ("cli",),  # verbs of a person: may use everything
    ("in_process",),  # what a Python program gets of a world: may start a server for it
    (
        "server",
        "testing",
    ),  # life cycle: the first that knows loop and thread; the kit for tests of others, which starts no server
    ("recording", "validation"),  # a sink, its file, and what runs it again; what a person asks of a model
    ("simulation",),  # the simulation thread, and the crossing to the loop
    ("copies",),  # a scenario's world many times over, in this process
    ("scenario",),  # files -> world; adapters' configuration types come from their contract
    ("logfiles",),  # logs of any origin, as poses and samples
    ("adapter",),  # contract of adapters, and what all of them need: an adapter imports this and the vocabulary alone
    ("world",),  # what lives in it: names, parts in Python, where steps stop
    ("step",),  # the order of a tick, compiled
    ("autopilot",),  # shows its state as a sensor
    ("actuators", "sensors"),
    ("modifiers",),
    ("environment",),  # asks the kernel what the water does
    ("physics",),  # arrays and kernel: knows no component
    ("ports",),  # the vocabulary of every wall
    ("frames", "table", "logs", "packages"),
    ("units", "version"),
)
"""Highest first. A module imports only from lower lines, or from its own part; parts that share a line do not know each other. So each part can be
understood, tested and replaced with what is below it alone."""

RANK = {part: rank for rank, line in enumerate(LAYERS) for part in line}
VOCABULARY = {"ports", "frames", "table", "units"}
"""What everybody speaks, in other languages too."""


def stands_at_least(part: str, other: str) -> bool:
    """Whether a part stands where the other does, or above."""
    return RANK[part] <= RANK[other]

"""Puts the autopilot's texts into the words of a ground station: modes have ArduSub's names, and services and ports are not mentioned."""

from __future__ import annotations

import re
from collections.abc import Callable

from uwserver_adapters.mavlink.vehicle.modes import MODES, shown

_NAMES = "|".join({mode.autopilot for mode in MODES} | {"velocity", "heading_hold"})
_RULES: tuple[tuple[re.Pattern[str], str | Callable[[re.Match[str]], str]], ...] = (
    (re.compile(r"call \S+/set_mission first"), "upload one first"),
    (re.compile(r"call \S+/arm first"), "arm first"),
    (re.compile(r"call \S+/disarm first, or steer by \S+"), "disarm first, or steer by the sticks"),
    (
        re.compile(r"call \S+/set_mode with ([a-z_]+(?: or [a-z_]+)*) first"),
        lambda m: f"change to {_modes(m[1])} first",
    ),
    (re.compile(r"arm with force = true if you must"), "force arming if you must"),
    (re.compile(r"arm with force = true"), "force arming"),
    (re.compile(rf"\b(in mode|mode) ({_NAMES})\b"), lambda m: f"{m[1]} {shown(m[2]).name}"),
    (re.compile(rf"^({_NAMES})(?= has no )"), lambda m: shown(m[1]).name),
)


def _modes(names: str) -> str:
    """Return ArduSub's names of some of the autopilot's modes, each once."""
    return " or ".join(dict.fromkeys(shown(name).name for name in names.split(" or ")))


def in_words_of_mavlink(text: str) -> str:
    """Return a text of the autopilot as it is sent in STATUSTEXT."""
    for pattern, words in _RULES:
        text = pattern.sub(words, text)
    return text

"""Colours on terminals. Where the output is none, click takes them out; where NO_COLOR is set, they are not put in (no-color.org)."""

from __future__ import annotations

import os
import re
from typing import Literal

import click

Colour = Literal["green", "yellow", "red", "cyan"]


def styled(text: str, fg: Colour | None = None, bold: bool = False) -> str:
    """The text in a colour."""
    return text if os.environ.get("NO_COLOR") else click.style(text, fg=fg, bold=bold or None)


def coloured_problems(text: str) -> str:
    """Faults and warnings of scenarios, one a line: the place red, or yellow for a warning."""
    return "\n".join(map(_problem, text.splitlines()))


def _problem(line: str) -> str:
    place = re.match(r"\S+?:(?:\d+:\d+:)?(?= )", line)
    if place is None:
        return styled(line, bold=True)
    return styled(place[0], fg="yellow" if ": warning: " in line else "red") + line[place.end() :]

"""Colours on terminals. click removes them where the output is no terminal; NO_COLOR prevents them (no-color.org)."""

from __future__ import annotations

import os
import re
from typing import Literal

import click

Colour = Literal["green", "yellow", "red", "cyan"]


def styled(text: str, fg: Colour | None = None, bold: bool = False) -> str:
    """Return the text in a colour."""
    return text if os.environ.get("NO_COLOR") else click.style(text, fg=fg, bold=bold or None)


def coloured_problems(text: str) -> str:
    """Return the faults and warnings of a scenario, one on each line, with the place in red, or in yellow for a warning."""
    return "\n".join(map(_problem, text.splitlines()))


def _problem(line: str) -> str:
    place = re.match(r"\S+?:(?:\d+:\d+:)?(?= )", line)
    if place is None:
        return styled(line, bold=True)
    return styled(place[0], fg="yellow" if ": warning: " in line else "red") + line[place.end() :]

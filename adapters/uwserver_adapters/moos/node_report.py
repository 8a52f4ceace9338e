"""What a node report says: ``NAME=henry,TYPE=auv,X=12.3,Y=-4,DEP=5,HDG=90,SPD=1.2,TIME=...``, in m, m/s and degrees."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from msgspec import Struct

from uwserver.frames import quat_from_rpy
from uwserver_adapters.moos.codec import angle_of

LONGEST = 4096
"""Characters of a report; they have some hundreds."""
_PAIR = re.compile(r'\s*([A-Za-z_]\w*)\s*=\s*("[^"]*"|\{[^{}]*\}|[^,]*)(?:,|$)')


class NodeReport(Struct, frozen=True):
    """A report.

    Attributes:
        name: of the node; "" where it says none.
        found: its numbers by name, upper case.
    """

    name: str
    found: Mapping[str, float]

    def command(self) -> Mapping[str, object]:
        """Fields of a command to the port `pose`: level, moving ahead at the speed that is told.

        Raises:
            ValueError: it says no place.
        """
        missing = [key for key in ("X", "Y") if key not in self.found]
        if missing:
            raise ValueError(f"the report of {self.name} has no {' and no '.join(missing)}")
        value: dict[str, object] = {"p_NB": [self.found["Y"], self.found["X"], self.found.get("DEP", 0.0)]}
        if "HDG" in self.found:
            value["q_NB"] = list(quat_from_rpy(0.0, 0.0, angle_of(self.found["HDG"])))
        if "SPD" in self.found:
            value["v_NB_B"] = [self.found["SPD"], 0.0, 0.0]
        return value


def read_report(text: str) -> NodeReport:
    """A report from its text; keys that mean nothing here are passed over, and so are numbers that are none.

    Raises:
        ValueError: the text is too long.
    """
    if len(text) > LONGEST:
        raise ValueError(f"a node report of {len(text)} characters: at most {LONGEST} are read")
    name, found = "", dict[str, float]()
    for key, value in _PAIR.findall(text):
        if key.upper() == "NAME":
            name = value.strip()
            continue
        try:
            number = float(value)
        except ValueError:
            continue
        if math.isfinite(number):
            found[key.upper()] = number
    return NodeReport(name, found)

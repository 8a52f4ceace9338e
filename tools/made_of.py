"""What pages of numbers are made of, as hashes: a check runs again only that for which something has changed since `make docs`.

Inputs count and no results, which differ by rounding from machine to machine. Too much of the code is better than too little.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "tools" / "made_of.toml"
SIMULATOR = ROOT / "uwserver"
SHIPPED = ROOT / "scenarios" / "uwserver_scenarios"
PARTS = (
    "actuators", "environment", "physics", "scenario/files", "scenario/load", "scenario/solids", "scenario/vehicle", "scenario/water",
    "scenario/world", "validation", "frames.py", "table.py", "units.py",
)  # fmt: skip
"""Of the simulator: all that makes parameters of files, moves bodies by them and reads figures from that. What loading a file only checks with,
as sensors, is none."""
HEAD = "# Written by `make docs`: what each page of numbers is made of, as a hash (tools/made_of.py).\n"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def code() -> list[Path]:
    """The files of `PARTS`."""
    parts = [SIMULATOR / part for part in PARTS]
    return sorted(path for part in parts for path in ([part] if part.is_file() else part.rglob("*.py")))


def vehicle_files(name: str) -> list[Path]:
    """A shipped vehicle's file, and the devices, vehicles and assets that it and these name."""
    shipped = sorted(
        p for folder in ("assets", "devices", "vehicles") for p in (SHIPPED / folder).rglob("*") if p.is_file()
    )
    found = [SHIPPED / "vehicles" / f"{name}.toml"]
    for path in found:
        text = path.read_text(encoding="utf-8") if path.suffix == ".toml" else ""
        found += [p for p in shipped if p not in found and re.search(rf'["/]{re.escape(p.stem)}(?:{p.suffix})?"', text)]
    return found


def digest(files: Iterable[Path], *texts: str) -> str:
    """Hash of files, with their names, and of texts."""
    said = [
        *(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() for path in files),
        *(text.encode() for text in texts),
    ]
    return hashlib.sha256(b"".join(b"%d\0%b" % (len(each), each) for each in said)).hexdigest()[:16]


def kept() -> dict[str, str]:
    """The hash of each page as `make docs` wrote it."""
    return msgspec.toml.decode(KEPT.read_bytes(), type=dict[str, str]) if KEPT.is_file() else {}


def keep(hashes: Mapping[str, str]) -> None:
    """Write these, and let others be as long as there are their pages."""
    known = {page: value for page, value in {**kept(), **hashes}.items() if (ROOT / page).is_file()}
    KEPT.write_text(HEAD + "".join(f'"{page}" = "{known[page]}"\n' for page in sorted(known)), encoding="utf-8")


def named(path: Path) -> str:
    """A page as people and `kept` name it."""
    return path.relative_to(ROOT).as_posix()


def missing(*paths: Path) -> list[str]:
    """What to say of those that are not there."""
    return [f"{named(path)} is missing" for path in paths if not path.is_file()]


def differences(old: str, new: str) -> list[str]:
    """Lines that say something else, or whose numbers differ by more than 5 % and 1e-8 (an iteration may end one step later)."""
    if len(old.splitlines()) != len(new.splitlines()):
        return ["the document has another number of lines"]
    stale = []
    for before, after in zip(old.splitlines(), new.splitlines(), strict=True):
        plain = [line.replace("< 1e-11", "0") for line in (before, after)]
        a, b = ([float(x) for x in NUMBER.findall(line)] for line in plain)
        same_text = NUMBER.sub("#", plain[0]) == NUMBER.sub("#", plain[1])
        close = len(a) == len(b) and all(
            abs(x - y) <= 0.05 * max(abs(x), abs(y)) + 1e-8 for x, y in zip(a, b, strict=True)
        )
        if not same_text or not close:
            stale.append(f"- {before}\n+ {after}")
    return stale


def outcome(stale: list[str], old: Iterable[str], remedy: str) -> int:
    """Exit status of a check, with a word on what is stale, or else on pages that were run again for an old hash and say the same."""
    again = list(old)
    if stale:
        sys.stderr.write("\n".join(stale) + f"\n{remedy}\n")
    elif again:
        print(
            f"what these pages are made of has changed, and they say the same; `make docs` renews the hashes: {', '.join(again)}"
        )
    return 1 if stale else 0

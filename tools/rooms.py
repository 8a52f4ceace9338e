"""Which tests belong to a file of the checkout: those of its room, to be run after an edit. `python tools/rooms.py FILE...` prints them."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class SourceFolder(NamedTuple):
    """A folder of sources, and the folder that mirrors it.

    Attributes:
        tests: below tests/unit.
        is_room: files that have no room further down belong to all of that folder.
    """

    folder: str
    tests: str
    is_room: bool = True


SOURCES = (
    SourceFolder("uwserver", "", is_room=False),
    SourceFolder("adapters/uwserver_adapters", "adapters", is_room=False),
    SourceFolder("bench/uwserver_bench", "bench"),
    SourceFolder("clients/python", "client"),
    SourceFolder("clients/web", "adapters/web"),
    SourceFolder("scenarios", "scenario"),
)
PROOFS = {"collision": "test_contact*.py", "contact": "test_contact*.py", "geometry": "test_contact*.py", "rays": ""}
"""Those below tests/physics of a room of uwserver/physics; of the others all."""


def tests_of(path: str | Path, root: Path = ROOT) -> tuple[str, ...]:  # noqa: PT028  # no test
    """Tests of a file, the nearest first: its own, then the rest of its room.

    Args:
        path: path of the file, below the checkout.
        root: the checkout.

    Returns:
        Files and folders below the checkout for pytest; none of a file that no test belongs to.
    """
    file = PurePosixPath(Path(path).as_posix())
    if file.parts[:1] == ("tests",):
        found = _of_test(file, root)
    elif file.parts[:1] == ("tools",):
        found = _naming("tools", file.stem, root)
    else:
        found = _of_source(file, root)
    return tuple(dict.fromkeys(found))


def _of_source(file: PurePosixPath, root: Path) -> Iterator[str]:
    for source in SOURCES:
        if file.is_relative_to(source.folder):
            inside = file.relative_to(source.folder)
            yield from _mirrored(source, inside, root)
            if source.folder == "uwserver" and inside.parts[0] == "physics":
                yield from _proofs(inside.parts[1], root)


def _mirrored(source: SourceFolder, inside: PurePosixPath, root: Path) -> Iterator[str]:
    """The test of a source's name, and the nearest folder that mirrors where it stands."""
    base = PurePosixPath("tests/unit") / source.tests
    own = base / inside.parent / f"test_{inside.stem.strip('_')}.py"
    if (root / own).is_file():
        yield str(own)
    for parent in inside.parents:
        is_base = parent == PurePosixPath(".")
        if (root / base / parent).is_dir() and (source.is_room or not is_base):
            yield str(base / parent)
            return


def _proofs(room: str, root: Path) -> Iterator[str]:
    pattern = PROOFS.get(room)
    if pattern is None:
        yield "tests/physics"
    elif pattern:
        yield from (found.relative_to(root).as_posix() for found in sorted((root / "tests/physics").glob(pattern)))


def _of_test(file: PurePosixPath, root: Path) -> Iterator[str]:
    """A test itself; those that name a rig; all beside other files, as a conftest or data."""
    if file.name.startswith("test_"):
        if (root / file).is_file():
            yield str(file)
    elif file.suffix == ".py" and file.name != "conftest.py":
        yield from _naming("", file.stem, root)
    else:
        yield next((str(folder) for folder in file.parents if any((root / folder).glob("test_*.py"))), "tests")


def _naming(folder: str, name: str, root: Path) -> Iterator[str]:
    """Tests that name a module, and the folder where it stands."""
    names = re.compile(rf"""["'/]{name}(?:\.py)?["']|\b(?:from|import) {name}\b""")
    for test in sorted((root / "tests").rglob("test_*.py")):
        text = test.read_text(encoding="utf-8")
        if folder in text and names.search(text):
            yield test.relative_to(root).as_posix()


if __name__ == "__main__":
    print(*dict.fromkeys(test for path in sys.argv[1:] for test in tests_of(path)), sep="\n")

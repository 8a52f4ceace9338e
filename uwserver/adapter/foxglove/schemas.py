"""The schemas of Foxglove as a viewer wants them beside the messages: a serialised FileDescriptorSet each, with all that it imports.

Made of the package foxglove-schemas-protobuf (MIT licence, Foxglove Technologies Inc), and frozen: a test compares them with it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path


@cache
def _read() -> dict[str, bytes]:
    text = (Path(__file__).parent / "schemas.json").read_text(encoding="ascii")
    return {name: base64.b64decode(data) for name, data in json.loads(text).items()}


class _Schemas(Mapping[str, bytes]):
    """Read when somebody asks first."""

    def __getitem__(self, name: str) -> bytes:
        return _read()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_read())

    def __len__(self) -> int:
        return len(_read())


SCHEMAS: Mapping[str, bytes] = _Schemas()
"""By full name, as ``foxglove.FrameTransforms``."""

"""The schemas of Foxglove's messages, as viewers need them: for each message a serialised FileDescriptorSet with all that it imports.

They were made from the package foxglove-schemas-protobuf (MIT licence, Foxglove Technologies Inc). A test compares them with it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path

_TEXT = (Path(__file__).parent / "schemas.json").read_text(encoding="ascii")
SCHEMAS: Mapping[str, bytes] = {name: base64.b64decode(data) for name, data in json.loads(_TEXT).items()}
"""By full name, such as ``foxglove.FrameTransforms``. Reading them takes a quarter of a millisecond."""

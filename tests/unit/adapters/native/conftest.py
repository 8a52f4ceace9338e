"""Fixtures of tests/unit/sockets_rig.py: the native protocol is heard through the adapter that serves it."""

from sockets_rig import (
    _no_token as _no_token,
)
from sockets_rig import (
    _no_turns as _no_turns,
)
from sockets_rig import (
    pack as pack,
)
from sockets_rig import (
    stage as stage,
)
from sockets_rig import (
    unpack as unpack,
)

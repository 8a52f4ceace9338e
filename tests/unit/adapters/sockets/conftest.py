"""Fixtures of tests/unit/sockets_rig.py."""

from sockets_rig import (
    _no_token as _no_token,
)
from sockets_rig import (
    _no_turns as _no_turns,
)
from sockets_rig import (
    certificate as certificate,
)
from sockets_rig import (
    client_certificate as client_certificate,
)
from sockets_rig import (
    pack as pack,
)
from sockets_rig import (
    serving as serving,
)
from sockets_rig import (
    stage as stage,
)
from sockets_rig import (
    trusting as trusting,
)
from sockets_rig import (
    unpack as unpack,
)

"""A zenoh router in a process of its own: ``python -m uwserver_bench.net.router ENDPOINT``. It prints a line when it is ready."""

from __future__ import annotations

import json
import sys
from typing import Any


def main() -> None:
    """Route until stdin ends."""
    import zenoh

    config: Any = zenoh.Config()
    settings: dict[str, object] = {
        "mode": "router",
        "listen/endpoints": [sys.argv[1]],
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
    }
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    session: Any = zenoh.open(config)
    print("ready", flush=True)
    sys.stdin.read()
    session.close()


if __name__ == "__main__":
    main()

"""The autopilot of `uwserver bench sil`, in a process of its own: ``python -m uwserver_bench.autopilots.sil_load``. Its tasks are as of `load`."""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import carry_out

MAGIC, RATE_HZ, CHANNELS = 18458, 1200, 16
PATIENCE_S = 1.0
"""After this wall time without an answer a frame is sent again, as by ArduPilot."""
_clock = SystemTime()
_FRAME = struct.Struct(f"<HHI{CHANNELS}H")


def frames(task: Mapping[str, Any]) -> dict[str, object]:
    """For `seconds`, send a servo frame, wait for its answer, and send the next one, beginning with frame `first`.

    Returns:
        Answered frames per second, how often a frame was sent again, and the number of the next frame.

    Raises:
        ValueError: no answer came.
    """
    host, _, port = task["address"].rpartition(":")
    number, repeated, answered = int(task["first"]), 0, 0
    pwm = [1550, 1450] * 4 + [0] * 8
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", int(task["source"])))
        peer.connect((host, int(port)))
        peer.settimeout(PATIENCE_S)
        start = _clock.now_ns()
        end = start + int(task["seconds"] * 1e9)
        while (now := _clock.now_ns()) < end:
            peer.send(_FRAME.pack(MAGIC, RATE_HZ, number, *pwm))
            try:
                peer.recv(65_000)
            except TimeoutError:
                repeated += 1
                if repeated > 10:
                    raise ValueError("the server does not answer frames") from None
                continue
            number += 1
            answered += 1
        return {
            "per_s": answered / ((now - start) * 1e-9),
            "repeated": repeated,
            "next": number,
            "source": peer.getsockname()[1],
        }


if __name__ == "__main__":
    carry_out({"frames": frames}, "autopilot")

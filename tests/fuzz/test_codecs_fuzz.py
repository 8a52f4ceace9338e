"""Every codec against inputs that are nearly right (`targets`): no exception, nothing lost or told twice, replies under the id of their request.

`UWSERVER_FUZZ_SECONDS` bounds the run of every day; `UWSERVER_FUZZ_INPUTS` is the number of inputs a codec in the slow run: a million in
`make test-all`, ten millions in `make fuzz`.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
from collections.abc import Callable

import pytest
from dice import SECONDS, Dice, for_seconds, seed_of_the_day
from targets import TARGETS
from uwserver_adapters.ardupilot import wire as ardupilot

INPUTS = int(os.environ.get("UWSERVER_FUZZ_INPUTS", "1000000"))
FIRST = 500
"""Inputs that are the same everywhere."""


def take(codec: str, seed: int, go_on: Callable[[int], bool]) -> None:
    """Inputs, as long as asked."""
    count = 0
    with contextlib.closing(TARGETS[codec](Dice(seed))) as target:
        while go_on(count):
            target.once()
            count += 1


def first(count: int) -> bool:
    return count < FIRST


@pytest.mark.parametrize("codec", TARGETS)
def test_a_codec_for_a_while(codec: str) -> None:
    take(codec, 1, first)
    take(codec, seed_of_the_day(), for_seconds(SECONDS))


@pytest.mark.slow
@pytest.mark.parametrize("codec", TARGETS)
def test_a_codec_for_long(codec: str) -> None:
    take(codec, seed_of_the_day(), lambda count: count < INPUTS)


# The targets themselves can fail: a fault in a codec is found within the inputs of every day.

FAULTS: dict[str, tuple[str, object]] = {
    "json": ("uwserver_adapters.native.messages.ID_LIMIT", 2),
    "msgpack": ("uwserver_adapters.native.messages.ID_LIMIT", 0),
    "websocket": ("uwserver_adapters.native.messages.ID_LIMIT", 0),
    "mavlink": ("uwserver_adapters.mavlink.wire.frames._HEAD_2", 11),
    "moos_packets": ("uwserver_adapters.moos.wire.NAMES_LIMIT", 5),
    "moos_lines": ("uwserver_adapters.moos.text.lines._TAG", re.compile(r"#(\d{1,3})\s")),
    "devices": ("uwserver_adapters.devices.water_linked_a50.decode", None),
    "device_messages": (
        "uwserver_adapters.devices.ping360.LIMITS",
        {"gain_setting": (0, 2), "sample_period": (80, 40_000), "number_of_samples": (200, 1200), "num_steps": (1, 10)},
    ),
    "rtsp": ("uwserver_adapters.video.session.LOWEST_PORT", 1),
    "camera": ("uwserver_adapters.video.camera._row", lambda text: [300] * 32),
    "ardupilot": ("uwserver_adapters.ardupilot.wire._FORMS", {ardupilot.MAGIC_16: struct.Struct("<HIH16H")}),
    "px4": ("uwserver_adapters.px4.codec.CONTROLS", 15),
    "zenoh": ("uwserver_adapters.zenoh_bus.requests.decode_caller", None),
    "http": ("uwserver.server.http.is_host_known", lambda host, hosts: True),
    "replies_json": ("uwserver_adapters.native.messages.ID_LIMIT", 2),
}


@pytest.mark.parametrize("codec", FAULTS)
def test_a_fault_in_a_codec_is_found(codec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*FAULTS[codec])
    with pytest.raises((AssertionError, TypeError, struct.error)):
        take(codec, 1, first)

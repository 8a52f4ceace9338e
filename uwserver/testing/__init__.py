"""The public testing kit for authors of adapters, codecs and components.

- `check_adapter` (`uwserver.testing.adapters`): the conformance suite that every adapter of uwserver passes. Run it on your adapter:

      asyncio.run(check_adapter(MyAdapter, MyAdapter.Config(port=0), connect=TcpPeer.connect, greeting=b"subscribe everything"))

  With `requests=Requests(...)`, which says how a peer calls a service, the suite also covers peers that leave in the middle of a call, cancel
  it, wait too long or flood the adapter. It returns the outcome of each check: passed, or why it does not apply.
- `check_codec` (`uwserver.testing.codecs`): compares a codec with a table of bytes, in both directions: whole, byte by byte, truncated and after
  garbage.
- `check_sensor` (`uwserver.testing.sensors`): checks the contract of a sensor from its configuration.
- `check_modifier`, `check_actuator`, `check_current` (`uwserver.testing.components`): do the same for modifiers, actuators and currents.
- `FakeContext` (`uwserver.testing.fake_context`): an `AdapterContext` without a world, with scripted answers.
- `FakeGeometry` (`uwserver.testing.fake_geometry`): planes and spheres in closed form, for ranging sensors.
- `Loopback` (`uwserver.testing.loopback`): a connection in memory for an `asyncio.Protocol`, with a peer that reads only when the test says so.
- `MockTime` (`uwserver.testing.mock_time`): wall time that a test controls.

All checks raise AssertionError with a text that says what the contract requires. None needs pytest.
"""

from uwserver.testing.adapter_kit import Requests, TcpPeer
from uwserver.testing.adapters import check_adapter
from uwserver.testing.codecs import CodecCase, check_codec
from uwserver.testing.components import check_actuator, check_current, check_modifier
from uwserver.testing.fake_context import FakeContext, sample_of
from uwserver.testing.fake_geometry import FakeGeometry
from uwserver.testing.loopback import Loopback
from uwserver.testing.mock_time import MockTime
from uwserver.testing.sensors import check_sensor

__all__ = [
    "CodecCase", "FakeContext", "FakeGeometry", "Loopback", "MockTime", "Requests", "TcpPeer",
    "check_actuator", "check_adapter", "check_codec", "check_current", "check_modifier", "check_sensor", "sample_of",
]  # fmt: skip

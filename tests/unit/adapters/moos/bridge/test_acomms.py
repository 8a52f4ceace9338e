"""A modem by variables: what is written is sent to the address that was written before, and what is heard is told, bytes too."""

from __future__ import annotations

import pytest
from uwserver_adapters.moos.bridge.bridge import ERROR, Bridge
from uwserver_adapters.moos.config import BridgeTable

from uwserver.ports import Buffer, Port, Sample
from uwserver.sensors import AcousticModemConfig, Pose
from uwserver.sensors.modem import Modem
from uwserver.testing import FakeContext
from uwserver.world.modems.send import Send

MODEM = AcousticModemConfig(rate_hz=1).build(Pose())
SEND = Send(MODEM, lambda *message: None, lambda: 0.0)
PORTS = {
    "auv/modem/send": Port("auv/modem/send", "actuator", "acoustic_modem", SEND.fields, SEND.doc),
    "auv/modem/received": Port(
        "auv/modem/received", "sensor", "acoustic_modem", Modem.fields, Modem.doc, 1.0, message="AcousticPacket"
    ),
}


class Bench:
    def __init__(self, ports=PORTS, **table):
        self.context = FakeContext(ports=dict(ports))
        self.posts = []
        self.listened = []
        self.bridge = Bridge(
            BridgeTable(**table), self.context, self.posts.extend, self.listened.extend, "moos", lambda: 0.0
        )

    def write(self, name, value):
        self.bridge.take([(name, value, "pHelm", 10.0)], 0.0)

    @property
    def sent(self):
        return [(c.value[0], c.value[1].data) for c in self.context.commands if c.port == "auv/modem/send"]

    @property
    def faults(self):
        return [value for name, value in self.posts if name == ERROR]


def heard(event, data, source=7, destination=1):
    value = (event, source, destination, Buffer(data=data), 120.0, 30.0, None, None, None, None)
    return Sample("auv/modem/received", 0, 10**9, 10**9, True, value)


async def test_data_go_to_the_address_that_was_written_before():
    bench = Bench(publish=())
    assert {"ACOMMS_TRANSMIT_DEST", "ACOMMS_TRANSMIT_DATA", "ACOMMS_TRANSMIT_DATA_BINARY"} <= set(
        bench.bridge.listens_to
    )
    bench.write("ACOMMS_TRANSMIT_DATA", "to all")
    bench.write("ACOMMS_TRANSMIT_DEST", 3.0)
    bench.write("ACOMMS_TRANSMIT_DATA", "to three")
    bench.write("ACOMMS_TRANSMIT_DATA_BINARY", b"\0\xff")
    bench.write("ACOMMS_TRANSMIT_DEST", -1.0)
    bench.write("ACOMMS_TRANSMIT_DATA", "again")
    assert bench.sent == [(None, b"to all"), ((3.0,), b"to three"), ((3.0,), b"\0\xff"), (None, b"again")]
    assert bench.faults == []


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [("ACOMMS_TRANSMIT_DEST", "three", "an address"), ("ACOMMS_TRANSMIT_DATA", 3.0, "must be a text"),
     ("ACOMMS_TRANSMIT_DATA", "x" * 65, "at most 64 are allowed")],
)  # fmt: skip
async def test_what_cannot_be_sent_is_told(name, value, text):
    bench = Bench(publish=())
    bench.write(name, value)
    assert bench.sent == []
    assert any(text in fault for fault in bench.faults), bench.posts


def test_what_is_heard_is_told_data_last():
    bench = Bench(publish=())
    assert "auv/modem/received" in bench.bridge.subscriptions
    bench.bridge.put_samples([heard("data", b"hello")])
    told = [pair for pair in bench.posts if pair[0].startswith("ACOMMS")]
    assert told == [
        ("ACOMMS_RECEIVED_SOURCE_ID", 7.0),
        ("ACOMMS_RECEIVED_DEST_ID", 1.0),
        ("ACOMMS_RECEIVED_DATA", "hello"),
    ]
    bench.bridge.put_samples([heard("data", b"\0\xff"), heard("failed", b"mine")])
    assert [value for name, value in bench.posts if name == "ACOMMS_RECEIVED_DATA"] == ["hello", '{"base64":"AP8="}']


def test_a_vehicle_without_a_modem_has_none_of_it():
    bench = Bench(ports={"auv/x": Port("auv/x", "sensor", "imu", Modem.fields[:1], "", message="Imu")}, publish=())
    assert not [name for name in bench.bridge.listens_to if name.startswith("ACOMMS")]
    bench.write("ACOMMS_TRANSMIT_DATA", "x")
    assert bench.faults == []

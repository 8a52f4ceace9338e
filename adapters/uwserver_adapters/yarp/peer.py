"""Those who connect to a port: writers, callers of services, administrators, and readers that connect by themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from uwserver.adapter import AdapterContext, Connection, Conversation, Peers
from uwserver.ports import Fault, Refused, Reply
from uwserver_adapters.yarp import codec, port, wire
from uwserver_adapters.yarp.bottle import Value
from uwserver_adapters.yarp.config import YarpConfig
from uwserver_adapters.yarp.port import Reader, Writer, YarpPort
from uwserver_adapters.yarp.wire import Carrier, Hello, YarpMessage

FAREWELL = "Port command not understood."
Answered = Callable[[str], None]
"""Gets the outcome of a connection that was asked for, in YARP's words."""


class Network(Protocol):
    """The adapter, as those who connect to its ports see it."""

    context: AdapterContext
    config: YarpConfig

    def hear(self, at: YarpPort, reader: Reader) -> None:
        """Add a reader to a port."""

    def leave(self, at: YarpPort, end: Reader | Writer) -> None:
        """Remove a reader or writer from a port."""

    def connect(self, at: YarpPort, target: str, answered: Answered) -> None:
        """Make a port send to another one; `answered` gets the outcome."""

    def complain(self, text: str) -> None:
        """Count and log what was not taken of a sender that gets no answer."""


class Peer(Connection):
    """A connection to a port.

    Args:
        network: the adapter.
        at: the port.
        peers: all that are connected.
        source: name of this peer, for the world.

    Attributes:
        name: name of the other port.
        carrier: carrier of the connection.
    """

    def __init__(self, network: Network, at: YarpPort, peers: Peers[Any], source: str) -> None:
        config = network.config
        self._conversation = Conversation(network.context, source)
        super().__init__(
            peers,
            config.hello_timeout_s,
            stats=network.context.stats,
            requests_per_s=config.max_requests_per_s,
            queue_bytes=config.queue_bytes,
            conversation=self._conversation,
        )
        self.name = ""
        self.carrier: Carrier = "text"
        self._network, self._at = network, at
        self._decoder = wire.Decoder()
        self._is_greeted = self._is_reader = self._is_answering = False

    # -- Connection -----------------------------------------------------------------------------------------------------------------------

    def refused(self, fault: Fault) -> bytes:
        """Return the last text for a peer that is refused: a line on text carriers, nothing on others, for which YARP has no form."""
        return f"{fault.text}\r\n".encode() if wire.is_text(self.carrier) else b""

    def receive(self, data: bytes) -> None:
        """Store bytes; readers only send acknowledgements, which are ignored.

        A peer is read also while an answer is owed, as its end would not be noticed otherwise.
        """
        if self._is_reader:
            return
        self._decoder.receive(data)
        if self._is_answering and self._decoder.waiting > wire.MESSAGE_LIMIT:
            self._end(Fault("overload", "too much came before it was answered: wait for the answers"))

    def step(self) -> bool:
        """Take the next message. It waits for the answer to the one before, so that answers keep their order."""
        if self._is_answering or self._is_reader:
            return False
        try:
            event = self._decoder.next_event()
        except Refused as refused:
            self._end(refused.fault)
            return False
        if event is None:
            return False
        if isinstance(event, Hello):
            self._greet(event)
        else:
            self._take(event)
        return True

    @property
    def has_pending_output(self) -> bool:
        """Whether an answer is to come."""
        return self._is_answering

    def closed(self) -> None:
        """Leave the port. Commands of the peer hold until the actuator's time-out."""
        self._network.leave(self._at, self)

    # -- messages -------------------------------------------------------------------------------------------------------------------------

    def _greet(self, hello: Hello) -> None:
        self.name, self.carrier = hello.sender, hello.carrier
        if not self.admit():
            return
        self._is_greeted = True
        self._at.writers[self] = self
        local = self.transport.get_extra_info("sockname")
        self.write(wire.welcome(self.carrier, self.name, local[1] if isinstance(local, tuple) else 0))

    def _take(self, message: YarpMessage) -> None:
        if message.key == "q":
            self.close()
            return
        if not self._rate.take(self.loop.time()):
            text = f"more than {self._rate.most} messages a second: max_requests_per_s"
            self._judge(message, Refused("overload", text).fault)
        elif message.fault is not None:
            self._judge(message, message.fault.fault)
        elif message.key in ("d", "D"):
            self._data(message)
        elif message.key == "a":
            self._administer(message.values)
        elif message.key == "r":
            self._reverse()
        else:
            self._text_command(message)

    def _data(self, message: YarpMessage) -> None:
        at, begun = self._at, message.key == "d"
        self._is_answering = begun

        def answered(reply: Reply) -> None:
            if reply.fault is not None:
                self._judge(message, reply.fault)
            elif begun:
                self._answer(codec.answer(reply.result))

        try:
            if at.role == "actuator":
                assert at.port is not None
                self._conversation.command(at.port.path, codec.command(at.port, message.values), answered)
            elif at.role == "services":
                self._call(message, answered)
            else:
                raise Refused("denied", f"{at.name} is a sensor: it takes nothing")
        except Refused as refused:
            self._judge(message, refused.fault)
        if not begun:
            self.write(wire.acknowledgement(self.carrier))

    def _call(self, message: YarpMessage, answered: Callable[[Reply], None]) -> None:
        values = message.values
        if list(values) == ["help"]:
            if message.key == "d":
                self._answer(codec.usage(self._at.services))
            return
        service, args = codec.call(values, self._at.services)
        self._conversation.call(service.path, args, answered)

    def _judge(self, message: YarpMessage, fault: Fault) -> None:
        """Report a message that was not taken: to the sender if it waits for an answer, else to the server's user."""
        if message.key in ("d", "a"):
            self._stats.errors += 1
            self._answer([codec.FAIL, fault.text])
        else:
            self._network.complain(f"{self._at.name} from {self.name[:80]}: {fault.text}")

    def _answer(self, values: Sequence[Value]) -> None:
        self._reply(wire.payload(wire.is_text(self.carrier), values))

    def _reply(self, body: bytes) -> None:
        self._is_answering = False
        self.send_answer(body + wire.acknowledgement(self.carrier), self.name[:80])
        self.go_on()
        self.finish_if_done()

    # -- administration -------------------------------------------------------------------------------------------------------------------

    def _administer(self, values: Sequence[Value]) -> None:
        words = [str(each) for each in values[:4]] + [""] * 4
        if words[0] == "help":
            self._answer(port.HELP)
        elif words[0] == "ver":
            self._answer(port.VERSION)
        elif words[0] == "list":
            self._answer(self._at.listed(words[1], words[2]))
        elif words[0] == "add":
            target = f"{words[2]}:/{words[1]}" if words[2] else words[1]
            self._connect(target, lambda outcome: self._answer([0 if outcome.startswith("Added") else -1, outcome]))
        elif words[0] == "del":
            ended = self._disconnect(words[1])
            self._answer([0, ended] if ended else [-1, f"Could not find a connection to or from {words[1]}"])
        elif words[0] == "prop" and words[1] == "get":
            self._answer([])
        else:
            self._answer([codec.FAIL, "send [help] for list of valid commands"])

    def _connect(self, target: str, answered: Answered) -> None:
        self._is_answering = True
        self._network.connect(self._at, target, answered)

    def _disconnect(self, name: str) -> str:
        ended = self._at.disconnect(wire_name(name))
        return f"{ended} (of {self._at.name})" if ended else ""

    def _reverse(self) -> None:
        """Make the peer a reader. It has connected itself, though usually the writer connects."""
        self.write(wire.acknowledgement(self.carrier))
        self._at.writers.pop(self, None)
        self._is_reader = True
        self._network.hear(self._at, self)

    def _text_command(self, message: YarpMessage) -> None:
        """Carry out a command that people type into a text connection."""
        line = message.text
        if message.key == "/":
            self._connect(line, self._line)
        elif message.key in ("!", "~"):
            self._line(self._disconnect(line[1:]) or f"Could not find a connection with {line[1:]}")
        elif message.key == "*":
            self._line(f"This is {self._at.name}, {self._at.role} of uwserver; {len(self._at.readers)} hear it")
        elif message.key in ("?", "h"):
            self._line(
                "d: data. D: data without an answer. a: administration. r: read here. /port, !/port: connect, disconnect. q: quit"
            )
        else:
            self._line(FAREWELL + " Type ? for help.")

    def _line(self, text: str) -> None:
        self._reply(f"{text}\r\n".encode() if wire.is_text(self.carrier) else b"")

    def _end(self, fault: Fault) -> None:
        self.peers.refusals.note(fault.code, fault.text)
        self._stats.errors += 1
        self.farewell(self.refused(fault))


def wire_name(name: str) -> str:
    """Return the name of a port without a carrier in front."""
    _, sign, rest = name.partition(":/")
    return ("/" + rest.lstrip("/")) if sign else name

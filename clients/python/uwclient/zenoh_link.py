"""A link over zenoh. It takes frames of the native protocol, turns them into queries by key, and returns frames of the native protocol."""

from __future__ import annotations

import importlib
import json
import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

from uwclient import wire
from uwclient.errors import UwError, install_command
from uwclient.zenoh_frames import Frames, RequestId
from uwclient.zenoh_place import ZenohPlace, session_config

_EVER_S = 1e9
"""Timeout of queries. The caller has its own, and a query may take long."""
_QUEUE = 1 << 16
"""Samples that may wait for a program that does not read. Further ones are lost, as gaps of `seq` show."""
_BATCH = 256
_ROUNDING_NS = 1000
_REPORT_S = 1.0
"""Wall time between two reports of lost samples."""


def _nothing() -> None:
    """Wake nobody, because a blocking client looks by itself."""


def dial_zenoh(place: ZenohPlace, timeout: float, arrived: Callable[[], None] = _nothing) -> ZenohLink:
    """Open a session and wait until the server is seen. `arrived` is that of `ZenohLink`.

    Raises:
        OSError: the server is not seen.
        UwError: a setting is wrong, or eclipse-zenoh is missing.
    """
    try:
        zenoh: Any = importlib.import_module("zenoh")
    except ImportError:
        raise UwError(
            f"zenoh needs the eclipse-zenoh package: {install_command('uwclient[zenoh]')}", code="missing_package"
        ) from None
    frames = Frames(place.encoding)
    config = session_config(zenoh, place)
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise OSError(str(error).split(" at /")[0]) from None
    try:
        link = ZenohLink(zenoh, session, place, frames, arrived)
        link.wait_alive(timeout)
    except BaseException:
        session.close()
        raise
    return link


@dataclass(frozen=True)
class _Arrived:
    """Something that came on a thread of zenoh. `read` makes a frame of it, on the thread of the client."""

    read: Callable[[], bytes]


class _Gone:
    """The token of the server has vanished."""


class _Subscription:
    """A subscription. zenoh delivers every sample; this selects those that were asked for."""

    def __init__(self, params: Mapping[str, object]) -> None:
        rate_hz = params.get("rate_hz")
        self.pattern = str(params["pattern"])
        self.rate_hz = float(rate_hz) if isinstance(rate_hz, (int, float)) else None
        fields = params.get("fields")
        self.fields = [str(name) for name in cast("list[object]", fields)] if isinstance(fields, list) else None
        self.declared: Any = None
        self._slots: dict[str, tuple[int, int]] = {}

    def passes(self, port: str, t_ns: int) -> bool:
        """Tell whether a sample is the first one in its slot of 1 / rate_hz. Slots are counted from the first sample of the port."""
        if self.rate_hz is None:
            return True
        start, last = self._slots.get(port, (t_ns, -1))
        slot = int((t_ns - start + _ROUNDING_NS) * self.rate_hz // 1e9)
        if slot < 0:  # time was set back
            start, last, slot = t_ns, -1, 0
        if slot <= last:
            return False
        self._slots[port] = (start, slot)
        return True


class ZenohLink:
    """A zenoh session with one server. Callbacks on threads of zenoh only queue; everything else is done on the thread of the client.

    Args:
        zenoh: the module.
        session: an open session.
        place: the server.
        frames: frames of the encoding.
        arrived: called on any thread whenever something was queued.
    """

    def __init__(
        self, zenoh: Any, session: Any, place: ZenohPlace, frames: Frames, arrived: Callable[[], None] = _nothing
    ) -> None:
        self._arrived = arrived
        self._zenoh = zenoh
        self._session = session
        self._root = place.root
        self._prefix = place.prefix
        self._frames = frames
        self._client = str(session.zid())
        self._numbers: dict[str, int] = {}
        self._lost = 0
        self._next_report = 0.0
        self._queue: queue.SimpleQueue[_Arrived | _Gone] = queue.SimpleQueue()
        self._subscriptions: dict[int, _Subscription] = {}
        self._subscribed = 0
        self._last: dict[str, bytes] = {}
        self._alive: queue.SimpleQueue[bool] = queue.SimpleQueue()
        session.liveliness().declare_subscriber(f"{self._root}/@alive", self._direct(self._on_alive), history=True)
        self._listen(f"{self._root}/@event", "event")
        self._listen(f"{self._root}/@progress/{self._client}/*", "progress")
        session.declare_subscriber(f"{self._root}/@error/{self._client}/**", self._direct(self._on_error))
        # The token tells the server when this client has gone. It is kept, because a token without a reference is undeclared.
        self._token = session.liveliness().declare_token(f"{self._root}/@client/{self._client}")

    def wait_alive(self, timeout: float) -> None:
        """Wait for the token of the server. Raises OSError, which names the servers that are there."""
        try:
            self._alive.get(timeout=timeout)
        except queue.Empty:
            replies = self._session.liveliness().get(f"{self._prefix}/*/@alive", timeout=1.0)
            names = sorted(str(reply.ok.key_expr).split("/")[-2] for reply in replies if reply.ok is not None)
            there = ", ".join(names) or "none; is its zenoh adapter on, and reachable?"
            raise OSError(f"no such server in the zenoh network, there are: {there}") from None

    # The link

    def send(self, data: bytes, timeout: float | None) -> None:
        """Begin the requests in `data`. Raises OSError."""
        for request in self._frames.requests(data):
            identity = wire.request_id(request)
            params = wire.as_map(request.get("params") or {}, "params")
            method = str(request.get("method"))
            try:
                self._begin(method, params, identity)
            except self._zenoh.ZError as error:
                if self._session.is_closed():
                    raise OSError(str(error)) from None
                self._frame(self._frames.refusal(identity, "bad_argument", str(error).split(" at /")[0], method))

    def receive(self, timeout: float | None) -> bytes | None:
        """Return the next frames; see `Link.receive`."""
        deadline = None if timeout is None else time.monotonic() + timeout
        frames: list[bytes] = []
        while not frames:
            try:
                left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
                first = self._queue.get(timeout=left) if left != 0.0 else self._queue.get_nowait()
            except queue.Empty:
                return None
            if isinstance(first, _Gone):
                return b""
            frames += filter(None, [first.read()])
            for _ in range(min(self._queue.qsize(), _BATCH)):
                arrived = self._queue.get()
                if isinstance(arrived, _Gone):
                    self._queue.put(arrived)
                    break
                frames += filter(None, [arrived.read()])
        return b"".join(frames)

    @property
    def waits(self) -> bool:
        """Whether something waits for `receive`."""
        return not self._queue.empty()

    def close(self) -> None:
        """Close the session, which ends everything declared in it."""
        self._session.close()

    # Requests

    def _begin(self, method: str, params: Mapping[str, object], identity: RequestId | None) -> None:
        if method == "command":
            key, value = f"{self._root}/{params['port']}", params["value"]
            if identity is None:
                self._put(key, value)
            else:
                self._ask(identity, key, value)
        elif method == "call":
            self._ask(identity, f"{self._root}/{params['service']}", params.get("args") or {})
        elif method == "step":
            self._ask(identity, f"{self._root}/world/step", params)
        elif method == "hello":
            value = {"client": self._client, **{k: v for k, v in params.items() if k != "token"}}
            self._ask(identity, f"{self._root}/@hello", value)
        elif method == "describe":
            self._ask(identity, f"{self._root}/@describe?pattern={params.get('pattern', '**')}")
        elif method == "cancel":
            self._ask(identity, f"{self._root}/@cancel", caller=params["id"])
        elif method == "subscribe" and identity is not None:
            self._subscribe(identity, _Subscription(params), params)
        elif method == "unsubscribe" and identity is not None:
            self._unsubscribe(identity, str(params["pattern"]))
        else:
            self._frame(
                self._frames.refusal(identity, "unknown_method", f'"{method}" is not served over zenoh', method)
            )

    def _put(self, key: str, value: object) -> None:
        zenoh = self._zenoh
        self._session.put(
            key,
            self._frames.payload(value),
            encoding=self._frames.media,
            attachment=self._caller(None),
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def _ask(
        self,
        identity: RequestId | None,
        selector: str,
        value: object = None,
        *,
        caller: object = None,
        then: Callable[[object], bytes] | None = None,
    ) -> None:
        """Begin a query. Its one answer becomes a reply to `identity`, which `then` makes if it is given."""
        zenoh = self._zenoh
        answered: list[bool] = []

        def on_reply(reply: Any) -> None:
            answered.append(True)
            self._arrive(_Arrived(lambda: self._reply(identity, reply, then)))

        def on_end() -> None:
            if not answered:
                text = "the server went away, or access is denied"
                frame = self._frames.refusal(identity, "unreachable", f"nobody answers {selector}: {text}")
                self._frame(frame)

        self._session.get(
            selector,
            self._direct(on_reply, on_end),
            timeout=_EVER_S,
            payload=None if value is None else self._frames.payload(value),
            encoding=None if value is None else self._frames.media,
            attachment=self._caller(identity if caller is None else caller),
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def _reply(self, identity: RequestId | None, reply: Any, then: Callable[[object], bytes] | None) -> bytes:
        if identity is None:
            return b""
        if reply.ok is None:
            return self._frames.refused(identity, reply.err.payload.to_bytes(), str(reply.err.encoding))
        value = self._frames.decoded(reply.ok.payload.to_bytes(), str(reply.ok.encoding))
        return self._frames.result(identity, value) if then is None else then(value)

    def _caller(self, identity: object) -> bytes:
        caller: dict[str, object] = {"client": self._client}
        if isinstance(identity, int):
            caller["id"] = identity
        return json.dumps(caller, separators=(",", ":")).encode("ascii")

    # Samples

    def _subscribe(self, identity: RequestId, subscription: _Subscription, params: Mapping[str, object]) -> None:
        pattern = subscription.pattern
        if params.get("pictures", "raw") != "raw":
            text = "over zenoh pictures come as they are: subscribe by a socket for JPEG"
            self._frame(self._frames.refusal(identity, "bad_argument", text, "pictures"))
            return
        if params.get("delivery") == "reliable":
            text = 'over zenoh samples go by "ring" or "latest": what a slow receiver has no room for is dropped'
            self._frame(self._frames.refusal(identity, "bad_argument", text, "delivery"))
            return

        def on_sample(sample: Any) -> None:
            if self._queue.qsize() < _QUEUE:
                self._arrive(_Arrived(lambda: self._sample(subscription, sample)))

        # Declared before the query, so that the server knows the subscriber when it answers.
        subscription.declared = self._session.declare_subscriber(
            f"{self._root}/{pattern}", self._direct(on_sample), allowed_origin=self._zenoh.Locality.REMOTE
        )
        key = f"{self._root}/@describe?pattern={pattern}"
        self._ask(identity, key, then=lambda described: self._subscribed_to(identity, subscription, described))

    def _subscribed_to(self, identity: RequestId, subscription: _Subscription, described: object) -> bytes:
        pattern = subscription.pattern
        ports = [
            wire.as_map(port, "a port")
            for port in wire.as_list(wire.as_map(described, "a description").get("ports"), "ports")
        ]
        paths = [str(port["path"]) for port in ports if port.get("direction") == "sensor"]
        if not paths and "*" not in pattern:
            subscription.declared.undeclare()
            code, text = (
                ("bad_argument", "is an actuator: it gives no samples") if ports else ("unknown_port", "is no port")
            )
            return self._frames.refusal(identity, code, f'"{pattern}" {text}; describe() lists all', pattern)
        self._subscribed += 1
        self._subscriptions[self._subscribed] = subscription
        return self._frames.result(identity, {"subscription": self._subscribed, "ports": paths})

    def _unsubscribe(self, identity: RequestId, pattern: str) -> None:
        ended = [serial for serial, entry in self._subscriptions.items() if entry.pattern == pattern]
        self._numbers.clear()  # samples that come while nobody subscribes are not lost
        for serial in ended:
            self._subscriptions.pop(serial).declared.undeclare()
        self._frame(self._frames.result(identity, {"removed": len(ended)}))

    def _sample(self, subscription: _Subscription, sample: Any) -> bytes:
        if sample.attachment is None:
            return b""  # a command of another client
        payload, attachment, media = sample.payload.to_bytes(), sample.attachment.to_bytes(), str(sample.encoding)
        key = str(sample.key_expr)
        self._follow(key, sample.source_info)
        if len(self._subscriptions) > 1 and self._last.get(key) == attachment:
            return b""  # it has come by another subscription already
        if subscription.rate_hz is not None:
            meta = self._frames.meta(attachment, media)
            if not meta or not subscription.passes(key, wire.integer(meta, "t_ns")):
                return b""
        self._last[key] = attachment
        if subscription.fields is not None:
            return self._frames.selected(payload, attachment, media, subscription.fields)
        return self._frames.sample(payload, attachment, media)

    def _follow(self, key: str, source: Any) -> None:
        """Count the samples that are missing before this one, and report them to the server, which does not learn it from zenoh."""
        if source is None:
            return
        number = source.source_sn
        # A publisher that starts again, or a sample that came by two subscriptions, makes no gap.
        self._lost += max(number - self._numbers.get(key, number) - 1, 0)
        self._numbers[key] = number
        if self._lost and time.monotonic() >= self._next_report:
            self._next_report = time.monotonic() + _REPORT_S
            self._put(f"{self._root}/@lost/{self._client}", {"samples": self._lost})
            self._lost = 0

    # From zenoh's threads

    def _direct(self, callback: Callable[[Any], None], ended: Callable[[], None] | None = None) -> Any:
        """Wrap a callback that only queues, so that zenoh starts no Python thread for it."""
        return self._zenoh.handlers.Callback(callback, ended, indirect=False)

    def _arrive(self, item: _Arrived | _Gone) -> None:
        self._queue.put(item)
        self._arrived()

    def _frame(self, frame: bytes) -> None:
        self._arrive(_Arrived(lambda: frame))

    def _listen(self, key: str, method: str) -> None:
        def on_sample(sample: Any) -> None:
            payload, media = sample.payload.to_bytes(), str(sample.encoding)
            self._arrive(_Arrived(lambda: self._frames.notice(method, payload, media)))

        self._session.declare_subscriber(key, self._direct(on_sample))

    def _on_error(self, sample: Any) -> None:
        """Take in the refusal of a put of this client."""
        payload, media = sample.payload.to_bytes(), str(sample.encoding)
        self._arrive(_Arrived(lambda: self._frames.refused(None, payload, media)))

    def _on_alive(self, sample: Any) -> None:
        if sample.kind == self._zenoh.SampleKind.PUT:
            self._alive.put(True)
        else:
            self._arrive(_Gone())

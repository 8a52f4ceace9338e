"""What all clients of one adapter share, whatever carries their bytes: the token, limits, samples and refusals."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

from uwserver.adapter import AdapterContext, Lockout, Refusals
from uwserver.ports import Fault
from uwserver_adapters.native import verbs
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.fanout import Fanout
from uwserver_adapters.native.messages import Request
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.session import Allowance, Session


class NativeService:
    """Serves the native protocol.

    Args:
        context: the context of the adapter.
        token: the token that clients must show; None if none is needed.
        allowance: limits of one client.
        requests_per_s: requests of one client in a second; more are refused.
        refusals: counts what the adapter refuses.

    Attributes:
        context, token, requests_per_s, refusals: as given.
        fanout: sends samples and events to clients; the adapter's `Subscriber`.
        lockout: hosts that try tokens.
    """

    def __init__(
        self,
        context: AdapterContext,
        token: str | None,
        allowance: Allowance,
        requests_per_s: int,
        refusals: Refusals,
    ) -> None:
        self.context = context
        self.token = token
        self.requests_per_s = requests_per_s
        self.refusals = refusals
        self.fanout = Fanout(context)
        self.lockout = Lockout()
        self._allowance = allowance
        self._serials = itertools.count(1)

    def session(self, codec: Codec, outbox: Outgoing, wake: Callable[[], None]) -> Session:
        """Return the session of a new client.

        Args:
            codec: encodes its answers.
            outbox: where its answers and samples wait.
            wake: called after an answer that comes later than its request.
        """
        return Session(next(self._serials), codec, outbox, self.fanout, wake, self._allowance)

    def take(self, session: Session, request: Request, host: str) -> Fault | None:
        """Carry out a request of a client at a host; return the fault with which its connection must end, if there is one."""
        fault = verbs.take(session, request, self.token)
        if fault is not None:
            self.refusals.note(fault.code, fault.text)
            if fault.code == "denied" and self.lockout.wrong(host, asyncio.get_running_loop().time()):
                self.refusals.note("lockout", self.lockout.fault.text)
        return fault

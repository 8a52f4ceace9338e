"""What all clients of one adapter share, whatever carries their bytes: token, limits, routes of samples, refusals."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from uwserver.adapter import AdapterContext, RateMeter, Refusals
from uwserver.ports import Fault
from uwserver_adapters.native import verbs
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.fanout import Fanout
from uwserver_adapters.native.limits import Lockout
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.requests import Request
from uwserver_adapters.native.session import Allowance, Session


class NativeService:
    """The native protocol, served.

    Args:
        context: the world.
        token: what clients must show; None where none is needed.
        allowance: what one client may hold.
        requests_per_s: of one client; more are refused.
        refusals: where an adapter counts what it refuses besides; default: its own.

    Attributes:
        context, token: as given.
        fanout: routes of samples and events to clients; the adapter's `Subscriber`.
        refusals: counts what was refused.
        lockout: hosts that try tokens.
    """

    def __init__(
        self,
        context: AdapterContext,
        token: str | None,
        allowance: Allowance,
        requests_per_s: int,
        refusals: Refusals | None = None,
    ) -> None:
        self.context = context
        self.token = token
        self.fanout = Fanout(context)
        self.refusals = refusals or Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        self.lockout = Lockout()
        self._allowance = allowance
        self._requests_per_s = requests_per_s
        self._last_serial = 0

    def session(self, codec: Codec, outbox: Outgoing, wake: Callable[[], None]) -> Session:
        """A new client.

        Args:
            codec: what it speaks.
            outbox: where its answers and samples wait.
            wake: said after an answer that came later than its request.
        """
        self._last_serial += 1
        return Session(self._last_serial, codec, outbox, self.fanout, wake, self._allowance)

    def take(self, session: Session, request: Request, host: str) -> Fault | None:
        """Carry out a request of a client at a host; gives the fault with which its connection must end, if there is one."""
        fault = verbs.take(session, request, self.token)
        if fault is not None:
            self.refusals.note(fault.code, fault.text)
            if fault.code == "denied" and self.lockout.wrong(host, asyncio.get_running_loop().time()):
                self.refusals.note("lockout", self.lockout.fault.text)
        return fault

    def rate_meter(self) -> RateMeter:
        """Counts the requests of a new client."""
        return RateMeter(self._requests_per_s)

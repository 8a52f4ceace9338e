"""Carries out the requests that were posted from outside, at the start of a tick. Each request gets one reply."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from itertools import chain

from uwserver.ports import Call, Command, Json, Refused, Reply, Service
from uwserver.ports.checks import check_still
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.world.parts.part import Carry
from uwserver.world.stepping.commands import Commands

log = logging.getLogger(__name__)

CHANGE_NOTHING = frozenset({"world/state_hash", "world/snapshot"})
"""Services that change nothing in the state."""


class Requests:
    """The commands and calls that wait for the next tick.

    Attributes:
        posted: in the order in which they came.
        changes: grows whenever the state may have changed: each time that requests are carried out, with each call of a program in the same
            process, and with each request except calls of `CHANGE_NOTHING`.
    """

    def __init__(
        self,
        commands: Commands,
        carry: Mapping[str, Carry],
        now: Callable[[], tuple[int, int]],
        component: Callable[[str], Service | None],
    ) -> None:
        """Begin without requests.

        Args:
            commands: takes the accepted commands.
            carry: the function of each service; may change.
            now: gives the tick and the simulation time (ns).
            component: returns the service with this path if it belongs to a body. Another body may have replaced it since a call was
                checked.
        """
        self._commands = commands
        self._carry = carry
        self._now = now
        self._component = component
        self.posted: list[Posted] = []
        self.changes = 0

    def carry_out(self, output: TickOutput, more: Iterable[Posted] = ()) -> None:
        """Carry out the posted requests, then more. Replies go to the output. A call may put the world to another tick.

        Args:
            output: output of the tick.
            more: further requests. The next one is taken only when the one before is done, so that the iterator can stop in time.
        """
        posted, self.posted = self.posted, []
        self.changes += 1  # Before this, there was a tick, or a program in the same process may have changed the world.
        for entry in chain(posted, more):
            reply = self._reply_to(entry)
            if reply is not None and entry.on_reply is not None:
                output.replies.append((entry.on_reply, reply))
        self._commands.apply(self._now()[0])

    def _reply_to(self, posted: Posted) -> Reply | None:
        """Carry out a request. Returns its reply; None if nobody waits for one, or if it comes later."""
        item, (tick, t_ns) = posted.item, self._now()
        try:
            if isinstance(item, Command):
                self.changes += 1
                conflict = self._commands.accept(item, tick, posted.fields)
                # Most commands of a program in the same process wait for no reply.
                return None if posted.on_reply is None else Reply(tick, t_ns, conflict=conflict)
            self.changes += item.service not in CHANGE_NOTHING
            # A call may depend on the commands before it.
            self._commands.apply(tick)
            result = self._run(item)
            if isinstance(result, Later):
                result.on_reply = posted.on_reply
                return None
            return Reply(tick, t_ns, result)
        except Refused as refused:
            return Reply(tick, t_ns, fault=refused.fault)

    def _run(self, call: Call) -> Json | Later:
        """Carry out a call.

        Raises:
            Refused: by the service; its body has gone or was replaced by another; or the service failed by a fault of ours.
        """
        if call.service not in self._carry:
            raise Refused("unknown_service", f'"{call.service}" is gone', call.service)
        service = self._component(call.service)
        if service is not None:
            check_still(service, call.args)
        try:
            return self._carry[call.service](call.args)
        except Refused:
            raise
        except Exception as error:  # A fault of one service must not end the simulation.
            log.exception("%s failed in tick %d", call.service, self._now()[0])
            text = f"{call.service} failed because of a fault in the server ({type(error).__name__}): please report it with the server's log"
            raise Refused("internal", text, call.service) from error

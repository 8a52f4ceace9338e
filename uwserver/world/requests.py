"""What was posted from outside, carried out at the start of a tick; each request gets its one reply."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from itertools import chain

from uwserver.ports import Call, Command, Field, OnReply, Refused, Reply, Service
from uwserver.ports.checks import check_still
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.world.commands import Commands
from uwserver.world.part import Carry

log = logging.getLogger(__name__)

LOOKS = frozenset({"world/state_hash", "world/snapshot"})
"""Services that change nothing of the state."""


class Requests:
    """Commands and calls that wait for the next tick.

    Attributes:
        posted: in the order in which they came.
        changes: counts what may have changed the state since the last one: each time that requests are carried out, each call in the
            same process, and each request but those that only look.
    """

    def __init__(
        self,
        commands: Commands,
        carry: Mapping[str, Carry],
        now: Callable[[], tuple[int, int]],
        component: Callable[[str], Service | None],
    ) -> None:
        """Of a world.

        Args:
            commands: where accepted commands go.
            carry: what each service does; may change.
            now: tick and simulation time (ns).
            component: the service of this path where it is one of a body, which another may have replaced since a call was checked.
        """
        self._commands = commands
        self._carry = carry
        self._now = now
        self._component = component
        self.posted: list[Posted] = []
        self.changes = 0

    def carry_out(self, output: TickOutput, more: Iterable[Posted] = ()) -> None:
        """Carry out what was posted, then more; replies go to the output. A call may put the world to another tick.

        Args:
            output: of the tick.
            more: is asked for its next only when the one before is done, so that who gives them can stop in time.
        """
        posted, self.posted = self.posted, []
        self.changes += 1  # before, there was a tick, or somebody in the same process with his hands in the world
        for entry in chain(posted, more):
            item, on_reply = entry.item, entry.on_reply
            if isinstance(item, Call):
                self.changes += item.service not in LOOKS
                # A call may depend on the commands before it.
                self._commands.apply(self._now()[0])
                reply = self._run(item, on_reply)
            else:
                self.changes += 1
                reply = self._accept(item, entry.fields, on_reply)
            if reply is not None and on_reply is not None:
                output.replies.append((on_reply, reply))
        self._commands.apply(self._now()[0])

    def _accept(self, command: Command, fields: tuple[Field, ...], on_reply: OnReply | None) -> Reply | None:
        """The reply, where somebody waits for one: most commands of a program in the same process have nobody."""
        tick, t_ns = self._now()
        try:
            conflict = self._commands.accept(command, tick, fields)
        except Refused as refused:
            return Reply(tick, t_ns, fault=refused.fault)
        return None if on_reply is None else Reply(tick, t_ns, conflict=conflict)

    def _run(self, call: Call, on_reply: OnReply | None) -> Reply | None:
        tick, t_ns = self._now()
        try:
            if call.service not in self._carry:
                raise Refused("unknown_service", f'"{call.service}" is gone', call.service)
            service = self._component(call.service)
            if service is not None:
                check_still(service, call.args)
            result = self._carry[call.service](call.args)
            if isinstance(result, Later):
                result.on_reply = on_reply
                return None
            return Reply(tick, t_ns, result)
        except Refused as refused:
            return Reply(tick, t_ns, fault=refused.fault)
        except Exception as error:  # a fault of one service must not end the simulation
            log.exception("%s failed in tick %d", call.service, tick)
            text = f"{call.service} failed by a fault of the server ({type(error).__name__}): please report it with the server's log"
            return Reply(tick, t_ns, fault=Refused("internal", text, call.service).fault)

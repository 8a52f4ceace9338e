"""A call that is answered later: progress while it goes on, then one reply."""

from __future__ import annotations

from uwserver.ports.values import Fault, Json, OnReply, Progress, Reply

Answers = list[tuple[OnReply, Reply | Progress]]
"""Who is to be told what."""


class Later:
    """What a long-running service gives instead of a result. Who posted the call adds where its answers go to.

    Attributes:
        on_reply: receives them; None for a caller in the same process, who does not wait.
    """

    def __init__(self, answers: Answers) -> None:
        """answers: of the world, which passes them on at the end of the tick."""
        self.on_reply: OnReply | None = None
        self._answers = answers

    def progress(self, fraction: float, t_ns: int) -> None:
        """Tell how far it has come."""
        if self.on_reply is not None:
            self._answers.append((self.on_reply, Progress(fraction, t_ns)))

    def finish(self, tick: int, t_ns: int, result: Json = None, fault: Fault | None = None) -> None:
        """Tell how it ended; nothing may follow."""
        if self.on_reply is not None:
            self._answers.append((self.on_reply, Reply(tick, t_ns, result, fault)))

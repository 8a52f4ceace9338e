"""Reading and changing parameters of a node while the world runs. A request for several is answered when all are known. Loop thread."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from uwserver.adapter import Conversation, did_you_mean
from uwserver.ports import Reply
from uwserver_adapters.ros.messages import Ask, BadMessage, Setting

AT_ONCE = 512
"""Most parameters of one request."""
Values = Callable[[list[object | None]], None]
"""Gets the values in the order of their names, with None for each that does not exist."""
Reasons = Callable[[list[str]], None]
"""Gets the reason why each was not changed; "" for those that were."""


class Parameters:
    """The parameters as one peer reads and changes them.

    Args:
        conversation: conversation of the peer.
        settings: returns the parameters that exist now, by name.
    """

    def __init__(self, conversation: Conversation, settings: Callable[[], Mapping[str, Setting]]) -> None:
        self._conversation, self._settings = conversation, settings

    def get(self, names: Sequence[str], answered: Values) -> None:
        """Read some parameters."""
        known = self._settings()
        chosen = [known.get(name) for name in names[:AT_ONCE]]
        sources = list(dict.fromkeys(setting.source for setting in chosen if setting is not None))

        def came(replies: Sequence[Reply]) -> None:
            found = {source: reply.result for source, reply in zip(sources, replies, strict=True)}
            answered([None if setting is None else setting.told(found[setting.source]) for setting in chosen])

        self._conversation.call_all([(source, {}) for source in sources], came)

    def set(self, wanted: Sequence[tuple[str, object]], answered: Reasons) -> None:
        """Change some parameters, one after the other and independently of each other."""
        known, lost = self._settings(), 0
        asked: list[Ask | str] = []
        for name, value in wanted[:AT_ONCE]:
            try:
                asked.append(_asked(known, name, value, suggests=not lost))
            except BadMessage as bad:
                lost += name not in known
                asked.append(str(bad))
        asked += [f"a request changes at most {AT_ONCE} parameters"] * len(wanted[AT_ONCE:])

        def came(replies: Sequence[Reply]) -> None:
            reasons = map(_why, replies)
            answered([one if isinstance(one, str) else next(reasons) for one in asked])

        self._conversation.call_all([(one.service, one.args) for one in asked if isinstance(one, Ask)], came)

    def set_together(self, wanted: Sequence[tuple[str, object]], answered: Callable[[str], None]) -> None:
        """Change all or none. They must belong to one component, so that the world takes them in one call."""
        try:
            known = self._settings()
            asked = [_asked(known, name, value) for name, value in wanted[:AT_ONCE]]
        except BadMessage as bad:
            answered(str(bad))
            return
        if len(asked) > 1 and (len({one.service for one in asked}) > 1 or not asked[0].service.endswith("/set")):
            answered(
                "only parameters of one sensor or actuator, without active, can be changed at once: set them one by one"
            )
            return
        args = {key: value for one in asked for key, value in one.args.items()}
        together = [(one.service, args) for one in asked[:1]]
        self._conversation.call_all(together, lambda replies: answered("".join(map(_why, replies))))


def _asked(known: Mapping[str, Setting], name: str, value: object, *, suggests: bool = True) -> Ask:
    """Return the call that changes a parameter. A similar name is suggested only if `suggests`, as the search takes half a millisecond.

    Raises:
        BadMessage: there is no such parameter, or it does not take the value.
    """
    setting = known.get(name)
    if setting is None:
        raise BadMessage(f'no parameter "{name[:100]}"{did_you_mean(name[:200], known) if suggests else ""}')
    return setting.change(setting.checked(value))


def _why(reply: Reply) -> str:
    return "" if reply.fault is None else reply.fault.text or reply.fault.code


def listed(names: Sequence[str], prefixes: Sequence[str], depth: int) -> tuple[list[str], list[str]]:
    """Return names and their prefixes as rcl_interfaces/ListParameters defines them; a depth of 0 means any depth."""

    def is_wanted(name: str) -> bool:
        if not prefixes:
            return not depth or name.count(".") < depth
        return any(
            name == prefix
            or (name.startswith(f"{prefix}.") and (not depth or name[len(prefix) + 1 :].count(".") < depth))
            for prefix in prefixes
        )

    chosen = sorted(filter(is_wanted, names))
    return chosen, sorted({name.rpartition(".")[0] for name in chosen if "." in name})

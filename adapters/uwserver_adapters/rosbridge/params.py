"""Parameters as the services of rosapi tell them: values are JSON, names may stand after that of the node."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uwserver.adapter import Undecodable, decode
from uwserver_adapters.ros.messages.types import BadMessage
from uwserver_adapters.ros.parameters import Parameters
from uwserver_adapters.rosbridge.codec import json_text

Args = Mapping[str, Any]
Answer = Callable[[dict[str, Any]], None]


def parameter_name(args: Args, node: str) -> str:
    """The parameter that it is about: ``rov.imu.rate_hz``, ``/uwserver:rov.imu.rate_hz`` or ``/rov/imu/rate_hz``."""
    name = str(args.get("name", ""))
    before, colon, after = name.partition(":")
    if colon and before.strip("/") == node.strip("/"):
        name = after
    return name.strip("/").replace("/", ".")


def get_param(parameters: Parameters, name: str, args: Args, answer: Answer) -> None:
    """The value as JSON; where there is none the default that was given, or null."""
    default = args.get("default_value") or args.get("default") or "null"

    def came(values: list[object | None]) -> None:
        if values[0] is None:
            reason = f'no parameter "{name[:100]}"; /rosapi/get_param_names lists them'
            answer({"value": str(default), "successful": False, "reason": reason})
        else:
            answer({"value": json_text(values[0]).decode(), "successful": True, "reason": ""})

    parameters.get([name], came)


def set_param(parameters: Parameters, name: str, args: Args, answer: Answer) -> None:
    """Change it to a value, given as JSON."""
    given = args.get("value")
    try:
        value = decode(given.encode(), "json") if isinstance(given, str) else given
    except (Undecodable, UnicodeEncodeError):
        raise BadMessage('value must be JSON in a text, as "50.0"') from None
    parameters.set([(name, value)], lambda reasons: answer({"successful": not reasons[0], "reason": reasons[0]}))

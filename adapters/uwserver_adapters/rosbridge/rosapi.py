"""The services of rosapi, by which clients ask which topics, services, actions, types and parameters there are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uwserver.adapter import Undecodable, decode
from uwserver_adapters.ros.messages.types import ARRAY, BASE, FILLER, NAME, BadMessage, Types, full_name
from uwserver_adapters.ros.parameters import Parameters
from uwserver_adapters.rosbridge.codec import json_text
from uwserver_adapters.rosbridge.hub import Hub

NODE = "/uwserver"
Args = Mapping[str, Any]
Values = dict[str, Any]
Answer = Callable[[Values], None]


class Rosapi:
    """Answers calls of rosapi.

    Args:
        hub: what all clients share.

    Attributes:
        services: name below ``/rosapi/`` -> what answers it at once.
    """

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self.services: Mapping[str, Callable[[Args], Values]] = {
            "topics": self._topics, "topics_and_raw_types": self._raw_topics, "topic_type": self._topic_type,
            "topics_for_type": self._topics_for_type, "services": self._services, "service_type": self._service_type,
            "services_for_type": self._services_for_type, "service_providers": self._services_for_type,
            "service_node": lambda args: {"node": NODE if _name(args, "service") in self._all_services() else ""},
            "service_host": lambda args: {"host": ""},
            "nodes": lambda args: {"nodes": [NODE]}, "node_details": self._node_details,
            "publishers": self._publishers, "subscribers": self._subscribers,
            "message_details": lambda args: self._details(args, "message", "msg", ""),
            "service_request_details": lambda args: self._details(args, "service", "srv", "_Request"),
            "service_response_details": lambda args: self._details(args, "service", "srv", "_Response"),
            "get_time": self._get_time, "get_ros_version": self._version,
            "has_param": lambda args: {"exists": parameter_name(args) in hub.feed.catalogue.settings},
            "get_param_names": lambda args: {"names": [f"{NODE}:{name}" for name in sorted(hub.feed.catalogue.settings)]},
            "delete_param": lambda args: {"successful": False, "reason": "parameters of the simulator cannot be deleted"},
            "search_param": lambda args: {"global_name": ""},
            "action_servers": lambda args: {"action_servers": sorted({*hub.feed.catalogue.actions, *hub.acting})},
            "action_type": self._action_type,
            "action_goal_details": lambda args: self._details(args, "action", "action", "_Goal"),
            "action_result_details": lambda args: self._details(args, "action", "action", "_Result"),
            "action_feedback_details": lambda args: self._details(args, "action", "action", "_Feedback"),
            "interfaces": lambda args: {"interfaces": sorted(set(hub.topics().values()))},
        }  # fmt: skip
        self._later = {"get_param": get_param, "set_param": set_param}

    def ask(self, short: str, parameters: Parameters, args: Args, answered: Answer) -> bool:
        """Answer a call, now or later; return whether there is such a service.

        Args:
            short: name below ``/rosapi/``.
            parameters: those of the client.
            args: args of the call.
            answered: gets the answer.

        Raises:
            BadMessage: the arguments are wrong.
        """
        now, later = self.services.get(short), self._later.get(short)
        if now is not None:
            answered(now(args))
        elif later is not None:
            later(parameters, parameter_name(args), args, answered)
        return now is not None or later is not None

    @property
    def names(self) -> list[str]:
        """Full names of all services."""
        return [f"/rosapi/{short}" for short in (*self.services, *self._later)]

    # -- topics -----------------------------------------------------------------------------------------------------------------------------

    def _word(self, type_name: str) -> str:
        """Return a type in the spelling of this version of ROS."""
        return type_name.replace("/msg/", "/").replace("/srv/", "/") if self._hub.types.is_ros1 else type_name

    def _topics(self, args: Args) -> Values:
        found = sorted(self._hub.topics().items())
        return {"topics": [topic for topic, _ in found], "types": [self._word(kind) for _, kind in found]}

    def _raw_topics(self, args: Args) -> Values:
        types, kinds = self._hub.types, [kind for _, kind in sorted(self._hub.topics().items())]
        texts = [types.text(kind) if kind in types else "" for kind in kinds]
        return {**self._topics(args), "typedefs_full_text": texts}

    def _topic_type(self, args: Args) -> Values:
        return {"type": self._word(self._hub.topics().get(_name(args, "topic"), ""))}

    def _topics_for_type(self, args: Args) -> Values:
        kind = full_name(str(args.get("type", "")))
        return {"topics": [topic for topic, found in sorted(self._hub.topics().items()) if found == kind]}

    def _publishers(self, args: Args) -> Values:
        topic = _name(args, "topic")
        clients = self._hub.advertised.get(topic, ("", set()))[1]
        own = [NODE] if topic in self._hub.feed.topics else []
        return {"publishers": own + sorted(client.name for client in clients)}

    def _subscribers(self, args: Args) -> Values:
        topic = _name(args, "topic")
        own = [NODE] if topic in self._hub.feed.catalogue.command_topics else []
        return {"subscribers": own + sorted(self._hub.listeners(topic))}

    # -- services and actions ---------------------------------------------------------------------------------------------------------------

    def _all_services(self) -> dict[str, str]:
        own = {name: offer.type for name, offer in self._hub.feed.catalogue.offers.items()}
        theirs = {name: kind for name, (kind, _) in self._hub.served.items()}
        return {**theirs, **own, **{name: _rosapi_type(name) for name in self.names}}

    def _services(self, args: Args) -> Values:
        return {"services": sorted(self._all_services())}

    def _service_type(self, args: Args) -> Values:
        return {"type": self._word(self._all_services().get(_name(args, "service"), ""))}

    def _services_for_type(self, args: Args) -> Values:
        kind = full_name(str(args.get("type", args.get("service", ""))), "srv")
        found = [name for name, its in sorted(self._all_services().items()) if its == kind]
        return {"services": found, "providers": [NODE] if found else []}

    def _action_type(self, args: Args) -> Values:
        name = _name(args, "action")
        action = self._hub.feed.catalogue.actions.get(name)
        return {"type": self._hub.acting.get(name, ("",))[0] if action is None else action.type}

    # -- types and the node -----------------------------------------------------------------------------------------------------------------

    def _details(self, args: Args, what: str, kind: str, part: str) -> Values:
        """Describe a type.

        Args:
            args: with the name of the type.
            what: a message, service or action, for errors.
            kind: second part of the type's name.
            part: appended to the name: the part of a service or action that is described.

        Raises:
            BadMessage: there is no such type.
        """
        name = full_name(str(args.get("type", "")), kind)
        if name + part not in self._hub.types:
            raise BadMessage(f'no {what} type "{name[:100]}" is known here')
        return {"typedefs": type_definitions(self._hub.types, name + part)}

    def _node_details(self, args: Args) -> Values:
        if str(args.get("node", "")).strip("/") != NODE.strip("/"):
            return {"subscribing": [], "publishing": [], "services": []}
        catalogue = self._hub.feed.catalogue
        return {
            "subscribing": sorted(catalogue.command_topics),
            "publishing": sorted(self._hub.feed.topics),
            "services": sorted(catalogue.offers),
        }

    def _get_time(self, args: Args) -> Values:
        sec, nanosec = divmod(self._hub.feed.now_ns(), 1_000_000_000)
        # roslibpy reads the names of ROS 1 for both versions.
        return {"time": {"sec": sec, "nanosec": nanosec, "secs": sec, "nsecs": nanosec}}

    def _version(self, args: Args) -> Values:
        types = self._hub.types
        return {"version": 1 if types.is_ros1 else 2, "distro": types.distro}


def _name(args: Args, key: str) -> str:
    return "/" + str(args.get(key, "")).strip("/")


def _rosapi_type(service: str) -> str:
    short = service.removeprefix("/rosapi/")
    return "rosapi_msgs/srv/" + "".join(map(str.capitalize, short.split("_")))


def type_definitions(types: Types, name: str) -> list[Values]:
    """Return a type and all its nested types as rosapi describes them: names, types and lengths of fields.

    A length of -1 means a single value, 0 any number of values.
    """
    told: dict[str, Values] = {}

    def add(kind: str) -> None:
        if kind in told:
            return
        entry: Values = {
            "type": kind, "fieldnames": [], "fieldtypes": [], "fieldarraylen": [], "examples": [], "constnames": [], "constvalues": [],
        }  # fmt: skip
        told[kind] = entry
        for field, (form, what) in types.fields(kind):
            if field == FILLER:
                continue
            length = -1
            if form not in (BASE, NAME):
                length = what[1] if form == ARRAY else 0
                form, what = what[0]
            entry["fieldnames"].append(field)
            entry["fieldtypes"].append(what if form == NAME else what[0])
            entry["fieldarraylen"].append(length)
            entry["examples"].append("{}" if form == NAME else ("[]" if length >= 0 else ""))
            if form == NAME:
                add(what)

    add(name)
    return list(told.values())


# -- parameters ---------------------------------------------------------------------------------------------------------------------------


def parameter_name(args: Args) -> str:
    """Return the parameter that a call names: ``rov.imu.rate_hz``, ``/uwserver:rov.imu.rate_hz`` or ``/rov/imu/rate_hz``."""
    name = str(args.get("name", ""))
    before, colon, after = name.partition(":")
    if colon and before.strip("/") == NODE.strip("/"):
        name = after
    return name.strip("/").replace("/", ".")


def get_param(parameters: Parameters, name: str, args: Args, answer: Answer) -> None:
    """Answer with the value of a parameter as JSON; for an unknown one with the given default, or null."""
    default = args.get("default_value") or args.get("default") or "null"

    def came(values: list[object | None]) -> None:
        if values[0] is None:
            reason = f'no parameter "{name[:100]}"; /rosapi/get_param_names lists them'
            answer({"value": str(default), "successful": False, "reason": reason})
        else:
            answer({"value": json_text(values[0]).decode(), "successful": True, "reason": ""})

    parameters.get([name], came)


def set_param(parameters: Parameters, name: str, args: Args, answer: Answer) -> None:
    """Change a parameter to a value that is given as JSON.

    Raises:
        BadMessage: it is no JSON.
    """
    given = args.get("value")
    try:
        value = decode(given.encode(), "json") if isinstance(given, str) else given
    except (Undecodable, UnicodeEncodeError):
        raise BadMessage('value must be JSON in a text, as "50.0"') from None
    parameters.set([(name, value)], lambda reasons: answer({"successful": not reasons[0], "reason": reasons[0]}))

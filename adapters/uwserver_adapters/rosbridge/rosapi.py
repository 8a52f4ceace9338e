"""The services of rosapi, which clients ask for what there is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uwserver_adapters.ros.messages.types import ARRAY, BASE, FILLER, NAME, BadMessage, Types, full_name
from uwserver_adapters.ros.parameters import Parameters
from uwserver_adapters.rosbridge.hub import Hub
from uwserver_adapters.rosbridge.params import get_param, parameter_name, set_param

NODE = "/uwserver"
Args = Mapping[str, Any]
Values = dict[str, Any]


class Rosapi:
    """Answers.

    Args:
        hub: what there is.
        time: simulation time since its epoch, ns.

    Attributes:
        services: name below ``/rosapi/`` -> what answers it at once.
    """

    def __init__(self, hub: Hub, time: Callable[[], int]) -> None:
        self._hub, self._time = hub, time
        self.services: Mapping[str, Callable[[Args], Values]] = {
            "topics": self._topics, "topics_and_raw_types": self._raw_topics, "topic_type": self._topic_type,
            "topics_for_type": self._topics_for_type, "services": self._services, "service_type": self._service_type,
            "services_for_type": self._services_for_type, "service_providers": self._services_for_type,
            "service_node": lambda args: {"node": NODE if _name(args, "service") in self._all_services() else ""},
            "service_host": lambda args: {"host": ""},
            "nodes": lambda args: {"nodes": [NODE]}, "node_details": self._node_details,
            "publishers": self._publishers, "subscribers": self._subscribers, "message_details": self._message_details,
            "service_request_details": lambda args: self._service_details(args, "Request"),
            "service_response_details": lambda args: self._service_details(args, "Response"),
            "get_time": self._get_time, "get_ros_version": self._version,
            "has_param": lambda args: {"exists": parameter_name(args, NODE) in hub.feed.catalogue.settings},
            "get_param_names": lambda args: {"names": [f"{NODE}:{name}" for name in sorted(hub.feed.catalogue.settings)]},
            "delete_param": lambda args: {"successful": False, "reason": "parameters of the simulator cannot be deleted"},
            "search_param": lambda args: {"global_name": ""},
            "action_servers": lambda args: {"action_servers": sorted({*hub.feed.catalogue.actions, *hub.acting})},
            "action_type": self._action_type,
            "action_goal_details": lambda args: self._action_details(args, "Goal"),
            "action_result_details": lambda args: self._action_details(args, "Result"),
            "action_feedback_details": lambda args: self._action_details(args, "Feedback"), "interfaces": self._interfaces,
        }  # fmt: skip
        self._later = {"get_param": get_param, "set_param": set_param}

    def ask(self, short: str, parameters: Parameters, args: Args, answered: Callable[[Values], None]) -> bool:
        """Answer a call, now or later; whether there is such a service.

        Args:
            short: name below ``/rosapi/``.
            parameters: of who asks.
            args: of the call.
            answered: gets the answer.

        Raises:
            BadMessage: the arguments are wrong.
        """
        now, later = self.services.get(short), self._later.get(short)
        if now is not None:
            answered(now(args))
        elif later is not None:
            later(parameters, parameter_name(args, NODE), args, answered)
        return now is not None or later is not None

    @property
    def names(self) -> list[str]:
        """All services, with ``/rosapi/`` before."""
        return [f"/rosapi/{short}" for short in (*self.services, *self._later)]

    def type_of(self, service: str) -> str:
        """The type of a service of rosapi, "" where there is none."""
        short = service.removeprefix("/rosapi/")
        return (
            "rosapi_msgs/srv/" + "".join(map(str.capitalize, short.split("_")))
            if f"/rosapi/{short}" in self.names
            else ""
        )

    # -- topics -----------------------------------------------------------------------------------------------------------------------------

    def _word(self, type_name: str) -> str:
        """A type as clients of this version write it."""
        return type_name.replace("/msg/", "/").replace("/srv/", "/") if self._hub.types.is_ros1 else type_name

    def _topics(self, args: Args) -> Values:
        found = sorted(self._hub.topics().items())
        return {"topics": [topic for topic, _ in found], "types": [self._word(kind) for _, kind in found]}

    def _raw_topics(self, args: Args) -> Values:
        types = self._hub.types
        topics = self._topics(args)
        kinds = [kind for _, kind in sorted(self._hub.topics().items())]
        return {**topics, "typedefs_full_text": [types.text(kind) if kind in types else "" for kind in kinds]}

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
        own = [NODE] if topic in self._hub.feed.catalogue.inlets else []
        return {"subscribers": own + sorted(self._hub.listeners(topic))}

    # -- services ---------------------------------------------------------------------------------------------------------------------------

    def _all_services(self) -> dict[str, str]:
        own = {name: offer.type for name, offer in self._hub.feed.catalogue.offers.items()}
        theirs = {name: kind for name, (kind, _) in self._hub.served.items()}
        return {**theirs, **own, **{name: self.type_of(name) for name in self.names}}

    def _services(self, args: Args) -> Values:
        return {"services": sorted(self._all_services())}

    def _service_type(self, args: Args) -> Values:
        return {"type": self._word(self._all_services().get(_name(args, "service"), ""))}

    def _services_for_type(self, args: Args) -> Values:
        kind = full_name(str(args.get("type", args.get("service", ""))), "srv")
        found = [name for name, its in sorted(self._all_services().items()) if its == kind]
        return {"services": found, "providers": [NODE] if found else []}

    def _service_details(self, args: Args, part: str) -> Values:
        kind = full_name(str(args.get("type", "")), "srv")
        if not self._hub.types.has_service(kind):
            raise BadMessage(f'no service type "{kind[:100]}" is known here')
        return {"typedefs": type_definitions(self._hub.types, f"{kind}_{part}")}

    # -- actions ----------------------------------------------------------------------------------------------------------------------------

    def _action_type(self, args: Args) -> Values:
        name = _name(args, "action")
        action = self._hub.feed.catalogue.actions.get(name)
        return {"type": self._hub.acting.get(name, ("",))[0] if action is None else action.type}

    def _action_details(self, args: Args, part: str) -> Values:
        kind = f"{full_name(str(args.get('type', '')), 'action')}_{part}"
        if kind not in self._hub.types:
            raise BadMessage(f'no action type "{kind.rpartition("_")[0][:100]}" is known here')
        return {"typedefs": type_definitions(self._hub.types, kind)}

    # -- the rest ---------------------------------------------------------------------------------------------------------------------------

    def _node_details(self, args: Args) -> Values:
        if str(args.get("node", "")).strip("/") != NODE.strip("/"):
            return {"subscribing": [], "publishing": [], "services": []}
        catalogue = self._hub.feed.catalogue
        return {
            "subscribing": sorted(catalogue.inlets),
            "publishing": sorted(self._hub.feed.topics),
            "services": sorted(catalogue.offers),
        }

    def _message_details(self, args: Args) -> Values:
        kind = full_name(str(args.get("type", "")))
        if kind not in self._hub.types:
            raise BadMessage(f'no message type "{kind[:100]}" is known here')
        return {"typedefs": type_definitions(self._hub.types, kind)}

    def _interfaces(self, args: Args) -> Values:
        return {"interfaces": sorted(set(self._hub.topics().values()))}

    def _get_time(self, args: Args) -> Values:
        sec, nanosec = divmod(self._time(), 1_000_000_000)
        # roslibpy reads the names of ROS 1, whichever version it talks to.
        return {"time": {"sec": sec, "nanosec": nanosec, "secs": sec, "nsecs": nanosec}}

    def _version(self, args: Args) -> Values:
        types = self._hub.types
        return {"version": 1 if types.is_ros1 else 2, "distro": types.distro}


def _name(args: Args, key: str) -> str:
    return "/" + str(args.get(key, "")).strip("/")


def type_definitions(types: Types, name: str) -> list[Values]:
    """A type and all that it holds, as rosapi tells them: names, types and lengths of fields (-1: one, 0: any number)."""
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

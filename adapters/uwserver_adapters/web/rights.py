"""What pages may do: a context that wants a lease before a vehicle is steered, and lets pages that may only watch read."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

import msgspec
from msgspec import structs

from uwserver.adapter import AdapterContext, Driver, Subscriber, WorldFacts, did_you_mean
from uwserver.ports import (
    Argument,
    EntityList,
    Json,
    OnReply,
    Port,
    Progress,
    Refused,
    Reply,
    Sample,
    SceneState,
    SceneView,
    Service,
    is_stop,
    matches,
)
from uwserver_adapters.web.lease import Leases

_VEHICLE = Argument("vehicle", "str", "name of the vehicle")
_FORCE = Argument("force", "bool", "take it from the page that has it", required=False, default=False)
_ANY = Argument("vehicle", "str", "name of the vehicle; default: all", required=False, default="")
TAKE = Service(
    "web/lease/take",
    "Steer a vehicle from this page until it is given back, or not renewed for 2 s.",
    (_VEHICLE, _FORCE),
)
KEEP = Service("web/lease/keep", "Renew what the page steers; returns these vehicles.", reads_only=True)
GIVE = Service("web/lease/give", "Stop steering a vehicle.", (_ANY,))
STOP = Service("web/stop", "Disarm, put all actuators to neutral, and end the lease; works without a lease.", (_ANY,))
_UNKNOWN = Reply(0, 0)
SERVICES = {service.path: service for service in (TAKE, KEEP, GIVE, STOP)}


class Rights:
    """The context for all pages. A page is identified by the serial number at the beginning of its source.

    Args:
        context: the adapter's context.
        read_only: no page may change anything.

    Attributes:
        name, stats: the adapter's.
        leases: which page steers which vehicle.
        watching: serial numbers of pages that may only watch.
    """

    def __init__(self, context: AdapterContext, read_only: bool) -> None:
        self.name, self.stats = context.name, context.stats
        self.watching: set[int] = set()
        self._context = context
        self._read_only = read_only
        self.leases = Leases(asyncio.get_running_loop().time, self._lost)
        self._commanded: dict[int, set[str]] = {}

    # -- commands and calls ----------------------------------------------------------------------------------------------------------

    def command(
        self, port: str, value: Mapping[str, object], source: str, on_reply: OnReply | None, queue: str = ""
    ) -> None:
        """See `uwserver.adapter.AdapterContext.command`. Refuses with `denied` a page without the lease."""
        page = self._writing(source)
        if port in self._context.ports:
            self.leases.check(page, port.partition("/")[0])
            self._commanded.setdefault(page, set()).add(port)
        self._context.command(port, value, source, on_reply, queue)

    def call(
        self,
        service: str,
        args: Mapping[str, object],
        source: str,
        on_reply: OnReply,
        client: str = "",
        queue: str = "",
    ) -> Callable[[], bool]:
        """See `uwserver.adapter.AdapterContext.call`. Refuses with `denied` a page that may only watch, or needs the lease."""
        if service in SERVICES:
            result = self._own(service, args, source)
            self._context.call("world/status", {}, source, lambda now: on_reply(structs.replace(now, result=result)))
            return _cannot_cancel
        known = self._context.services.get(service)
        if known is not None and not known.reads_only and not _asks(service):
            page = self._writing(source)
            vehicle = service.partition("/")[0]
            if not is_stop(service) and any(vehicle == each.name for each in self._context.world.vehicles):
                self.leases.check(page, vehicle)
        return self._context.call(service, args, source, on_reply, "", queue)

    def _writing(self, source: str) -> int:
        page = int(source.partition(" ")[0])
        if self._read_only or page in self.watching:
            raise Refused("denied", "this page may only watch", "read_only")
        return page

    def _own(self, service: str, args: Mapping[str, object], source: str) -> Json:
        known = {argument.name for argument in SERVICES[service].arguments}
        for name in args:
            if name not in known:
                hint = did_you_mean(name, known)
                raise Refused("bad_argument", f'{service} has no argument "{name[:100]}"{hint}', name[:100])
        page = self._writing(source)
        if service == KEEP.path:
            return list[Json](self.leases.keep(page))
        vehicle = self._vehicle(args.get("vehicle", ""), service == TAKE.path)
        if service == TAKE.path:
            force = args.get("force", False)
            if not isinstance(force, bool):
                raise Refused("bad_argument", '"force" must be true or false', "force")
            owner = source.partition(" ")[2].strip("()") or f"page {page}"
            self.leases.take(page, owner, vehicle, force)
            return None
        if service == GIVE.path:
            return list[Json](self.leases.give(page, vehicle or None))
        stopped = [vehicle] if vehicle else [each.name for each in self._context.world.vehicles]
        for each in stopped:
            self.stop(each)
        return list[Json](stopped)

    def _vehicle(self, name: object, needed: bool) -> str:
        there = [vehicle.name for vehicle in self._context.world.vehicles]
        if not isinstance(name, str) or (name not in there and (name or needed)):
            hint = did_you_mean(str(name)[:100], there)
            raise Refused(
                "bad_argument", f'no vehicle "{str(name)[:100]}"{hint}; there are: {", ".join(there)}', "vehicle"
            )
        return name

    # -- all stop -------------------------------------------------------------------------------------------------------------------

    def stop(self, vehicle: str) -> None:
        """Disarm a vehicle, put its actuators to neutral, and end its lease."""
        lease = self.leases.owner(vehicle)
        queue = "" if lease is None else str(lease.page)
        if lease is not None:
            # The commands are forgotten here, so that each actuator is put to neutral only once, below.
            self._commanded_of(lease.page, vehicle)
        self.leases.end(vehicle)
        services = self._context.services
        for path in [path for path in services if path.startswith(f"{vehicle}/") and path.endswith("/disarm")]:
            self._ask(path, queue)
        for path, port in self._context.ports.items():
            if port.direction == "actuator" and path.startswith(f"{vehicle}/"):
                self._neutral(path, queue)

    def leave(self, page: int) -> None:
        """Forget a page that has gone."""
        self.leases.give(page)
        self._commanded.pop(page, None)
        self.watching.discard(page)

    def _lost(self, vehicle: str, page: int) -> None:
        """Stop what a page last commanded of a vehicle that it no longer steers. An autopilot continues to where it was sent."""
        for port in self._commanded_of(page, vehicle):
            self._neutral(port, str(page))

    def _commanded_of(self, page: int, vehicle: str) -> list[str]:
        """Return the ports of a vehicle that a page has commanded, and forget them."""
        commanded = self._commanded.get(page, set())
        mine = sorted(port for port in commanded if port.startswith(f"{vehicle}/"))
        commanded.difference_update(mine)
        return mine

    def _neutral(self, port: str, queue: str) -> None:
        """Put an actuator to neutral. One that was deactivated stays so: there is a reason for it, and it is neutral already."""

        def on_state(answer: Reply | Progress) -> None:
            now = answer.result if isinstance(answer, Reply) else None
            if isinstance(now, dict) and now.get("active") is False:
                return
            for verb in ("deactivate", "activate"):  # deactivating puts it to neutral
                self._ask(f"{port}/{verb}", queue)

        # This has a queue of its own, so it waits for nothing that the pilot has asked before, and no stop overtakes it.
        if not self._ask(f"{port}/get", "all stop", on_state):
            on_state(_UNKNOWN)

    def _ask(self, service: str, queue: str, on_reply: OnReply | None = None) -> bool:
        """Call a service without arguments. Returns whether it was called."""
        if service not in self._context.services:
            return False
        try:
            self._context.call(service, {}, f"{queue or 'stop'} (all stop)", on_reply or _ignore, "", queue)
        except Refused:
            self.stats.errors += 1
            return False
        return True

    # -- descriptions ----------------------------------------------------------------------------------------------------------------

    @property
    def services(self) -> Mapping[str, Service]:
        """Services of the world and of pages."""
        return {**self._context.services, **SERVICES}

    def describe(self, pattern: str = "**") -> dict[str, Json]:
        """Describe the world, and the services of pages."""
        described = self._context.describe(pattern)
        own = [msgspec.to_builtins(service) for path, service in SERVICES.items() if matches(pattern, path)]
        there = described["services"]
        assert isinstance(there, list)
        return {**described, "services": [*there, *own]}

    # -- unchanged: each member is forwarded by hand, so that pages never get a new one unchecked --------------------------------------

    @property
    def world(self) -> WorldFacts:
        return self._context.world

    @property
    def ports(self) -> Mapping[str, Port]:
        return self._context.ports

    def hello(self) -> dict[str, Json]:
        return self._context.hello()

    def last(self, port: str) -> Sample | None:
        return self._context.last(port)

    def read(self, ports: Sequence[str], on_samples: Callable[[Sequence[Sample]], None], source: str = "") -> None:
        self._context.read(ports, on_samples, source)

    def request_scene_state(self, on_state: Callable[[SceneState], None], source: str = "") -> None:
        self._context.request_scene_state(on_state, source)

    def scene(self, entities: EntityList) -> SceneView:
        return self._context.scene(entities)

    def mesh(self, sha256: str) -> bytes | None:
        return self._context.mesh(sha256)

    def model_file(self, sha256: str) -> bytes | None:
        return self._context.model_file(sha256)

    def attach(self, subscriber: Subscriber) -> Callable[[], None]:
        return self._context.attach(subscriber)

    def subscriptions_changed(self) -> None:
        self._context.subscriptions_changed()

    def tell_conflict(self, text: str) -> None:
        self._context.tell_conflict(text)

    def join(self, client: str) -> Callable[[], None]:
        """Do nothing: a page takes part in no lockstep barrier, because a closed laptop would stop the world."""
        return _left

    def drive(self, client: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """Refuse: a page steps no world."""
        raise Refused("denied", "a page cannot step the world", client)


def _left() -> None:
    """Do nothing: the page has not joined."""


def _cannot_cancel() -> bool:
    return False


def _ignore(answer: Reply | Progress) -> None:
    """Ignore an answer."""


def _asks(service: str) -> bool:
    """Return whether a service only reads: the state of a part, or gains and mission of an autopilot."""
    name = service.rpartition("/")[2]
    return name == "get" or name.startswith("get_")

"""All open pages. Each state is requested and encoded once for all of them; a page that cannot take it now gets a later one."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import PurePath
from typing import Protocol

from uwserver.adapter import AdapterContext, Decimations
from uwserver.ports import Event, Json, Progress, Refused, Reply, Sample, SceneState
from uwserver_adapters.native.fanout import Fanout
from uwserver_adapters.web.lease import Leases
from uwserver_adapters.web.pictures import HIDDEN, PAUSED, Pictures, Viewer, state_frame

STATUS_S = 0.5
"""Wall time between two status messages, and between two states while nothing changes."""


class Page(Viewer, Protocol):
    """An open page.

    Attributes:
        serial: serial number of its session.
        wants_frames: whether it draws states.
    """

    serial: int
    wants_frames: bool

    def send_status(self, status: dict[str, Json]) -> None:
        """Send the status."""


class Pages:
    """The adapter's `Subscriber`. Also sends states and status while there are pages.

    Args:
        context: the adapter's context.
        fanout: routes samples to subscribers.
        leases: which page steers which vehicle.
        frames_hz: most states per second of wall time.
        shows_poses: whether pages may know where bodies are.

    Attributes:
        all: the open pages.
        pictures: sends pictures and sonar data to pages.
    """

    def __init__(
        self, context: AdapterContext, fanout: Fanout, leases: Leases, frames_hz: float, shows_poses: bool
    ) -> None:
        self.all: dict[Page, None] = {}
        self.pictures = Pictures(context)
        self._context = context
        self._fanout = fanout
        self._leases = leases
        self._period_s = 1.0 / frames_hz
        self._shows_poses = shows_poses
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        self._timer: asyncio.TimerHandle | None = None
        self._status_timer: asyncio.TimerHandle | None = None
        self._is_requested = False
        self._paused = False
        self._last: tuple[int, int, int] | None = None
        self._sent = 0.0

    # -- pages ----------------------------------------------------------------------------------------------------------------------

    def enter(self, page: Page) -> None:
        """Add a page."""
        self.all[page] = None
        if self._status_timer is None:
            self._tell_status()

    def leave(self, page: Page) -> None:
        """Remove a page."""
        self.all.pop(page, None)
        self.pictures.leave(page)
        self._context.subscriptions_changed()
        self.follow()
        if not self.all and self._status_timer is not None:
            self._status_timer.cancel()
            self._status_timer = None

    def follow(self) -> None:
        """Start or stop sending states, after pages have changed what they want."""
        wanted = any(page.wants_frames for page in self.all)
        if wanted and self._timer is None:
            self._last = None
            self._turn()
        elif not wanted and self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def close(self) -> None:
        """Send nothing more."""
        for timer in (self._timer, self._status_timer):
            if timer is not None:
                timer.cancel()
        self.all.clear()
        self._timer = self._status_timer = None

    # -- states ---------------------------------------------------------------------------------------------------------------------

    def _turn(self) -> None:
        self._timer = self._loop.call_later(self._period_s, self._turn)
        if self._is_requested or not any(page.wants_frames and page.is_clear for page in self.all):
            return  # a state is still on its way, or no page could take it
        try:
            self._context.request_scene_state(self._show, "pages")
        except Refused:
            return
        self._is_requested = True

    def _show(self, state: SceneState) -> None:
        self._is_requested = False
        flags = (PAUSED if self._paused else 0) | (0 if self._shows_poses else HIDDEN)
        now, sign = self._loop.time(), (state.t_ns, state.entities.revision, flags)
        if sign == self._last and now - self._sent < STATUS_S:
            return
        takers = [page for page in self.all if page.wants_frames and page.is_clear]
        if takers:
            self._last, self._sent = sign, now
            frame = state_frame(state, flags)
            for page in takers:
                page.send_frame(frame)

    # -- status ---------------------------------------------------------------------------------------------------------------------

    def _tell_status(self) -> None:
        self._status_timer = self._loop.call_later(STATUS_S, self._tell_status)
        self._leases.expire()
        self._context.call("world/status", {}, "pages", self._told)

    def _told(self, answer: Reply | Progress) -> None:
        if not isinstance(answer, Reply) or not isinstance(answer.result, dict):
            return
        now = answer.result
        self._paused = bool(now.get("paused"))
        lateness = now.get("lateness")
        status: dict[str, Json] = {
            "t_ns": answer.t_ns,
            "t": now.get("t_s"),
            "wall": round(self._loop.time() - self._began, 3),
            "speed": now.get("speed"),
            "real_time_factor": now.get("real_time_factor"),
            "lateness_p99": lateness.get("p99_s") if isinstance(lateness, dict) else None,
            "mode": now.get("mode"),
            "paused": self._paused,
            "held": now.get("held"),
            **_recording(now.get("recorder")),
            "failure": now.get("failure"),
            "playback": now.get("playback"),
            "pages": len(self.all),
            "lease": self._owners(),
        }
        for page in list(self.all):
            if page.is_clear:
                page.send_status(status)

    def _owners(self) -> dict[str, Json]:
        owners: dict[str, Json] = {}
        for vehicle in self._context.world.vehicles:
            lease = self._leases.owner(vehicle.name)
            owners[vehicle.name] = None if lease is None else {"page": lease.page, "owner": lease.owner}
        return owners

    # -- samples and events ---------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> frozenset[str]:
        """Ports that pages subscribe to, or whose pictures they show."""
        return frozenset(self._fanout.subscriptions) | self.pictures.subscriptions

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send samples to subscribed pages, and pictures to the pages that show them."""
        # Pictures come first, because a page with samples in its queue gets no picture.
        self.pictures.put_samples(samples)
        self._fanout.put_samples(samples)

    @property
    def decimations(self) -> Decimations:
        """Ports of which no page needs all samples. All pictures are needed, because each may be the one that is shown."""
        seen = self.pictures.subscriptions
        return {path: enough for path, enough in self._fanout.decimations.items() if path not in seen}

    def send_samples(self) -> None:
        """Write the samples of the last ticks, once for each page."""
        self._fanout.send_samples()

    def put_event(self, event: Event) -> None:
        """Tell every page of an event."""
        if event.event in ("reset", "ports_changed"):
            self._last = None
            self.pictures.forget()
        self._fanout.put_event(event)


def _recording(recorder: Json) -> dict[str, Json]:
    """Return what pages are told of the recording in progress, or of the last one."""
    if not isinstance(recorder, dict):
        return {"recording": False, "recorder": None}
    path = str(recorder.get("path", ""))
    told: dict[str, Json] = {
        "name": PurePath(path).name,
        "path": path,
        "bytes": recorder.get("bytes"),
        "since_ns": recorder.get("since_ns"),
        "error": recorder.get("error"),
    }
    return {"recording": recorder.get("recording") is True, "recorder": told}

"""The `devices` adapter: opens each device of its table, and hands it the samples of its sensors."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Collection, Sequence
from typing import cast

from uwserver.adapter import AdapterContext, CannotServe, Refusals, serving
from uwserver.ports import Event, Json, Sample
from uwserver_adapters.devices.config import DevicesConfig
from uwserver_adapters.devices.station import Station

ATTEND_S = 0.5
"""Wall time between looks for serial lines, and counts of peers."""


class DevicesAdapter:
    """Serves sensors as devices of the market."""

    Config = DevicesConfig

    def __init__(self, config: DevicesConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self._refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        self._stations: list[Station] = []
        self._readers: dict[str, list[Station]] = {}

    @property
    def wanted(self) -> Collection[str]:
        """Ports whose samples the devices read."""
        return self._readers.keys()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: an address cannot be had.
            CannotServe: a table names what is not there.
        """
        self._build()
        async with contextlib.AsyncExitStack() as stack:
            told: dict[str, Json] = {}
            for name, station in zip(self.config.device, self._stations, strict=True):
                await station.open(stack)
                told[name] = cast(Json, station.addresses)
            self.context.stats.details["devices"] = told
            with serving(self.context, self, self._address(), ready):
                while True:
                    for station in self._stations:
                        station.attend()
                    self.context.stats.peers = sum(station.count for station in self._stations)
                    await asyncio.sleep(ATTEND_S)

    def _build(self) -> None:
        self._stations.clear()
        self._readers.clear()
        for name, table in self.config.device.items():
            try:
                device = table.build(self.context)
            except CannotServe as error:
                raise CannotServe(f"device.{name}.{error}") from None
            station = Station(name, table, device, self.context, self._refusals)
            self._stations.append(station)
            for path in device.wanted:
                self._readers.setdefault(path, []).append(station)

    def _address(self) -> str:
        """All there are: of which device each is, and its way, where there are several."""
        all_of = [
            (f"{name} {way} {text}", text)
            for name, station in zip(self.config.device, self._stations, strict=True)
            for way, text in station.addresses.items()
        ]
        return ", ".join(told for told, _ in all_of) if len(all_of) > 1 else all_of[0][1]

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Each sample to the devices that read it."""
        for sample in samples:
            for station in self._readers.get(sample.port, ()):
                for message in station.device.see(sample):
                    station.report(message)

    def put_event(self, event: Event) -> None:
        """After a reset the devices begin anew."""
        if event.event == "reset":
            for station in self._stations:
                station.device.reset()

"""Instruments: sensors with errors, settings and timing of their own, because the physics of their errors needs what no value still shows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from msgspec import Struct, structs

from uwserver.modifiers.base import Measurement
from uwserver.ports import Argument, Field, Json, Refused, Value
from uwserver.sensors.base import Scope


class Settings(Struct, frozen=True):
    """What can be changed of an instrument while it runs. SI; the names of its fields are the service's arguments."""


class Instrument(ABC):
    """A sensor whose next reading depends on the world, its `settings`, its `memory` and its random stream, and on nothing else.

    These three are saved with the world. Subclasses set `fields`, `doc` and `arguments`.

    Attributes:
        settings: changed by `change` alone.
        arguments: of the service ``set``, beside `rate_hz`: one for each setting, with its limits.
        memory: plain numbers that it keeps from reading to reading.
        rng: random numbers of its own path.
        dt: time between readings, s.
        paces: its memory holds no error, but what decides when and how it reads next; an ideal twin follows it.
        listens: it waits for something that comes between two readings, as told by `wake`.
    """

    fields: tuple[Field, ...]
    doc: str
    needs_rates = False
    paces = False
    arguments: tuple[Argument, ...] = ()
    dt = 1.0
    listens = False

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.start(np.random.default_rng(0))

    def start(self, rng: np.random.Generator) -> None:
        """Switch it on: take the random stream, and draw from it what is constant in a run."""
        self.rng = rng
        self.memory: list[float] = self.turn_on()

    def turn_on(self) -> list[float]:
        """The memory at the start of a run."""
        return []

    def load_kernels(self) -> None:  # noqa: B027 - most have none
        """Load what is compiled for the readings now, so that no tick waits for it."""

    @abstractmethod
    def sense(self, scope: Scope) -> Measurement | None:
        """The next reading, with the delay of sound and processing; None when the instrument is not ready for one."""

    @property
    def wake(self) -> float | None:
        """When (s) it has to be asked, whatever its rate: at the first tick that is not earlier; None while it waits for nothing."""
        return None

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """As a plain sensor: no timing; missing values while it is not ready."""
        reading = self.sense(scope)
        return (False, blank(self.fields)) if reading is None else (reading.valid, reading.values)

    def properties(self) -> dict[str, Json]:
        """The settings, by name."""
        return structs.asdict(self.settings)

    def change(self, args: Mapping[str, Json]) -> None:
        """Change settings; all or none.

        Raises:
            Refused: the settings do not go together.
        """
        settings = structs.replace(self.settings, **args)
        self.check(settings)
        self.settings = settings

    def check(self, settings: Settings) -> None:  # noqa: B027 - most have nothing to check
        """Raise Refused where single limits do not say it all."""


def blank(fields: tuple[Field, ...]) -> list[Value]:
    """Values of a reading that found nothing."""
    return [(None,) * field.size if field.shape else None for field in fields]


def out_of_range(name: str, text: str) -> Refused:
    """The refusal of a setting."""
    return Refused("out_of_range", text, name)

"""A ballast tank or an oil bladder by its volume. Pump rate and force run in the kernel."""

from __future__ import annotations

from uwserver.actuators.servo import Moved, OneServo


class BallastConfig(OneServo, tag="ballast", kw_only=True, frozen=True):
    """One ballast of the vehicle file; its command is the volume, which its pump reaches at its own rate. The watchdog pumps back to neutral."""

    moved = Moved("ballasts", "ballast", "volume_m3", "m^3", "oil in the bladder, or water in the tank")

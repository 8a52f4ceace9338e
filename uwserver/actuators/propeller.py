"""A propeller by its shaft speed. Rate, lag, thrust and torque run in the kernel."""

from __future__ import annotations

from uwserver.actuators.servo import Moved, OneServo


class PropellerConfig(OneServo, tag="propeller", kw_only=True, frozen=True):
    """One shaft propeller of the vehicle file; its command is the speed of the shaft, which it reaches at its own rate."""

    moved = Moved("propellers", "propeller", "speed_radps", "rad/s", "speed of the shaft, positive ahead")

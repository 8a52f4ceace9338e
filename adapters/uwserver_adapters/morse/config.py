"""The table of the adapter `morse` in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from uwserver.adapter import UNANSWERED, OpenTable
from uwserver.table import Count, Name, PortNumber, Table
from uwserver_adapters.sil.in_the_loop import OutputTable

FIRST_STREAM = 60000
"""TCP port of the first stream, as MORSE has it."""

_PulseWidth = Annotated[int, Meta(ge=1, le=65535)]


class AutopilotTable(Table, kw_only=True, frozen=True):
    """ArduPilot's MORSE backend: ``--model morse-pwm:127.0.0.1:60900:60901``.

    Attributes:
        vehicle: vehicle of the sensors and actuators; default: the only one there is.
        sensors_port, control_port: TCP ports; 0 takes a free one.
        imu: port with `f_S` and `w_S` of a sensor that is mounted along the vehicle's axes.
        pose: port with `p_NB` and `q_NB`.
        velocity: port with `v_NB_B`.
        outputs: actuators that servo channels move; default: the vehicle's `thrusters`, by channels 1 to n.
        low_us, neutral_us, high_us: pulse widths of full reverse, neutral and full forward, us.
    """

    vehicle: Name | None = None
    sensors_port: PortNumber = 60900
    control_port: PortNumber = 60901
    imu: Name = "imu"
    pose: Name = "truth/pose"
    velocity: Name = "truth/velocity"
    outputs: dict[Name, OutputTable] = field(default_factory=dict)
    low_us: _PulseWidth = 1100
    neutral_us: _PulseWidth = 1500
    high_us: _PulseWidth = 1900


class MorseConfig(OpenTable, tag="morse", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port for requests; 0 takes a free one.
    stream_port: TCP port of the first stream. Each component has a stream of its own, and clients ask for its number. A port that is in use is
        passed over; 0 takes free ones.
    names: names of components for each vehicle: name -> port below the vehicle, as `vw = "autopilot/velocity"`; others keep their usual names.
    ardupilot: serve ArduPilot's MORSE backend too.
    queue_bytes: bytes that may wait for a slow client. Above that a stream drops samples, and a client that does not read its answers is
        disconnected.
    max_requests_per_s: requests of one client in a second; more are refused.
    max_unanswered: calls of one client that may wait for the world.
    max_clients: connections for requests and to all streams; a client of pymorse has one for each component that it uses.
    """

    port: PortNumber = 4000
    stream_port: PortNumber = FIRST_STREAM
    names: dict[Name, dict[Name, Name]] = field(default_factory=dict)
    ardupilot: AutopilotTable | None = None
    queue_bytes: Count = 1 << 20
    max_requests_per_s: Count = 2000
    max_unanswered: Count = UNANSWERED
    max_clients: Count = 1024

    @property
    def component_of(self) -> dict[str, str]:
        """Path of a port -> name of its component, for those in `names`."""
        return {
            f"{vehicle}/{port}": f"{vehicle}.{name}"
            for vehicle, named in self.names.items()
            for name, port in named.items()
        }

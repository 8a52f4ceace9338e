"""The tables of the adapters `moos`, `moosdb` and `moos_text` in a scenario."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from uwserver.adapter import AdapterTable
from uwserver.table import Name, NonNegative, Positive, Table
from uwserver_adapters.moos.wire import PACKET_LIMIT

Count = Annotated[int, Meta(ge=1)]
PortNumber = Annotated[int, Meta(ge=0, le=65535)]


class Target(Table, kw_only=True, frozen=True):
    """What a variable does to one field of an actuator: the contributions of all variables to it are added, then limited to its range.

    Attributes:
        port: actuator, below the vehicle (`rudder`), or its whole path.
        field: its field.
        full: what 100 adds, each component of a vector (`[0, 0, 1, -1]`).
        full_deg: the same in degrees, for fields in radians.
        zero: value at 0, each component; a ballast's neutral volume, say.
        limit: the variable is limited to +- this; default 100, as it is a percentage.
    """

    port: Name
    field: Name
    full: float | tuple[float, ...] | None = None
    full_deg: float | tuple[float, ...] | None = None
    zero: float | tuple[float, ...] = 0.0
    limit: Positive = 100.0


class NavTable(Table, kw_only=True, frozen=True):
    """The conventional set (NAV_X, NAV_Y, NAV_DEPTH ...). Ports are below the vehicle; by default the truth, which needs `truth = true`.

    Attributes:
        prefix: NAV, as missions have it, or USM.
        position: port with a position in N (`p_NB`, `p_NS`); "" for none.
        attitude: port with `q_NB`, `q_NS`; "" for none.
        velocity: port with a velocity in B (`v_NB_B`, `v_S`); "" for none.
        flow: port with the velocity of the water (`v_NW_B`) or through the water (`v_water_S`), for NAV_SPEED; default: `truth/flow` where
            `velocity` is of the truth too; without one NAV_SPEED is the surge over ground.
        depth: port with `depth`; default: from the position.
        altitude: port with `range` or `altitude`; default: from `water_depth_m`.
        water_depth_m: depth of the bottom, until a WATER_DEPTH comes.
        rate_hz: at most so often, simulation time; default: as often as the position (or attitude) comes.
        ground_truth: publish NAV_GT_* from the truth besides, as uSimMarine does with `dual_state`.
        origin_deg: latitude and longitude of the origin of N, the mission's LatOrigin and LongOrigin; without it no NAV_LAT, NAV_LONG.
    """

    prefix: Name = "NAV"
    position: str = "truth/pose"
    attitude: str = "truth/pose"
    velocity: str = "truth/velocity"
    flow: Name | None = None
    depth: Name | None = None
    altitude: Name | None = None
    water_depth_m: Positive | None = None
    rate_hz: Positive | None = None
    ground_truth: bool = False
    origin_deg: tuple[float, float] | None = None


class PidTable(Table, kw_only=True, frozen=True):
    """An autopilot within the adapter, from DESIRED_HEADING, DESIRED_SPEED and DESIRED_DEPTH to DESIRED_RUDDER, DESIRED_THRUST and
    DESIRED_ELEVATOR, for missions whose simulator has the PID block itself. The keys are those of pMarinePIDV22.

    Attributes:
        speed_factor: thrust (%) for each m/s; 0 for the loop of `speed_pid_*`.
        yaw_pid_kp, yaw_pid_ki, yaw_pid_kd, yaw_pid_integral_limit: rudder (degrees, or %) from the error of the heading, degrees.
        speed_pid_kp, speed_pid_ki, speed_pid_kd, speed_pid_integral_limit: change of the thrust (%) from the error of the speed, m/s.
        z_to_pitch_pid_kp, z_to_pitch_pid_ki, z_to_pitch_pid_kd, z_to_pitch_pid_integral_limit: pitch (rad) from the error of the depth, m.
        pitch_pid_kp, pitch_pid_ki, pitch_pid_kd, pitch_pid_integral_limit: elevator (rad, given out in degrees) from the error of the pitch, rad.
        maxrudder, maxthrust, maxelevator: limits of the outputs.
        maxpitch: limit of the pitch, degrees.
        depth_control: DESIRED_ELEVATOR is given out too.
        tardy_helm_threshold, tardy_nav_threshold: age (s, simulation time) above which a DESIRED_ or a NAV_ value stops the vehicle.
    """

    speed_factor: NonNegative = 0.0
    yaw_pid_kp: float = 0.5
    yaw_pid_ki: float = 0.0
    yaw_pid_kd: float = 0.0
    yaw_pid_integral_limit: NonNegative = 0.0
    speed_pid_kp: float = 1.0
    speed_pid_ki: float = 0.0
    speed_pid_kd: float = 0.0
    speed_pid_integral_limit: NonNegative = 0.0
    z_to_pitch_pid_kp: float = 0.12
    z_to_pitch_pid_ki: float = 0.004
    z_to_pitch_pid_kd: float = 0.0
    z_to_pitch_pid_integral_limit: NonNegative = 0.05
    pitch_pid_kp: float = 1.5
    pitch_pid_ki: float = 0.0
    pitch_pid_kd: float = 1.0
    pitch_pid_integral_limit: NonNegative = 0.0
    maxrudder: Positive = 100.0
    maxthrust: Positive = 100.0
    maxpitch: Positive = 15.0
    maxelevator: Positive = 13.0
    depth_control: bool = True
    tardy_helm_threshold: Positive = 2.0
    tardy_nav_threshold: Positive = 2.0


class BridgeTable(Table, kw_only=True, frozen=True):
    """Which variables stand for what of the world.

    Attributes:
        vehicle: to which `nav`, `commands`, and USM_RESET belong; default: the only one there is.
        publish: patterns of ports that become variables; [] for none.
        vectors: a variable for each component, or one with a JSON list.
        on_change: publish a variable only when its value has changed.
        rate_hz: publish a port at most so often, simulation time; default: each sample.
        nav: publish the conventional set.
        commands: what DESIRED_THRUST and its like do, by variable.
        pid: an autopilot within the adapter, for missions without pMarinePID.
        hold_depth_m: a depth that is held with DESIRED_ELEVATOR (of `commands`) while somebody drives and nobody writes DESIRED_ELEVATOR: a
            mission in the plane has no depth, and a vehicle with fins would dive or rise for ever.
        externals: external vehicles of the world by name, and what they follow: a name in NODE_REPORT and NODE_REPORT_LOCAL, or ``NAV_*`` for
            variables NAV_X, NAV_Y, NAV_DEPTH, NAV_HEADING and NAV_SPEED.
        usm: listen to USM_RESET, USM_SIM_PAUSED, DRIFT_X and the like, as uSimMarine does.
        services: carry out calls that come as the variable UWSERVER_CALL.
        alog: file (.alog) for all that goes through; an earlier one of this name is kept under a number.
    """

    vehicle: Name | None = None
    publish: tuple[Name, ...] = ("**",)
    vectors: Literal["components", "json"] = "components"
    on_change: bool = False
    rate_hz: Positive | None = None
    nav: NavTable | None = None
    commands: dict[Name, tuple[Target, ...]] = field(default_factory=dict)
    pid: PidTable | None = None
    hold_depth_m: NonNegative | None = None
    externals: dict[Name, Name] = field(default_factory=dict)
    usm: bool = True
    services: bool = True
    alog: Name | None = None


class CommunityTable(BridgeTable, kw_only=True, frozen=True):
    """A MOOSDB to join, with all that `bridge` of the other two adapters has.

    Attributes:
        host, port: where it listens.
        client: our name there.
    """

    host: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=1, le=65535)] = 9000
    client: Name = "uwserver"


class MoosConfig(AdapterTable, tag="moos", kw_only=True, frozen=True):
    """Attributes:
    communities: databases to join, one connection each; default: one at 127.0.0.1:9000.
    warp: MOOSTimeWarp of the missions; default: the speed of this server, which must be the same.
    timeout_s: wall time without a word of the database after which the connection is made anew.
    """

    communities: dict[Name, CommunityTable] = field(default_factory=lambda: {"main": CommunityTable()})
    warp: Positive | None = None
    timeout_s: Positive = 5.0


class MoosDbConfig(AdapterTable, tag="moosdb", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at; MOOS knows no password, so anything but loopback is open to all who reach it.
    port: TCP port; 0 takes a free one.
    community: its name, told to all clients.
    bridge: which variables stand for what of the world.
    warp: MOOSTimeWarp of the missions; default: the speed of this server.
    client_timeout_s: wall time without a word of a client after which it is disconnected.
    max_clients: that have said their name, at once.
    max_variables: kept; more are refused.
    queue_bytes: that wait for a client which does not read, before it is disconnected.
    packet_bytes: longest packet of a client.
    """

    bind: Name = "127.0.0.1"
    port: PortNumber = 9000
    community: Name = "#1"
    bridge: BridgeTable = BridgeTable()
    warp: Positive | None = None
    client_timeout_s: Positive = 5.0
    max_clients: Count = 128
    max_variables: Count = 20_000
    queue_bytes: Count = 16 << 20
    packet_bytes: Annotated[int, Meta(ge=1, le=PACKET_LIMIT)] = PACKET_LIMIT


class MoosTextConfig(AdapterTable, tag="moos_text", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at; there is no password, so anything but loopback is open to all who reach it.
    port: TCP port; 0 takes a free one.
    serial: a serial line or pseudo-terminal to speak on too, such as "/dev/ttyS1".
    bridge: which variables stand for what of the world.
    max_clients: that have said a valid line, at once.
    first_line_s: wall time in which a client must have said one.
    max_variables: kept; more are refused.
    queue_bytes: that wait for a client which does not read, before it is disconnected.
    line_bytes: longest line of a client.
    """

    bind: Name = "127.0.0.1"
    port: PortNumber = 9020
    serial: Name | None = None
    bridge: BridgeTable = BridgeTable()
    max_clients: Count = 128
    max_variables: Count = 20_000
    first_line_s: Positive = 60.0
    queue_bytes: Count = 4 << 20
    line_bytes: Count = 1 << 16

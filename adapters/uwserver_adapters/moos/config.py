"""The tables of the adapters `moos`, `moosdb` and `moos_text` in a scenario."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from uwserver.adapter import AdapterTable
from uwserver.table import Count, Name, NonNegative, PortNumber, Positive, Table
from uwserver_adapters.moos.wire import PACKET_LIMIT


class Target(Table, kw_only=True, frozen=True):
    """The effect of a variable on one field of an actuator. The effects of all variables on a field are added, then limited to its range.

    Attributes:
        port: actuator, by its name below the vehicle (`rudder`) or its whole path.
        field: field of the actuator.
        full: what a value of 100 adds, for each component of a vector (`[0, 0, 1, -1]`).
        full_deg: the same in degrees, for a field in radians.
        zero: what a value of 0 adds, for each component; the neutral volume of a ballast, say.
        limit: the variable is limited to +- this; default 100, as it is a percentage.
    """

    port: Name
    field: Name
    full: float | tuple[float, ...] | None = None
    full_deg: float | tuple[float, ...] | None = None
    zero: float | tuple[float, ...] = 0.0
    limit: Positive = 100.0


class NavTable(Table, kw_only=True, frozen=True):
    """The conventional set of variables (NAV_X, NAV_Y, NAV_DEPTH ...). Ports are named below the vehicle. By default they are ground truth, which
    needs `truth = true`.

    Attributes:
        prefix: beginning of the names: NAV, as missions have it, or USM.
        position: port with a position in N (`p_NB`, `p_NS`); "" for none.
        attitude: port with `q_NB` or `q_NS`; "" for none.
        velocity: port with a velocity in B (`v_NB_B`, `v_S`); "" for none.
        flow: port with the velocity of the water (`v_NW_B`) or through the water (`v_water_S`), for NAV_SPEED. Default: `truth/flow`, where
            `velocity` is ground truth too; without such a port NAV_SPEED is the surge over ground.
        depth: port with `depth`; default: the depth comes from the position.
        altitude: port with `range` or `altitude`; default: the altitude comes from `water_depth_m`.
        water_depth_m: depth of the bottom, until a WATER_DEPTH comes.
        rate_hz: highest rate, in simulation time; default: each sample of the position (or attitude).
        ground_truth: publish NAV_GT_* from the truth as well, as uSimMarine does with `dual_state`.
        origin_deg: latitude and longitude of the origin of N, which are LatOrigin and LongOrigin of the mission. Without it there are no NAV_LAT
            and NAV_LONG.
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
    """An autopilot within the adapter, for missions that leave the PID loops to the simulator. It turns DESIRED_HEADING, DESIRED_SPEED and
    DESIRED_DEPTH into DESIRED_RUDDER, DESIRED_THRUST and DESIRED_ELEVATOR. The keys are those of pMarinePIDV22.

    Attributes:
        speed_factor: thrust (%) for each m/s; 0 to use the loop of `speed_pid_*` instead.
        yaw_pid_kp, yaw_pid_ki, yaw_pid_kd, yaw_pid_integral_limit: rudder (degrees, or %) from the error of the heading, degrees.
        speed_pid_kp, speed_pid_ki, speed_pid_kd, speed_pid_integral_limit: change of the thrust (%) from the error of the speed, m/s.
        z_to_pitch_pid_kp, z_to_pitch_pid_ki, z_to_pitch_pid_kd, z_to_pitch_pid_integral_limit: pitch (rad) from the error of the depth, m.
        pitch_pid_kp, pitch_pid_ki, pitch_pid_kd, pitch_pid_integral_limit: elevator (rad, published in degrees) from the error of the pitch, rad.
        maxrudder, maxthrust, maxelevator: limits of the outputs.
        maxpitch: limit of the pitch, degrees.
        depth_control: publish DESIRED_ELEVATOR too.
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
    """Connects MOOS variables with the world.

    Attributes:
        vehicle: vehicle of `nav`, `commands` and USM_RESET; default: the only one there is.
        publish: patterns of ports that become variables; [] for none.
        vectors: publish a vector as a variable for each component, or as one variable with a JSON list.
        on_change: publish a variable only when its value has changed.
        rate_hz: highest rate at which a port is published, in simulation time; default: each sample.
        nav: publish the conventional set of variables.
        commands: variable (DESIRED_THRUST and the like) -> its effects on actuators.
        pid: an autopilot within the adapter, for missions without pMarinePID.
        hold_depth_m: depth to hold with DESIRED_ELEVATOR (of `commands`) while somebody drives and nobody writes DESIRED_ELEVATOR. A mission in the
            plane has no depth, and without this a vehicle with fins would dive or rise for ever.
        externals: name of an external vehicle of the world -> what it follows: a name in NODE_REPORT and NODE_REPORT_LOCAL, or ``NAV_*`` for the
            variables NAV_X, NAV_Y, NAV_DEPTH, NAV_HEADING and NAV_SPEED.
        usm: obey USM_RESET, USM_SIM_PAUSED, DRIFT_X and the like, as uSimMarine does.
        services: carry out calls that come as the variable UWSERVER_CALL.
        alog: file (.alog) that logs all variables; an earlier file of this name is kept under a number.
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
    """A MOOSDB to join, with all keys that `bridge` of the other two adapters has.

    Attributes:
        host, port: address of the MOOSDB.
        client: our name as its client.
    """

    host: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=1, le=65535)] = 9000
    client: Name = "uwserver"


class MoosConfig(AdapterTable, tag="moos", kw_only=True, frozen=True):
    """Attributes:
    communities: databases to join, each by a connection of its own; default: one at 127.0.0.1:9000.
    warp: MOOSTimeWarp of the missions; default: the speed of this server, which must be the same.
    timeout_s: wall time without a message of the database after which the connection is made again.
    """

    communities: dict[Name, CommunityTable] = field(default_factory=lambda: {"main": CommunityTable()})
    warp: Positive | None = None
    timeout_s: Positive = 5.0


class MoosDbConfig(AdapterTable, tag="moosdb", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at. MOOS knows no password, so any other address than loopback is open to all who reach it.
    port: TCP port; 0 takes a free one.
    community: name of the community, which all clients are told.
    bridge: connects variables with the world.
    warp: MOOSTimeWarp of the missions; default: the speed of this server.
    client_timeout_s: wall time without a message of a client after which it is disconnected.
    max_clients: clients at the same time that have said their name.
    max_variables: variables that are kept; more are refused.
    queue_bytes: bytes that may wait for a client that does not read; above that it is disconnected.
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
    bind: address to listen at. There is no password, so any other address than loopback is open to all who reach it.
    port: TCP port; 0 takes a free one.
    serial: path of a serial line or pseudo-terminal that is served too, such as "/dev/ttyS1".
    bridge: connects variables with the world.
    max_clients: clients at the same time that have sent a valid line.
    first_line_s: wall time in which a client must have sent a valid line.
    max_variables: variables that are kept; more are refused.
    queue_bytes: bytes that may wait for a client that does not read; above that it is disconnected.
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

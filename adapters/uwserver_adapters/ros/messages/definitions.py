"""Message types that the stores of rosbags lack: names, fields and constants as their packages define them, without comments.

marine_acoustic_msgs 2.1 (BSD-3-Clause, github.com/apl-ocean-engineering/marine_msgs), simulation_interfaces 1.x (Apache-2.0,
github.com/ros-simulation/simulation_interfaces), std_srvs,
action_msgs, unique_identifier_msgs (Apache-2.0); uwserver_msgs is ours (clients/ros2/uwserver_msgs). Type hashes depend only on
names and types of fields; a test compares them with the published ones.
"""

from __future__ import annotations

MESSAGES: dict[str, str] = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "rosgraph_msgs/msg/Clock": "time clock",
    "marine_acoustic_msgs/msg/Dvl": """
uint8 DVL_MODE_BOTTOM=1
uint8 DVL_MODE_WATER=2
uint8 DVL_TYPE_PISTON=0
uint8 DVL_TYPE_PHASED_ARRAY=1
std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
""",
    "marine_acoustic_msgs/msg/PingInfo": """
float32 frequency
float32 sound_speed
float32[] tx_beamwidths
float32[] rx_beamwidths
""",
    "marine_acoustic_msgs/msg/SonarImageData": """
uint32 DTYPE_UINT8=0
uint32 DTYPE_INT8=1
uint32 DTYPE_UINT16=2
uint32 DTYPE_INT16=3
uint32 DTYPE_UINT32=4
uint32 DTYPE_INT32=5
uint32 DTYPE_UINT64=6
uint32 DTYPE_INT64=7
uint32 DTYPE_FLOAT32=8
uint32 DTYPE_FLOAT64=9
bool is_bigendian
uint32 dtype
uint32 beam_count
uint8[] data
""",
    "marine_acoustic_msgs/msg/ProjectedSonarImage": """
std_msgs/Header header
marine_acoustic_msgs/PingInfo ping_info
geometry_msgs/Vector3[] beam_directions
float32[] ranges
marine_acoustic_msgs/SonarImageData image
""",
    "marine_acoustic_msgs/msg/RawSonarImage": """
std_msgs/Header header
marine_acoustic_msgs/PingInfo ping_info
float32 sample_rate
uint32 samples_per_beam
uint32 sample0
float32[] tx_delays
float32[] tx_angles
float32[] rx_angles
marine_acoustic_msgs/SonarImageData image
""",
    "marine_acoustic_msgs/msg/DetectionFlag": """
uint8 DETECT_OK=0
uint8 DETECT_BAD_SONAR=1
uint8 DETECT_BAD_FILTER=2
uint8 DETECT_BAD_USER=4
uint8 flag
""",
    "marine_acoustic_msgs/msg/SonarRanges": """
std_msgs/Header header
marine_acoustic_msgs/PingInfo ping_info
marine_acoustic_msgs/DetectionFlag[] flags
float32[] transmit_delays
float32[] intensities
geometry_msgs/Vector3[] beam_unit_vec
float32[] ranges
""",
    "marine_acoustic_msgs/msg/SonarDetections": """
std_msgs/Header header
marine_acoustic_msgs/PingInfo ping_info
marine_acoustic_msgs/DetectionFlag[] flags
float32[] two_way_travel_times
float32[] tx_delays
float32[] intensities
float32[] tx_angles
float32[] rx_angles
""",
    "uwserver_msgs/msg/AcousticFix": """
std_msgs/Header header
string beacon
float64 range
float64 travel_time
float64 bearing
float64 elevation
geometry_msgs/Point position
float64[] hydrophone_ranges
""",
    "uwserver_msgs/msg/Ctd": """
std_msgs/Header header
float64 conductivity
float64 temperature
float64 pressure
float64 salinity
""",
    "uwserver_msgs/msg/ScalarStamped": """
std_msgs/Header header
float64 data
""",
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid",
    "action_msgs/msg/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp",
    "simulation_interfaces/msg/Result": """
uint8 RESULT_FEATURE_UNSUPPORTED=0
uint8 RESULT_OK=1
uint8 RESULT_NOT_FOUND=2
uint8 RESULT_INCORRECT_STATE=3
uint8 RESULT_OPERATION_FAILED=4
uint8 result
string error_message
""",
    "simulation_interfaces/msg/SimulationState": """
uint8 STATE_STOPPED=0
uint8 STATE_PLAYING=1
uint8 STATE_PAUSED=2
uint8 STATE_QUITTING=3
uint8 state
""",
    "simulation_interfaces/msg/SimulatorFeatures": """
uint16[] features
string[] spawn_formats
string custom_info
""",
    "simulation_interfaces/msg/EntityCategory": """
uint8 CATEGORY_OBJECT=0
uint8 CATEGORY_ROBOT=1
uint8 category
""",
    "simulation_interfaces/msg/TagsFilter": """
string[] tags
uint8 FILTER_MODE_ANY=0
uint8 FILTER_MODE_ALL=1
uint8 filter_mode
""",
    "simulation_interfaces/msg/Bounds": """
uint8 TYPE_EMPTY=0
uint8 TYPE_BOX=1
uint8 TYPE_CONVEX_HULL=2
uint8 TYPE_SPHERE=3
uint8 type
geometry_msgs/Vector3[] points
""",
    "simulation_interfaces/msg/EntityFilters": """
string filter
simulation_interfaces/EntityCategory[] categories
simulation_interfaces/TagsFilter tags
simulation_interfaces/Bounds bounds
""",
    "simulation_interfaces/msg/EntityState": """
std_msgs/Header header
geometry_msgs/Pose pose
geometry_msgs/Twist twist
geometry_msgs/Accel acceleration
""",
    "simulation_interfaces/msg/EntityInfo": """
simulation_interfaces/EntityCategory category
string description
string[] tags
""",
    "simulation_interfaces/msg/Spawnable": """
string uri
string description
simulation_interfaces/Bounds spawn_bounds
""",
}
"""Type -> text of its .msg file, with nested types by their full names."""

SERVICES: dict[str, tuple[str, str]] = {
    "std_srvs/srv/Empty": ("", ""),
    "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
    "std_srvs/srv/SetBool": ("bool data", "bool success\nstring message"),
    "simulation_interfaces/srv/GetSimulatorFeatures": ("", "simulation_interfaces/SimulatorFeatures features"),
    "simulation_interfaces/srv/GetSimulationState": (
        "",
        "simulation_interfaces/SimulationState state\nsimulation_interfaces/Result result",
    ),
    "simulation_interfaces/srv/SetSimulationState": (
        "simulation_interfaces/SimulationState state",
        """
uint8 ALREADY_IN_TARGET_STATE=101
uint8 STATE_TRANSITION_ERROR=102
uint8 INCORRECT_TRANSITION=103
simulation_interfaces/Result result
""",
    ),
    "simulation_interfaces/srv/StepSimulation": ("uint64 steps 1", "simulation_interfaces/Result result"),
    "simulation_interfaces/srv/ResetSimulation": (
        "uint8 SCOPE_DEFAULT=0\nuint8 SCOPE_TIME=1\nuint8 SCOPE_STATE=2\nuint8 SCOPE_SPAWNED=4\nuint8 SCOPE_ALL=255\nuint8 scope",
        "simulation_interfaces/Result result",
    ),
    "simulation_interfaces/srv/GetEntities": (
        "simulation_interfaces/EntityFilters filters",
        "simulation_interfaces/Result result\nstring[] entities",
    ),
    "simulation_interfaces/srv/GetEntitiesStates": (
        "simulation_interfaces/EntityFilters filters",
        "simulation_interfaces/Result result\nstring[] entities\nsimulation_interfaces/EntityState[] states",
    ),
    "simulation_interfaces/srv/GetEntityState": (
        "string entity",
        "simulation_interfaces/Result result\nsimulation_interfaces/EntityState state",
    ),
    "simulation_interfaces/srv/SetEntityState": (
        "string entity\nsimulation_interfaces/EntityState state",
        "uint8 INVALID_POSE=101\nsimulation_interfaces/Result result",
    ),
    "simulation_interfaces/srv/GetEntityInfo": (
        "string entity",
        "simulation_interfaces/Result result\nsimulation_interfaces/EntityInfo info",
    ),
    "simulation_interfaces/srv/GetSpawnables": (
        "string[] sources",
        "simulation_interfaces/Result result\nsimulation_interfaces/Spawnable[] spawnables",
    ),
    "simulation_interfaces/srv/SpawnEntity": (
        """
string name
bool allow_renaming
string uri
string resource_string
string entity_namespace
geometry_msgs/PoseStamped initial_pose
""",
        """
uint8 NAME_NOT_UNIQUE=101
uint8 NAME_INVALID=102
uint8 UNSUPPORTED_FORMAT=103
uint8 NO_RESOURCE=104
uint8 NAMESPACE_INVALID=105
uint8 RESOURCE_PARSE_ERROR=106
uint8 MISSING_ASSETS=107
uint8 UNSUPPORTED_ASSETS=108
uint8 INVALID_POSE=109
simulation_interfaces/Result result
string entity_name
""",
    ),
    "simulation_interfaces/srv/DeleteEntity": ("string entity", "simulation_interfaces/Result result"),
    "action_msgs/srv/CancelGoal": (
        "action_msgs/GoalInfo goal_info",
        """
int8 ERROR_NONE=0
int8 ERROR_REJECTED=1
int8 ERROR_UNKNOWN_GOAL_ID=2
int8 ERROR_GOAL_TERMINATED=3
int8 return_code
action_msgs/GoalInfo[] goals_canceling
""",
    ),
    "rcl_interfaces/srv/DescribeParameters": ("string[] names", "rcl_interfaces/ParameterDescriptor[] descriptors"),
    "rcl_interfaces/srv/GetParameters": ("string[] names", "rcl_interfaces/ParameterValue[] values"),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names", "uint8[] types"),
    "rcl_interfaces/srv/ListParameters": (
        "uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "rcl_interfaces/srv/SetParameters": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult[] results",
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult result",
    ),
    "uwserver_msgs/srv/Call": ("string service\nstring arguments", "bool success\nstring message\nstring result"),
}
"""Type -> texts of its request and its response."""

ACTIONS: dict[str, tuple[str, str, str]] = {
    "uwserver_msgs/action/Goto": (
        "geometry_msgs/PoseStamped pose\nfloat64 speed\nfloat64 radius",
        "bool success\nstring message\nfloat64 distance",
        "float64 progress",
    ),
    "uwserver_msgs/action/Mission": (
        "geometry_msgs/PoseStamped[] poses\nstring items\nuint32 first",
        "bool success\nstring message\nuint32 reached",
        "float64 progress",
    ),
    "simulation_interfaces/action/SimulateSteps": (
        "uint64 steps",
        "simulation_interfaces/Result result",
        "uint64 completed_steps\nuint64 remaining_steps",
    ),
}
"""Type -> texts of its goal, its result and its feedback."""

NEWER_MESSAGES: dict[str, str] = {
    "simulation_interfaces/msg/Resource": "string uri\nstring resource_string",
    "simulation_interfaces/msg/Spawnable": """
simulation_interfaces/Resource entity_resource
string description
simulation_interfaces/Bounds spawn_bounds
""",
}
"""Messages that differ in rolling, which has simulation_interfaces 2.1; kilted, jazzy and humble have 1.x."""
NEWER_REQUESTS: dict[str, str] = {
    "simulation_interfaces/srv/SetEntityState": """
string entity
simulation_interfaces/EntityState state
bool set_pose
bool set_twist
bool set_acceleration
""",
    "simulation_interfaces/srv/SpawnEntity": """
string name
bool allow_renaming
simulation_interfaces/Resource entity_resource
string entity_namespace
geometry_msgs/PoseStamped initial_pose
""",
}
"""Requests of services that differ in rolling."""

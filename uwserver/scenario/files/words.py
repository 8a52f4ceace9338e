"""Words of other simulators, with the right ones here. Errors about unknown keys, kinds, values, vehicles and commands look here first.

The words are those of SDFormat and Gazebo's plugins (gz), the xacro macros of the UUV Simulator (uuv), the XML of Stonefish, the JSON of HoloOcean,
the Builder scripts of MORSE, and what anyone may write (any).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Literal, NamedTuple

Origin = Literal["gz", "uuv", "stonefish", "holoocean", "morse", "any"]


class Word(NamedTuple):
    """What a word of another simulator is here.

    Attributes:
        origin: where people know it from.
        here: our words, the likeliest first, each with what else to change ("in degrees"), or "". The first that is allowed at the place is told.
        elsewhere: what to write where none of `here` is allowed; "" to say nothing.
    """

    origin: Origin
    here: Mapping[str, str]
    elsewhere: str = ""


_RATE = "[world] rate_hz is the rate of the physics"
_TABLE_NAME = "the name of the table is the name on every connection"
_EARTH = "[world] origin_lat_deg and origin_lon_deg place the world on the Earth; position_ned_m is north, east, down from there"
_WATER = "[environment] density_kgpm3 is the density of the water"
_DEVICE = "that is in the thruster's device file: `uwserver show t200` prints one"
_POSE = {"position_ned_m": "north, east, down, with attitude_rpy_deg", "position_frd_m": "forward, right, down, with rpy_deg"}  # fmt: skip
_PLACE = {"position_ned_m": "north, east, down", "position_frd_m": "forward, right, down"}
_TURN = {"attitude_rpy_deg": "roll, pitch, yaw", "rpy_deg": "roll, pitch, yaw"}
_FIELD = {"field_of_view_deg": "in degrees", "field_deg": "in degrees", "sector_width_deg": "in degrees"}
_NEAREST = {"min_range_m": "", "min_altitude_m": ""}
_FARTHEST = {"range_m": "", "max_range_m": "", "max_altitude_m": ""}
_MOUNT = {"mount": "the name of one of the vehicle's [mounts]"}
_DENSITY = {"density_kgpm3": "", "reference_density_kgpm3": ""}
_SIX = "its diagonal is positive: surge to yaw"
_ADDED = {"diagonal": "positive: surge to yaw", "added_mass": _SIX}
_LINEAR = {"linear": _SIX, "damping": f"[damping.linear], {_SIX}"}
_QUADRATIC = {"quadratic": _SIX, "damping": f"[damping.quadratic], {_SIX}"}
_NOISE = 'a modifier of kind "white_noise" has sigma'
_TRUTH = "the true state is not a sensor: [vehicles.NAME.truth] gives it"
_AUTOPILOT = "[vehicles.NAME.autopilot] is the built-in autopilot"
_SIGHT = "how far a camera sees follows from [environment] water_type"
_RIGID = "a vehicle is one [rigid_body]; fins, propellers and moving_masses are what moves on it"

WORDS: Mapping[str, Word] = {
    # Time
    "max_step_size": Word("gz", {"rate_hz": "1 over the step"}, _RATE),
    "real_time_factor": Word("gz", {"speed": ""}, "[world.clock] speed is the speed of time"),
    "real_time_update_rate": Word("gz", {"rate_hz": ""}, _RATE),
    "physics": Word("gz", {"world": "with rate_hz"}),
    "lockstep": Word("gz", {}, '[world.clock] mode = "lockstep", with lockstep_clients'),
    "ticks_per_sec": Word("holoocean", {"rate_hz": ""}, _RATE),
    "frames_per_sec": Word("holoocean", {"speed": ""}, "[world.clock] mode and speed say how time passes"),
    "time_step": Word("any", {"rate_hz": "1 over the step"}, _RATE),
    "dt": Word("any", {"rate_hz": "1 over the step"}, _RATE),
    "asap": Word("any", {"freerun": ""}),
    "as_fast_as_possible": Word("any", {"freerun": ""}),
    # The world and its water
    "spherical_coordinates": Word("gz", {"origin_lat_deg": "with origin_lon_deg"}, _EARTH),
    "latitude": Word("stonefish", {"origin_lat_deg": ""}, _EARTH),
    "longitude": Word("stonefish", {"origin_lon_deg": ""}, _EARTH),
    "latitude_deg": Word("gz", {"origin_lat_deg": ""}, _EARTH),
    "longitude_deg": Word("gz", {"origin_lon_deg": ""}, _EARTH),
    "ned": Word("stonefish", {"origin_lat_deg": "with origin_lon_deg"}, _EARTH),
    "fluid_density": Word("gz", _DENSITY, _WATER),
    "water_density": Word("gz", _DENSITY, _WATER),
    "uniform_fluid_density": Word("gz", _DENSITY, _WATER),
    "default_current": Word("gz", {"current": "velocity_ned_mps"}, "[environment.current] velocity_ned_mps"),
    "ocean_current": Word("gz", {"current": "velocity_ned_mps"}, "[environment.current] velocity_ned_mps"),
    "current_velocity": Word("uuv", {"velocity_ned_mps": "north, east, down"}, "[environment.current] velocity_ned_mps"),
    "ocean": Word("stonefish", {"environment": ""}),
    "atmosphere": Word("stonefish", {"daylight": ""}, "[environment.daylight]"),
    "sun": Word("stonefish", {"daylight": ""}, "[environment.daylight]"),
    "jerlov": Word("stonefish", {"water_type": "I to III, or 1C to 9C for coasts"}, "[environment] water_type"),
    "coastal": Word("any", {"1C": "the clearest of the coastal waters 1C to 9C"}),
    "clear": Word("any", {"I": "the clearest water"}),
    "turbid": Word("any", {"9C": "the least clear of the coastal waters 1C to 9C"}),
    "terrain": Word("stonefish", {"seabed": "", "grid": "a grid of depths"}),
    "heightmap": Word("gz", {"seabed": 'kind = "grid"', "grid": "a grid of depths", "file": ".npy or .nc"}),
    "ground_plane": Word("gz", {"seabed": 'kind = "flat"', "flat": "depth_m"}),
    "plane": Word("gz", {"flat": "depth_m", "seabed": 'kind = "flat"'}),
    # What is in the world
    "robot": Word("stonefish", {"vehicles": "[vehicles.NAME], with its model"}),
    "robots": Word("morse", {"vehicles": "[vehicles.NAME], with its model"}),
    "agents": Word("holoocean", {"vehicles": "[vehicles.NAME], with its model"}),
    "include": Word("gz", {"vehicles": "[vehicles.NAME], with its model"}),
    "models": Word("gz", {"vehicles": "[vehicles.NAME], with its model"}),
    "agent_type": Word("holoocean", {"model": "a shipped vehicle, or a file"}),
    "agent_name": Word("holoocean", {}, _TABLE_NAME),
    "control_scheme": Word("holoocean", {"autopilot": ""}, _AUTOPILOT),
    "uri": Word("gz", {"model": "a shipped vehicle, or a file", "file": ""}),
    "static": Word("gz", {"structures": "what does not move"}, "what does not move is in [structures], what moves in [objects]"),
    "dynamic": Word("stonefish", {"objects": "what moves"}, "what moves is in [objects]"),
    "pose": Word("gz", _POSE),
    "origin": Word("stonefish", {"origin_lat_deg": "with origin_lon_deg", **_POSE}),
    "xyz": Word("gz", {**_PLACE, "center_frd_m": "forward, right, down"}),
    "rpy": Word("gz", _TURN),
    "world_transform": Word("stonefish", _POSE),
    "location": Word("holoocean", _PLACE),
    "rotation": Word("holoocean", {**_TURN, "beam_azimuth_deg": "one for each beam"}),
    "position_lla": Word("any", {}, _EARTH),
    "position_enu_m": Word("any", {"position_ned_m": "north, east, down: swap the first two, and change the sign of the third"}),
    "orientation": Word("any", _TURN),
    "quaternion": Word("any", _TURN),
    "linear_velocity": Word("gz", {"velocity_frd_mps": "forward, right, down"}),
    "size": Word("gz", {"size_m": "full edges"}),
    "dimensions": Word("stonefish", {"size_m": "full edges", "radius_m": "with length_m"}),
    "height": Word("stonefish", {"significant_height_m": "", "length_m": "along x", "size_m": "full edges"}),
    "diameter": Word("stonefish", {"diameter_m": "", "radius_m": "half of it"}),
    "diameter_m": Word("any", {"radius_m": "half of it"}),
    "filename": Word("gz", {"file": "", "looks": "a .glb file"}),
    "mu": Word("gz", {"friction": ""}),
    "restitution_coefficient": Word("gz", {"restitution": ""}),
    # Tables of sensors
    "sensor_type": Word("holoocean", {"kind": "`uwserver list sensors`"}),
    "sensor_name": Word("holoocean", {}, _TABLE_NAME),
    "type": Word("gz", {"kind": "", "water_type": ""}),
    "plugin": Word("gz", {"kind": ""}),
    "update_rate": Word("gz", {"rate_hz": ""}),
    "hz": Word("holoocean", {"rate_hz": ""}),
    "frequency": Word("morse", {"frequency_hz": "", "rate_hz": ""}),
    "always_on": Word("gz", {"enabled": ""}),
    "topic": Word("gz", {}, _TABLE_NAME),
    "ros_publisher": Word("stonefish", {}, "adapters publish all ports: [adapters.ros2]"),
    "parent_link": Word("uuv", _MOUNT),
    "link_name": Word("uuv", _MOUNT),
    "socket": Word("holoocean", _MOUNT),
    "noise": Word("gz", {"modifiers": '[....modifiers.noise] kind = "white_noise"'}),
    "gaussian": Word("gz", {"white_noise": ""}),
    "stddev": Word("gz", {"sigma": ""}, _NOISE),
    "noise_sigma": Word("uuv", {"sigma": "", "beam_sigma_mps": "", "range_sigma_m": "", "sigma_m": ""}, _NOISE),
    "add_sigma": Word("holoocean", {"noise_level_db": "of the water and the sonar", "gain_sigma_db": ""}, _NOISE),
    "range_sigma": Word("holoocean", {"range_sigma_m": "", "sigma_m": ""}),
    "vel_sigma": Word("holoocean", {"beam_sigma_mps": ""}),
    "image": Word("gz", {"width": "with height"}),
    "resolution_x": Word("stonefish", {"width": ""}),
    "resolution_y": Word("stonefish", {"height": ""}),
    "capture_width": Word("holoocean", {"width": ""}),
    "capture_height": Word("holoocean", {"height": ""}),
    "cam_width": Word("morse", {"width": ""}),
    "cam_height": Word("morse", {"height": ""}),
    "cam_focal": Word("morse", {"focal_px": "or field_of_view_deg"}),
    "cam_far": Word("morse", {}, _SIGHT),
    "clip": Word("gz", {}, _SIGHT),
    "horizontal_fov": Word("gz", _FIELD),
    "fov": Word("stonefish", _FIELD),
    "fov_deg": Word("any", _FIELD),
    "hfov": Word("any", _FIELD),
    "vertical_fov": Word("stonefish", {"beam_width_vertical_deg": ""}),
    "azimuth": Word("holoocean", {"field_deg": "", "sun_azimuth_deg": ""}),
    "elevation": Word("holoocean", {"beam_width_vertical_deg": "", "beam_angle_deg": "", "sun_elevation_deg": ""}),
    "opening_angle": Word("holoocean", {"beam_width_deg": ""}),
    "horizontal_beam_width": Word("stonefish", {"beam_width_horizontal_deg": ""}),
    "vertical_beam_width": Word("stonefish", {"beam_width_vertical_deg": ""}),
    "vertical_tilt": Word("stonefish", {"tilt_deg": ""}),
    "tilt": Word("gz", {"tilt_deg": "", "beam_angle_deg": "from the vertical"}),
    "range_min": Word("stonefish", _NEAREST),
    "range_max": Word("stonefish", _FARTHEST),
    "distance_min": Word("stonefish", _NEAREST),
    "distance_max": Word("stonefish", _FARTHEST),
    "laser_range": Word("morse", _FARTHEST),
    "range_bins": Word("holoocean", {"bins": ""}),
    "azimuth_bins": Word("holoocean", {"beams": ""}),
    "samples": Word("gz", {"beams": ""}),
    "steps": Word("stonefish", {"step_deg": "in degrees", "beams": ""}),
    "scan_window": Word("morse", {"field_of_view_deg": ""}),
    "water_speed_sound": Word("holoocean", {"assumed_sound_speed_mps": ""}, "[environment.water] gives the speed of sound"),
    # Kinds of sensor and actuator
    "navsat": Word("gz", {"gps": ""}),
    "air_pressure": Word("gz", {"pressure": ""}),
    "lidar": Word("gz", {"range_array": ""}),
    "gpu_lidar": Word("gz", {"range_array": ""}),
    "ray": Word("gz", {"range_array": ""}),
    "depth_camera": Word("gz", {"camera": 'mode = "depth"'}),
    "doppler_velocity_log": Word("gz", {"dvl": ""}),
    "sonar": Word("gz", {"multibeam": "a picture; or altimeter, scanning_sonar, side_scan, bathymetry, profiler"}),
    "fls": Word("stonefish", {"multibeam": ""}),
    "msis": Word("stonefish", {"scanning_sonar": ""}),
    "sss": Word("stonefish", {"side_scan": ""}),
    "compass": Word("stonefish", {"attitude": "an AHRS or a gyrocompass"}),
    "gyro": Word("stonefish", {"imu": ""}),
    "accelerometer": Word("stonefish", {"imu": ""}),
    "odometry": Word("stonefish", {}, _TRUTH),
    "vbs": Word("stonefish", {"ballast": ""}),
    "rudder": Word("stonefish", {"fin": "", "fins": ""}),
    "pose_3d": Word("uuv", {"motion_capture": ""}, _TRUTH),
    "pose_gt": Word("uuv", {}, _TRUTH),
    "dvl_sensor": Word("holoocean", {"dvl": ""}),
    "imu_sensor": Word("holoocean", {"imu": ""}),
    "gps_sensor": Word("holoocean", {"gps": ""}),
    "depth_sensor": Word("holoocean", {"pressure": 'output = "depth"'}),
    "depth": Word("any", {"depth_m": "", "pressure": 'output = "depth"'}),
    "imaging_sonar": Word("holoocean", {"multibeam": ""}),
    "profiling_sonar": Word("holoocean", {"bathymetry": ""}),
    "sidescan_sonar": Word("holoocean", {"side_scan": ""}),
    "singlebeam_sonar": Word("holoocean", {"altimeter": ""}),
    "rgb_camera": Word("holoocean", {"camera": ""}),
    "pose_sensor": Word("holoocean", {}, _TRUTH),
    "location_sensor": Word("holoocean", {}, _TRUTH),
    "velocity_sensor": Word("holoocean", {}, _TRUTH),
    "orientation_sensor": Word("holoocean", {}, _TRUTH),
    "acoustic_beacon_sensor": Word("holoocean", {"acoustic_modem": ""}),
    "optical_modem_sensor": Word("holoocean", {"optical_modem": ""}),
    "magnetometer_sensor": Word("holoocean", {"magnetometer": ""}),
    "collision_sensor": Word("holoocean", {"contact": ""}),
    "range_finder_sensor": Word("holoocean", {"range_array": ""}),
    "video_camera": Word("morse", {"camera": ""}),
    "gyroscope": Word("morse", {"imu": ""}),
    "barometer": Word("morse", {"pressure": ""}),
    "thermometer": Word("morse", {"ctd": ""}),
    "infrared": Word("morse", {"range_array": ""}),
    "hokuyo": Word("morse", {"range_array": ""}),
    "sick": Word("morse", {"range_array": ""}),
    "external_force": Word("morse", {"force_torque": ""}),
    "motion_vw": Word("morse", {}, _AUTOPILOT),
    "waypoint": Word("morse", {}, _AUTOPILOT),
    # Vehicle files
    "inertial": Word("gz", {"rigid_body": ""}),
    "base_link": Word("stonefish", {"rigid_body": ""}, _RIGID),
    "link": Word("gz", {"rigid_body": "", **_MOUNT}, _RIGID),
    "joint": Word("gz", {}, _RIGID),
    "visual": Word("gz", {"looks": "a .glb file"}),
    "mesh": Word("gz", {"file": "", "looks": "a .glb file"}),
    "center_of_buoyancy": Word("uuv", {"center_frd_m": "forward, right, down"}, "[buoyancy] center_frd_m"),
    "neutrally_buoyant": Word("uuv", {"volume_m3": "mass over density"}, "[buoyancy] volume_m3 = mass over density"),
    "hydrodynamic_model": Word("uuv", {"added_mass": "and [damping]"}),
    "hydrodynamics": Word("gz", {"added_mass": "and [damping]"}),
    "linear_damping": Word("uuv", _LINEAR),
    "quadratic_damping": Word("uuv", _QUADRATIC),
    "linear_damping_forward_speed": Word("uuv", {"speed": "", "damping": "[damping.speed]"}),
    **{key: Word("gz", _ADDED) for key in ("x_dot_u", "y_dot_v", "z_dot_w", "k_dot_p", "m_dot_q", "n_dot_r")},
    **{key: Word("gz", _LINEAR) for key in ("x_u", "y_v", "z_w", "k_p", "m_q", "n_r")},
    **{key: Word("gz", _QUADRATIC) for key in ("x_uu", "y_vv", "z_ww", "k_pp", "m_qq", "n_rr", "x_uabs_u")},
    "lift_drag": Word("gz", {"fins": "or foils"}),
    "buoyancy_engine": Word("gz", {"ballast": "", "ballasts": ""}),
    "light": Word("stonefish", {"lamps": ""}),
    "thrust_coefficient": Word("gz", {"curves": "force over command"}, _DEVICE),
    "max_thrust_cmd": Word("gz", {"max_forward_N": "", "curves": "their max_forward_N"}, _DEVICE),
    "propeller_diameter": Word("gz", {"diameter_m": "", "propeller": "its diameter_m"}, _DEVICE),
    "thrust_coeff": Word("stonefish", {"curves": "force over command"}, _DEVICE),
    "max_rpm": Word("stonefish", {"max_speed_radps": "", "speed_radpspN05": ""}, _DEVICE),
    "rotor_constant": Word("uuv", {"curves": "force over command"}, _DEVICE),
    "time_constant": Word("uuv", {"time_constant_s": "", "tau_s": "", "lag": "its time_constant_s"}, _DEVICE),
    # Vehicles
    "hovering_auv": Word("holoocean", {"bluerov2_heavy": "eight thrusters"}),
    "torpedo_auv": Word("holoocean", {"remus100": "or lauv"}),
    "surface_vessel": Word("holoocean", {"otter": ""}),
    "wamv": Word("gz", {"otter": "two pontoons"}),
    "rexrov2": Word("uuv", {"rexrov": ""}),
    "girona500auv": Word("stonefish", {"girona500": ""}),
    # Commands
    "launch": Word("gz", {"run": ""}),
    "sim": Word("gz", {"run": ""}),
    "start": Word("any", {"run": ""}),
    "serve": Word("any", {"run": ""}),
    "simulate": Word("any", {"run": ""}),
    "view": Word("any", {"run": "with --open"}),
    "gui": Word("gz", {"run": "with --open"}),
    "create": Word("morse", {"new": ""}),
    "init": Word("any", {"new": ""}),
    "echo": Word("gz", {}, "`uwclient echo` prints the samples of a running server"),
    "info": Word("any", {"list": ""}),
}  # fmt: skip
"""By the word in small letters with _ between its parts; `foreign` also finds it in CamelCase or with other signs between them."""

_SIGNS = re.compile(r"[^a-z0-9]+")
_BY_LETTERS = {_SIGNS.sub("", word): meaning for word, meaning in WORDS.items()}


def foreign(word: str) -> Word | None:
    """Return what a word of another simulator is here, however it is written (`updateRate`, `update_rate`); None if it is not in the table."""
    return _BY_LETTERS.get(_SIGNS.sub("", word.lower()))


def word_here(word: str, allowed: Collection[str]) -> str | None:
    """Return our word for one of another simulator: the first that is allowed at its place; None if there is none."""
    meaning = foreign(word)
    return None if meaning is None else next((here for here in meaning.here if here in allowed), None)


def translation(word: str, allowed: Collection[str]) -> str:
    """Return a hint for a word of another simulator, to be put behind it: `` (did you mean "rate_hz"?)``; "" if there is none."""
    meaning = foreign(word)
    if meaning is None:
        return ""
    here = word_here(word, allowed)
    if here is None:
        return f": {meaning.elsewhere}" if meaning.elsewhere else ""
    note = meaning.here[here]
    return f' (did you mean "{here}"{f", {note}" if note else ""}?)'

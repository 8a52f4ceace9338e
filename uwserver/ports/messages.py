"""Standard messages by plain names, which belong to no middleware. Each adapter sends them as the messages that its own middleware has for them."""

from __future__ import annotations

from collections.abc import Mapping

STANDARD: Mapping[str, tuple[str, ...]] = {
    "AcousticPacket": ("event", "source", "destination", "data"),
    "Attitude": ("q_NS", "heading"),
    "Bathymetry": ("frequency", "sound_speed", "angle", "range", "level"),
    "BatteryState": ("voltage", "current", "charge"),
    "BeaconFix": ("beacon", "range", "travel_time", "p_beacon_S"),
    "BeaconRange": ("beacon", "range", "travel_time"),
    "Contact": ("touching", "impulse_B"),
    "Ctd": ("conductivity", "temperature", "pressure", "salinity"),
    "CurrentProfile": ("distances", "velocities_N"),
    "Dvl": ("v_S", "altitude", "figure_of_merit", "covariance_S", "beam_velocities", "beam_ranges", "beam_locks"),
    "FluidPressure": (),
    "Image": ("image",),
    "Imu": ("f_S", "w_S"),
    "LaserScan": ("ranges",),
    "Leak": ("leak",),
    "MagneticField": ("field_S",),
    "NavSatFix": (
        "latitude", "longitude", "height", "v_NS", "horizontal_accuracy", "vertical_accuracy", "velocity_accuracy", "satellites", "fix",
    ),
    "OpticalPacket": ("event", "source", "destination", "data"),
    "Pose": ("p_NS", "q_NS"),
    "Range": ("range",),
    "ShaftSpeeds": ("speeds",),
    "SideScan": ("range", "frequency", "sound_speed", "port", "starboard"),
    "SonarImage": ("range_start", "range", "frequency", "sound_speed", "azimuth", "image"),
    "SonarPing": ("head_angle", "range", "bins"),
    "SonarProfile": ("frequency", "sound_speed", "head_angle", "range", "level"),
    "SoundSpeed": ("sound_speed",),
    "Teleport": ("p_NB", "q_NB"),
    "TimeReference": ("utc_ns",),
    "Training": (
        "state", "task", "number", "count", "time", "held", "hold", "goal_p_NB", "distance", "score", "part", "hint", "found", "missing", "marks",
        "lost",
    ),
    "Wrench": ("force_B", "torque_B"),
}  # fmt: skip
"""The fields that a port must have to fit a message, by the name of the message; for `FluidPressure`, one of `pressure` and `depth`.

Units, frames and meanings of the fields are those of the shipped kind with this message. A kind may also name a message that is not listed here."""

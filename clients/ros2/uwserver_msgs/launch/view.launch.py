"""RViz with the frames, the odometry and the sonar ranges of one vehicle: ros2 launch uwserver_msgs view.launch.py vehicle:=rov"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """One node, RViz, in simulated time; the topics of the layout are remapped to the vehicle's."""
    vehicle = LaunchConfiguration("vehicle")
    layout = str(Path(get_package_share_directory("uwserver_msgs")) / "rviz" / "view.rviz")
    remapped = [
        ("/vehicle/odometry", ["/", vehicle, "/odometry"]),
        ("/vehicle/altimeter", ["/", vehicle, "/altimeter"]),
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("vehicle", default_value="rov", description="name of the vehicle in the scenario"),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", layout],
                parameters=[{"use_sim_time": True}],
                remappings=remapped,
            ),
        ]
    )

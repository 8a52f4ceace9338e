"""Adapter `ros2`: a node of ROS 2, with no ROS installed, on zenoh (as rmw_zenoh speaks it) or DDS."""

from uwserver_adapters.ros2.adapter import Ros2Adapter

__all__ = ["Ros2Adapter"]

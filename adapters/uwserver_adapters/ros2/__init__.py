"""Adapter `ros2`: a node of ROS 2 on zenoh (as rmw_zenoh uses it) or DDS. It needs no ROS on this machine."""

from uwserver_adapters.ros2.adapter import Ros2Adapter

__all__ = ["Ros2Adapter"]

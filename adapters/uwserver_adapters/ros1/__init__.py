"""The adapter `ros1`: a node of a ROS 1 graph."""

from uwserver_adapters.ros1.adapter import Ros1Adapter

__all__ = ["Ros1Adapter"]

"""Adapter `rosbridge`: topics and services for clients of rosbridge v2 (roslibpy, roslib.js, Foxglove). It needs no ROS on this machine."""

from uwserver_adapters.rosbridge.adapter import RosbridgeAdapter

__all__ = ["RosbridgeAdapter"]

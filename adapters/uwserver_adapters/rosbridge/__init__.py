"""Adapter `rosbridge`: topics and services for all that speaks rosbridge v2 (roslibpy, roslib.js, Foxglove), with no ROS installed."""

from uwserver_adapters.rosbridge.adapter import RosbridgeAdapter

__all__ = ["RosbridgeAdapter"]

"""One message table for all ROS dialects: ports become topics of standard messages, and so do commands; services become ROS services.

`Types` knows the message types of a distribution and their three forms (CDR, ROS 1 bytes, maps). `Catalogue` lists the topics and services of a
world and makes their messages. This room converts frames to ENU and FLU (REP-103, REP-105); no other room does.
"""

from __future__ import annotations

from uwserver_adapters.ros.messages.actions import CANCELING, EXECUTING, Action, end_of
from uwserver_adapters.ros.messages.catalogue import CLOCK, TF_STATIC, Catalogue
from uwserver_adapters.ros.messages.commands import CommandTopic, Value
from uwserver_adapters.ros.messages.ros_port import Facts, Mount, SensorTopic, mounts_of
from uwserver_adapters.ros.messages.services import Ask, Errand, Offer
from uwserver_adapters.ros.messages.settings import Setting
from uwserver_adapters.ros.messages.types import DISTROS, BadMessage, Types, full_name

__all__ = [
    "CANCELING", "CLOCK", "DISTROS", "EXECUTING", "TF_STATIC", "Action", "Ask", "BadMessage", "Catalogue", "CommandTopic", "Errand", "Facts", "Mount",
    "Offer", "SensorTopic", "Setting", "Types", "Value", "end_of", "full_name", "mounts_of",
]  # fmt: skip

"""One message table for all ROS dialects: ports become topics of standard messages, and so do commands; services become ROS services.

`Types` knows the message types of a distribution and their three forms (CDR, ROS 1 bytes, maps). `Catalogue` lists the topics and services of a
world and makes their messages. This room converts frames to ENU and FLU (REP-103, REP-105); no other room does.
"""

from __future__ import annotations

from uwserver_adapters.ros.messages.catalogue import Catalogue
from uwserver_adapters.ros.messages.commands import Inlet
from uwserver_adapters.ros.messages.source import Facts, Mount, Outlet
from uwserver_adapters.ros.messages.types import DISTROS, BadMessage, Types

__all__ = ["DISTROS", "BadMessage", "Catalogue", "Facts", "Inlet", "Mount", "Outlet", "Types"]

"""One message table for all ROS dialects: a port is a topic of a standard message, a command is one, a service is one.

`Types` knows the types of a distribution and their three forms (CDR, ROS 1 bytes, maps). `Catalogue` says which topics and services a world has,
and makes their messages. Frames are ENU and FLU here (REP-103, REP-105); nothing above or below converts again.
"""

from __future__ import annotations

from uwserver_adapters.ros.messages.catalogue import Catalogue
from uwserver_adapters.ros.messages.commands import Inlet
from uwserver_adapters.ros.messages.source import Facts, Mount, Outlet
from uwserver_adapters.ros.messages.types import DISTROS, BadMessage, Types

__all__ = ["DISTROS", "BadMessage", "Catalogue", "Facts", "Inlet", "Mount", "Outlet", "Types"]

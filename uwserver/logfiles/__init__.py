"""Log files of any origin: one reader a format behind `Log`, and the mapping that makes poses and samples of ports of them."""

from uwserver.logfiles.log import Datum, Kind, Limits, Log, LogError, LogField, Topic, member
from uwserver.logfiles.opening import open_log

__all__ = ["Datum", "Kind", "Limits", "Log", "LogError", "LogField", "Topic", "member", "open_log"]

"""Readers for log files of many formats behind the interface `Log`, and mappings that turn logs into poses and port samples."""

from uwserver.logfiles.log import Datum, Kind, Limits, Log, LogError, LogField, Topic, member
from uwserver.logfiles.readers.opening import open_log

__all__ = ["Datum", "Kind", "Limits", "Log", "LogError", "LogField", "Topic", "member", "open_log"]

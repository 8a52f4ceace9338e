"""Reads the head of a recording for playback. It needs less than a replay, and opens no file that the head names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from uwserver.recording.format import FORMAT, METADATA, Head, head_with
from uwserver.recording.parts import SERVED
from uwserver.recording.player.chunks import NotOurs, NotPlayable, PartChunks
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.tables import VehicleFile


def played_head(chunks: PartChunks) -> tuple[Head, tuple[str, ...]]:
    """Read the head of a recording; return it with remarks about it.

    Any version of the physics can be played. Components whose kinds come from extensions are left out, because the extensions are not opened; their
    ports are in the recording.

    Raises:
        NotPlayable: it is not a recording of ours, has another format, or its scenario does not fit this version.
    """
    record = chunks.metadata.get(METADATA)
    if record is None:
        raise NotOurs(f"{chunks.path}: an MCAP file, but not written by `uwserver run --record FILE`")
    then = record.get("format", "uwserver-recording-1")
    if then != FORMAT:
        made_by = f"uwserver {record.get('uwserver', '(an old version)')}"
        text = f"the recording was made by {made_by} in the format {then}; this version plays {FORMAT}"
        raise NotPlayable(f"{chunks.path}: {text}: play it with that version")
    if SERVED in record:
        text = f"`uwserver record` took it from the server at {record[SERVED]}, without the scenario"
        raise NotOurs(f"{chunks.path}: {text}; `uwserver play` reads it as a log")
    try:
        whole = msgspec.json.decode(record["scenario"])
        left_out = _without_extensions(whole)
        return head_with(record, whole), left_out
    except (KeyError, TypeError, AttributeError, msgspec.DecodeError) as error:
        raise NotPlayable(f"{chunks.path}: the head of the recording is damaged: {error}") from error
    except ValueError as error:  # the scenario fits another version
        raise NotPlayable(f"{chunks.path}: {error}") from error


def _without_extensions(whole: dict[str, Any]) -> tuple[str, ...]:
    """Remove the components of extensions from a scenario; return remarks about that."""
    names = whole["scenario"].pop("extensions", None)
    if not names:
        return ()
    gone: list[str] = []
    whole["scenario"].pop("faults", None)  # they may concern removed components, and playback does not need them
    for vehicle, parts in whole["vehicles"].items():
        gone += _prune(parts["vehicle"], f"vehicles.{vehicle}")
        gone += _prune(whole["scenario"].get("vehicles", {}).get(vehicle, {}), f"vehicles.{vehicle}")
    environment = whole["scenario"].get("environment", {})
    gone += _prune(environment, "environment")
    what = f": {', '.join(dict.fromkeys(gone))} are not drawn" if gone else ""
    return (f"the extensions {', '.join(map(str, names))[:200]} are not opened{what}",)


def _prune(table: dict[str, Any], path: str) -> list[str]:
    """Remove the entries of unknown kinds from the groups of a table; return their paths."""
    known = _known_kinds()
    gone = []
    for group, entries in table.items():
        if isinstance(entries, dict) and group in known:
            kinds = {
                name: entry["kind"] for name, entry in entries.items() if isinstance(entry, dict) and "kind" in entry
            }
            for name in (name for name, kind in kinds.items() if kind not in known[group]):
                del entries[name]
                gone.append(f"{path}.{group}.{name}")
            for entry in entries.values():
                if isinstance(entry, dict):
                    entry.pop("modifiers", None)
    return gone


def _known_kinds() -> Mapping[str, frozenset[str]]:
    """Return the kinds that each group of tables of a vehicle and of an environment may have."""
    known: dict[str, frozenset[str]] = {}
    environment = next(f for f in msgspec.structs.fields(Scenario) if f.name == "environment").type
    for owner in (VehicleFile, environment):
        info = msgspec.inspect.type_info(owner)
        for field in getattr(info, "fields", ()):
            if isinstance(field.type, msgspec.inspect.DictType):
                tags = frozenset(_tags(field.type.value_type))
                if tags:
                    known[field.encode_name] = tags
    return known


def _tags(node: msgspec.inspect.Type) -> list[str]:
    if isinstance(node, msgspec.inspect.StructType):
        return [str(node.tag)] if node.tag_field == "kind" and node.tag is not None else []
    if isinstance(node, msgspec.inspect.UnionType):
        return [tag for each in node.types for tag in _tags(each)]
    return []

"""The format of a recording: an MCAP file that any MCAP tool can plot, and from which `uwserver.recording.replay` can run the world again.

Each port has a channel. Its topic is the path of the port, its messages are JSON, and its JSON schema names units and frames. ``log_time`` is
`t_sent_ns` (for commands: the time at which they act), ``publish_time`` is `t_ns`; both are simulation time. There are further channels:

* ``uwserver/requests``: every command and call that was carried out (`Request`);
* ``uwserver/hashes``: the hash of the whole state, every simulated second and at the end (`StateHash`);
* ``uwserver/events``: the events that all clients received;
* topics that begin with "/", in Foxglove's schemas: see `uwserver.adapter.foxglove`;
* ``uwserver/states``, ``uwserver/casts`` and ``uwserver/jumps``: the poses of all bodies, the list of bodies, and the jumps of time, see
  `uwserver.recording.states`.

Requests and hashes share one running index. It gives their order, also where a reset sets the tick back.
The metadata record ``uwserver`` comes first. It contains versions, seed, timing, and the whole resolved scenario. It also contains the model files
(glTF), so that playback shows them without the files. Their size is limited, and they are checked again when they are read.
"""

from __future__ import annotations

import base64
import hashlib
import logging
import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import msgspec
import zstandard
from msgspec import Struct

from uwserver.physics import PHYSICS
from uwserver.physics.geometry.shapes import BadSolid
from uwserver.ports import Call, Command, Items
from uwserver.scenario.files.convert import NO_MORE, More, convert
from uwserver.scenario.files.errors import KeyPath, dotted
from uwserver.scenario.load.export import engine_named, tables
from uwserver.scenario.load.resolved import Resolved, ResolvedObject, ResolvedVehicle
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.appearance import check_glb
from uwserver.scenario.solids.archive import pack, unpack
from uwserver.scenario.solids.objects import object_params
from uwserver.scenario.vehicle import tracks
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.simulation import clock
from uwserver.simulation.clock import Timing
from uwserver.version import __version__

log = logging.getLogger(__name__)


FORMAT = "uwserver-recording-3"
"""Version of all channels. A replay also depends on the version of the physics, `uwserver.physics.PHYSICS`."""
REPLAYED_FORMATS = ("uwserver-recording-2", FORMAT)
"""The formats that can be replayed: their requests and hashes are the same. Format 2 has no states."""
METADATA = "uwserver"
REQUESTS, HASHES, EVENTS = "uwserver/requests", "uwserver/hashes", "uwserver/events"

_SECRETS = ("token", "password", "secret")

MODEL_FILES = "looks_base64"
"""Key in the metadata record. Earlier recordings have the key `looks` in base 85, which takes seconds and 50 times the memory to decode; they are
played without looks."""
MOST_MODEL_BYTES = 32 << 20
"""Largest total size of the files. If they are larger, the largest files are left out."""


class Request(Struct, frozen=True, omit_defaults=True):
    """A command (`port`, `value`) or a call (`service`, `args`) that was carried out.

    Attributes:
        index: running number over requests and hashes.
        batch: requests with the same number were carried out together; of several commands to one port only the last acted.
        tick: the request was carried out at the start of this tick.
        source: name of the sender.
        value: one entry per field of the port.
    """

    index: int
    batch: int
    tick: int
    source: str
    port: str = ""
    value: Items = ()
    service: str = ""
    args: dict[str, Any] = {}

    @classmethod
    def of(cls, item: Command | Call, index: int, batch: int, tick: int) -> Request:
        """Return the entry for a command or call."""
        if isinstance(item, Command):
            return cls(index, batch, tick, item.source, port=item.port, value=item.value)
        return cls(index, batch, tick, item.source, service=item.service, args=dict(item.args))

    @property
    def item(self) -> Command | Call:
        """Return the command or call."""
        if self.port:
            return Command(self.port, self.value, self.source)
        return Call(self.service, self.args, self.source)


class StateHash(Struct, frozen=True):
    """The hash of the state (`Snapshot.hash`) of the world after `tick`; `index` as in `Request`."""

    index: int
    tick: int
    hash: str


class Versions(Struct, frozen=True):
    """The software on which a run depends, besides its scenario. `started_utc` is the time of the wall clock."""

    uwserver: str
    python: str
    numpy: str
    numba: str
    platform: str
    started_utc: str = ""


class Head(Struct, frozen=True):
    """The metadata record: everything that a replay needs, except the requests."""

    versions: Versions
    seed: int
    timing: dict[str, Any]
    resolved: Resolved


def versions_here() -> Versions:
    """Return the versions of this process."""
    machine = platform.python_version(), version("numpy"), version("numba"), platform.platform()
    return Versions(__version__, *machine, clock.utc_text())


def metadata(resolved: Resolved, seed: int, timing: Timing) -> dict[str, str]:
    """Return the metadata record of a recording. Keys of adapters that contain a token, password or secret are left out."""
    whole = {
        "name": resolved.name,
        "scenario": _without_secrets(tables(engine_named(resolved.scenario), defaults=True)),
        "vehicles": {
            name: {
                "vehicle": tables(vehicle.vehicle, defaults=True),
                "devices": {key: tables(device, defaults=True) for key, device in vehicle.devices.items()},
            }
            for name, vehicle in resolved.vehicles.items()
        },
        "materials": resolved.materials,
    }
    return {
        "format": FORMAT,
        "physics": str(PHYSICS),
        **{key: str(value) for key, value in msgspec.structs.asdict(versions_here()).items()},
        "seed": str(seed),
        "timing": msgspec.json.encode(timing).decode(),
        "scenario": msgspec.json.encode(whole, enc_hook=str).decode(),
        "solids": pack(resolved.solids),
        "tracks": tracks.pack(resolved.tracks),
        **pack_model_files(resolved),
    }


def head_of(record: Mapping[str, str], more: More = NO_MORE) -> Head:
    """Read a metadata record. Adapters stay plain tables.

    Args:
        record: the record.
        more: kinds of the extensions that the scenario uses; their files are not in the recording.

    Raises:
        ValueError: the format or physics is another, or the scenario does not fit this version.
    """
    for name, here in (("format", FORMAT), ("physics", str(PHYSICS))):
        then = record.get(name, "1")
        if then != here and then not in REPLAYED_FORMATS:
            made_by = f"uwserver {record.get('uwserver', '(an old version)')}"
            text = f"the recording was made by {made_by}, whose {name} is {then}; here it is {here}, so the run would be different"
            raise ValueError(f"{text}: replay it with that version. MCAP tools and `uwserver plot` can still read it")
    try:
        whole = msgspec.json.decode(record["scenario"])
        if whole["scenario"].get("extensions") and not more:
            names = ", ".join(whole["scenario"]["extensions"])
            raise ValueError(f"its components come from the extension {names}: give --trust-files, if you trust it")
    except (KeyError, TypeError, ValueError) as error:
        raise _misfit(record, error) from error
    return head_with(record, whole, more)


def head_with(record: Mapping[str, str], whole: dict[str, Any], more: More = NO_MORE) -> Head:
    """Return the head of a metadata record.

    Args:
        record: the record.
        whole: its entry "scenario", decoded; parts may be left out.
        more: kinds of the extensions that the scenario uses.

    Raises:
        ValueError: the scenario does not fit this version.
    """
    try:
        scenario = _typed(whole["scenario"], Scenario, more)
        solids = unpack(record["solids"])
        looks = unpack_model_files(record)
        followed = tracks.unpack(record["tracks"]) if "tracks" in record else {}  # older recordings have no tracks
        vehicles = {
            name: ResolvedVehicle(
                name,
                scenario.vehicles[name],
                _typed(parts["vehicle"], VehicleFile, more),
                msgspec.convert(parts["devices"], dict[str, ThrusterDevice]),
                solids.get(f"vehicles/{name}"),
                looks.get(f"vehicles/{name}", b""),
                ghost=solids.get(f"ghosts/{name}"),
                track=followed.get(name),
            )
            for name, parts in whole["vehicles"].items()
        }
        objects = {
            name: ResolvedObject(
                name,
                entry,
                object_params(entry, scenario.environment),
                solids[f"objects/{name}"],
                looks.get(f"objects/{name}", b""),
            )
            for name, entry in scenario.objects.items()
        }
        static = {name.removeprefix("static/"): solid for name, solid in solids.items() if name.startswith("static/")}
        worn = {name.removeprefix("static/"): data for name, data in looks.items() if name.startswith("static/")}
        materials = tuple(whole["materials"])
        resolved = Resolved(whole["name"], scenario, vehicles, None, (), static, objects, materials, looks=worn)
        versions = msgspec.convert(dict(record), Versions)
        return Head(versions, int(record["seed"]), msgspec.json.decode(record["timing"]), resolved)
    except (KeyError, TypeError, ValueError) as error:
        raise _misfit(record, error) from error


def _misfit(record: Mapping[str, str], error: Exception) -> ValueError:
    made_by = f"uwserver {record.get('uwserver')}"
    return ValueError(f"the scenario in the recording ({made_by}) does not fit uwserver {__version__}: {error}")


def _typed(raw: dict[str, Any], type_: Any, more: More) -> Any:
    if not more:
        return msgspec.convert(raw, type_)

    def fail(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        raise ValueError(f"{dotted(path)}: {text}")

    return convert(raw, type_, (), fail, more)


def _without_secrets(scenario: dict[str, Any]) -> dict[str, Any]:
    adapters = {
        name: {key: value for key, value in table.items() if not any(word in key.lower() for word in _SECRETS)}
        for name, table in scenario.get("adapters", {}).items()
    }
    return {**scenario, "adapters": adapters}


class _Kept(msgspec.Struct):
    """Files by their hash, and the hash of each owner: ``vehicles/rov``, ``objects/crate``, ``static/pile``."""

    files: dict[str, bytes]
    owners: dict[str, str]


def pack_model_files(resolved: Resolved) -> dict[str, str]:
    """Return the entry for the metadata record; empty when there are no files."""
    worn = {f"vehicles/{name}": vehicle.looks for name, vehicle in resolved.vehicles.items()}
    worn |= {f"objects/{name}": body.looks for name, body in resolved.objects.items()}
    worn |= {f"static/{name}": data for name, data in resolved.looks.items()}
    owners = {owner: hashlib.sha256(data).hexdigest() for owner, data in worn.items() if data}
    files = {owners[owner]: data for owner, data in worn.items() if data}
    size, kept = 0, dict[str, bytes]()
    for sha256, data in sorted(files.items(), key=lambda file: (len(file[1]), file[0])):
        size += len(data)
        if size <= MOST_MODEL_BYTES:
            kept[sha256] = data
    if left_out := [owner for owner, sha256 in owners.items() if sha256 not in kept]:
        log.warning(
            "the looks of %s are left out of the recording: all looks together have more than %d bytes",
            ", ".join(left_out),
            MOST_MODEL_BYTES,
        )
    if not kept:
        return {}
    packed = msgspec.msgpack.encode(_Kept(kept, {owner: sha for owner, sha in owners.items() if sha in kept}))
    return {MODEL_FILES: base64.b64encode(zstandard.ZstdCompressor().compress(packed)).decode()}


def unpack_model_files(record: Mapping[str, str]) -> Mapping[str, bytes]:
    """Return the files by their owners, as `pack_model_files` names them, without those that fail the check.

    Raises:
        ValueError: the record was not made by `pack_model_files`.
    """
    if MODEL_FILES not in record:
        return {}
    try:
        packed = base64.b64decode(record[MODEL_FILES], validate=True)
        most = 2 * MOST_MODEL_BYTES
        if zstandard.frame_content_size(packed) > most:
            raise ValueError(f"looks of more than {most} bytes")
        kept = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed, max_output_size=most), type=_Kept)
    except (zstandard.ZstdError, ValueError) as error:  # msgspec's errors are ValueErrors
        raise ValueError(f"the looks cannot be read: {error}") from error
    fine = {sha256: data for sha256, data in kept.files.items() if _is_fine(data)}
    return {owner: fine[sha256] for owner, sha256 in kept.owners.items() if sha256 in fine}


def _is_fine(data: bytes) -> bool:
    try:
        check_glb(data)
    except BadSolid as error:
        log.warning("looks in the recording are not shown: %s", error)
        return False
    return True

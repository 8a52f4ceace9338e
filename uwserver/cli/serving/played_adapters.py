"""Decides which adapters of a recording `uwserver play` serves. A file must not decide what its reader's machine does on the network."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from uwserver.adapter.listening import is_loopback
from uwserver.cli.loading import with_changes

if TYPE_CHECKING:
    from uwserver.scenario.load.resolved import Resolved

log = logging.getLogger(__name__)

SERVERS = (
    "sockets", "web", "foxglove", "rosbridge", "moosdb", "moos_text", "morse", "player", "video", "devices", "ros2", "zenoh",
)  # fmt: skip
"""Kinds that listen at one address and connect to nobody unless their table says so."""
CALLERS = ("ros1", "yarp", "moos", "mavlink")
"""Kinds that connect to a peer. They may do so if the peer is at its usual address on this machine."""
IN_THE_LOOP = ("ardupilot_json", "px4_hil")
"""Kinds for autopilots that fly the vehicle. Nobody can fly the vehicle of a recording."""
_REACHING = ("allow_network", "connect", "scouting", "discovery", "transport", "ardupilot", "name_server", "host")
"""Keys of those kinds by which a table reaches other machines."""
_ALLOWING = ("allowed_origins", "allowed_hosts", "frame_ancestors")
"""Keys by which a table lets web pages and host names in."""
_OF_FILES = (
    "alog", "tlog", "serial", "config_file", "config", "tls_cert", "tls_key", "tls_client_ca", "path", "folder", "file", "device",
)  # fmt: skip
"""Keys by which an adapter would open a file or a device."""
_LOCALHOST = r"(127\.0\.0\.1|localhost|\[::1\])"
_HERE = re.compile(rf"tcp/{_LOCALHOST}:\d{{1,5}}")
_GROUND_STATION = re.compile(rf"(udpin|tcpin):{_LOCALHOST}:\d{{1,5}}|udpout:{_LOCALHOST}:145[56]\d")
"""MAVLink links that listen, or that send to the ports at which ground stations listen."""
_VIEWER = re.compile(rf"{_LOCALHOST}:(56\d\d|145[56]\d)")
"""Addresses at which ground stations expect video and MAVLink."""
_PLOTTER = re.compile(rf"{_LOCALHOST}:101[0-2]\d")
"""Addresses at which chart plotters expect NMEA 0183."""
_LISTENING_LINK = re.compile(r"^((?:udpin|tcpin):.*):\d+$")
_MOOSDB_PORTS = range(9000, 9100)
_MASTER = "http://127.0.0.1:11311"
_LOOPBACK = "127.0.0.1"
_FREE_ENDPOINT = f"tcp/{_LOOPBACK}:0"


def with_played_adapters(
    resolved: Resolved, known: Mapping[str, type[Any]], port: int | None, chosen: Collection[str] = ()
) -> Resolved:
    """Return the scenario of a recording with the adapters that may serve it, as configurations of their own types.

    An adapter that is not in `chosen` listens on this machine only, and connects only to peers at their usual addresses on this machine. It
    is left out, with a warning, if it would reach further. An adapter is never served if it would open a file or a device, if it set the pace
    of the world, or if it is for an autopilot in the loop.

    Args:
        resolved: scenario of the recording, whose adapters are plain tables.
        known: configuration types of adapters by kind.
        port: 0 gives all adapters free ports.
        chosen: names of adapters that may do all that their table says.

    Raises:
        ValueError: the recording has no adapter with a name in `chosen`.
    """
    world, tables, configs = resolved.scenario.world, resolved.scenario.adapters, {}
    for name in chosen:
        if name not in tables:
            raise ValueError(f'the recording has no adapter "{name}"; there are: {", ".join(tables) or "none"}')
    for name, table in tables.items():
        try:
            config = _config(table, known)
            if (getattr(config, "client", None) or name) in world.clock.lockstep_clients:
                raise ValueError("it sets the pace of a world, and a recording has its own")
            configs[name] = config if name in chosen else _local(config)
        except (ValueError, TypeError, AttributeError) as error:
            log.warning('adapter "%s" of the recording is left out: %s', name, error)
    if not configs and "sockets" in known:
        configs["sockets"] = known["sockets"]()
    here: dict[str, Any] = {"metrics_bind": _LOOPBACK, "allowed_hosts": ()}
    # The server that was recorded may still run on this machine.
    if port == 0:
        configs = {name: _with_free_ports(config) for name, config in configs.items()}
        here["metrics_port"] = 0
    return with_changes(resolved, adapters=configs, server=msgspec.structs.replace(resolved.scenario.server, **here))


def _config(table: Any, known: Mapping[str, type[Any]]) -> Any:
    """Return the configuration of an adapter from its table in a recording.

    Raises:
        ValueError: the adapter is not installed, or the table names files or does not fit the adapter.
    """
    kind = table.get("kind")
    if kind not in known:
        raise ValueError(f"no adapter of kind {str(kind)[:40]!r} is installed")
    if kind in IN_THE_LOOP:
        raise ValueError("it is for an autopilot that flies the vehicle, and a recording flies by itself")
    if named := sorted(_named(table)):
        raise ValueError(f"it names files or devices ({', '.join(named)}), which a recording does not open")
    return msgspec.convert(table, known[kind])


def _named(table: Any) -> set[str]:
    """Return the keys that name files or devices, in a table and in all tables within it."""
    if isinstance(table, list | tuple):
        return set().union(*map(_named, table))
    if not isinstance(table, Mapping):
        return set()
    # The key `device` of the devices adapter holds a table for each device, and is no file.
    keys = {key for key in _OF_FILES if table.get(key) and not (key == "device" and isinstance(table[key], Mapping))}
    links = table.get("links")
    if isinstance(links, list | tuple) and any(isinstance(link, str) and link.startswith("serial:") for link in links):
        keys.add("links")
    return keys.union(*map(_named, table.values()))


def _local(config: Any) -> Any:
    """Return the configuration of an adapter that listens on this machine only, and lets in only those that its kind lets in by default.

    Raises:
        ValueError: the adapter would reach further.
    """
    hint = "--adapter with its name serves it"
    kind = config.__struct_config__.tag
    if kind not in (*SERVERS, *CALLERS):
        raise ValueError(f"it may speak to addresses that the recording names: {hint}")
    usual = {f.name: f.default for f in msgspec.structs.fields(config)}
    reaching = [key for key in _REACHING if key in usual and getattr(config, key) != usual[key]]
    if not all(_HERE.fullmatch(endpoint) for endpoint in getattr(config, "listen", None) or ()):
        reaching.append("listen")
    reaching += _called(kind, config)
    if reaching:
        raise ValueError(f"it would reach other machines, or unusual ports of this one ({', '.join(reaching)}): {hint}")
    changes = {key: usual[key] for key in _ALLOWING if key in usual}
    if "bind" in usual:
        changes["bind"] = _LOOPBACK
    if kind == "ros1":
        # Without it the adapter would take the master of the environment, which may be that of a robot.
        changes["master"] = _MASTER
    if kind == "devices":
        changes["device"] = {
            name: msgspec.structs.replace(table, bind=_LOOPBACK) for name, table in config.device.items()
        }
    return msgspec.structs.replace(config, **changes)


def _called(kind: str, config: Any) -> list[str]:
    """Return the keys of a table that name a peer which is not at its usual address on this machine."""
    match kind:
        case "ros1":
            return ["master"] if config.master not in (None, _MASTER, _MASTER.replace(_LOOPBACK, "localhost")) else []
        case "moos":
            return [
                f"communities.{name}"
                for name, table in config.communities.items()
                if not (is_loopback(table.host) and table.port in _MOOSDB_PORTS)
            ]
        case "mavlink":
            return [] if all(map(_GROUND_STATION.fullmatch, config.links)) else ["links"]
        case "video":
            odd = [name for name, table in config.streams.items() if not all(map(_VIEWER.fullmatch, table.targets))]
            return [f"streams.{name}.rtp" for name in odd] + ["mavlink"] * (
                not all(map(_VIEWER.fullmatch, config.mavlink))
            )
        case "devices":
            odd = [name for name, table in config.device.items() if not all(map(_PLOTTER.fullmatch, table.udp_to))]
            return [f"device.{name}.udp_to" for name in odd]
    return []


def _with_free_ports(config: Any) -> Any:
    """Return the configuration of an adapter with every port on which it listens set to a free one."""
    names = {f.name for f in msgspec.structs.fields(config)}
    changes: dict[str, Any] = {
        n: 0 for n in names if n.rpartition("_")[2] == "port" and isinstance(getattr(config, n), int)
    }
    if "listen" in names and not (config.listen is None and config.mode == "client"):
        changes["listen"] = (_FREE_ENDPOINT,)
    match config.__struct_config__.tag:
        case "devices":
            changes["device"] = {name: _with_free_ports(table) for name, table in config.device.items()}
        case "mavlink":
            changes["links"] = tuple(_LISTENING_LINK.sub(r"\1:0", link) for link in config.links)
    return msgspec.structs.replace(config, **changes)

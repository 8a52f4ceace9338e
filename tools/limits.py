"""Makes the page of all limits from the constants in the code and the defaults of settings; `reference_docs.py` writes it."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
from uwserver_adapters.mavlink.wire import channel, json_form
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.bridge import calls
from uwserver_adapters.moos.config import MoosDbConfig, MoosTextConfig
from uwserver_adapters.moos.db import database, guests, variable
from uwserver_adapters.moos.text import lines
from uwserver_adapters.morse import connections, grammar
from uwserver_adapters.morse.config import MorseConfig
from uwserver_adapters.native import fanout
from uwserver_adapters.player import wire as player_wire
from uwserver_adapters.player.adapter import PlayerConfig
from uwserver_adapters.px4 import door
from uwserver_adapters.ros import parameters as ros_parameters
from uwserver_adapters.ros.messages import plain as ros_plain
from uwserver_adapters.ros.messages import types as ros_types
from uwserver_adapters.ros1 import node, xmlrpc
from uwserver_adapters.ros1 import peers as ros1_peers
from uwserver_adapters.ros1 import wire as tcpros
from uwserver_adapters.ros1.config import Ros1Config
from uwserver_adapters.ros2 import actions as ros2_actions
from uwserver_adapters.ros2 import rmw_zenoh
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.rosbridge import hub as rosbridge_hub
from uwserver_adapters.rosbridge import session as rosbridge_session
from uwserver_adapters.rosbridge import subscriptions as rosbridge_subscriptions
from uwserver_adapters.rosbridge import wishes
from uwserver_adapters.rosbridge.config import RosbridgeConfig
from uwserver_adapters.sockets import connection as sockets_connection
from uwserver_adapters.sockets import datagrams
from uwserver_adapters.sockets.connection import SocketsConfig
from uwserver_adapters.video import announcer, rtsp
from uwserver_adapters.video import connection as video_connection
from uwserver_adapters.video import datagrams as video_datagrams
from uwserver_adapters.video import stream as video_stream
from uwserver_adapters.video.config import VideoConfig
from uwserver_adapters.yarp import adapter as yarp_adapter
from uwserver_adapters.yarp import bottle, links
from uwserver_adapters.yarp import wire as yarp_wire
from uwserver_adapters.yarp.config import YarpConfig

from uwserver.adapter import accepting, base, bounds, connection, conversation, peers
from uwserver.recording import reading, recorder
from uwserver.scenario.files import documents, locate
from uwserver.scenario.load import checks, scenario
from uwserver.scenario.load.tables import Server
from uwserver.scenario.solids import archive, assets, bathymetry, memory
from uwserver.server import adapters, http, life_cycle, profiling, recordings, state_files
from uwserver.simulation import bus, intake, mailbox, thread
from uwserver.units import NANOSECONDS
from uwserver.world.state import saving, services, snapshot

HEAD = """\
# Limits

This table lists every size, count, rate and deadline that bounds input from outside, and what happens beyond it. A name in the third column
is a setting of the [scenario](scenario.md); a number without a name is fixed. These pages explain the limits:
[protocol](protocol.md#limits), [security](../explanation/security.md), [record and replay](../how-to/record.md).

| limit of | what | limit | beyond it |
|---|---|---|---|
"""

Row = tuple[str, str, str]


def limits_page() -> str:
    """Return the page below its first line."""
    groups = {
        "a file": _files(),
        "a recording": _recordings(),
        "a saved state": _states(),
        "a message of any adapter": _messages(),
        "a client of `sockets`": _clients(),
        "a UDP client of `sockets`": _datagrams(),
        "strangers at any TCP port": _strangers(),
        "the world": _world(),
        "MOOS": _moos(),
        "MORSE": _morse(),
        "MAVLink, PX4": _mavlink(),
        "any ROS": _ros(),
        "ROS 1": _ros1(),
        "ROS 2": _ros2(),
        "rosbridge": _rosbridge(),
        "YARP": _yarp(),
        "Player": _player(),
        "video": _video(),
        "`/health`, `/metrics`": _health(),
        "start and end": _life(),
    }
    rows = [f"| {group} | {' | '.join(row)} |" for group, found in groups.items() for row in found]
    return HEAD + "\n".join(rows) + "\n"


def _files() -> Iterator[Row]:
    refused = "not loaded; the error says where, what is wrong and what to do"
    yield "any file", "must be a plain file: no folder, pipe, device or socket", refused
    yield "scenario, vehicle or device (TOML), Python extension", _bytes(documents.MOST_BYTES), refused
    yield "parts of a dotted key or header", str(locate.MOST_PARTS), refused
    yield "vehicles, copies counted, and objects", str(checks.MOST_BODIES), refused + "; `world/spawn`: `busy`"
    yield "structures", str(checks.MOST_STRUCTURES), refused
    yield "sensors, their streams and modifiers, actuators, of all vehicles", str(checks.MOST_COMPONENTS), refused
    yield "mistakes that are reported", str(scenario.MOST_PROBLEMS), "the rest is not checked"
    yield "extensions", "must be in the scenario's folder or below, links followed", "not run"
    yield "mesh (STL, OBJ, PLY, glTF with all its files)", _bytes(assets.MOST_BYTES), refused
    yield "triangles of a mesh", f"{assets.MOST_TRIANGLES}", refused
    yield (
        "points of a grid, after `extent_m`; points of an axis, or of a chunk, of NetCDF 4",
        f"{bathymetry.MOST_POINTS}",
        refused,
    )
    triangles = f"{memory.TRIANGLE_BYTES} bytes each, {memory.RESERVE_BYTES // 1_000_000} MB for the rest"
    yield f"free memory, from {memory.FEW_TRIANGLES} triangles of seabed and structures on", triangles, refused
    yield "classic NetCDF file", _bytes(bathymetry.MOST_BYTES), refused


def _recordings() -> Iterator[Row]:
    yield (
        "samples that wait for the disk",
        f"{recorder.MAX_SAMPLES}",
        "real time: dropped and counted; else the tick waits",
    )
    yield (
        "commands and calls that wait for the disk",
        f"{recorder.MAX_REQUESTS}",
        "the recording ends, the world goes on",
    )
    yield (
        "data that a killed server loses",
        f"{recorder.CHUNK_NS / NANOSECONDS:g} s, and the data that wait for the disk",
        "",
    )
    yield (
        "wall time in which the disk must answer at the end",
        f"{recorder.CLOSE_TIMEOUT_S:g} s",
        "the file has no end; a message says so, exit status 1",
    )
    yield "recordings in `recordings`", str(recordings.MAX_FILES), "`busy`"
    yield "requests about recordings that wait", str(recordings.MAX_WAITING), "`busy`"
    yield (
        "bytes of all of them",
        _setting(Server, "recordings_mb", " MB"),
        "`busy`; the present recording ends complete",
    )
    yield "free space on their disk", _bytes(recordings.RESERVE_BYTES), "`busy`; the present recording ends complete"
    yield "a record in a replay", _bytes(reading.MOST_RECORD_BYTES), "damaged"
    yield "a chunk, unpacked", _bytes(reading.MOST_CHUNK_BYTES), "damaged"
    yield "its seabed and structures, unpacked", _bytes(archive.LARGEST_BYTES), "not replayed"


def _states() -> Iterator[Row]:
    yield "size", _bytes(snapshot.MAX_BYTES), "`out_of_range`"
    yield "parts", str(snapshot.MAX_PARTS), "refused"
    yield "states that are sent or received in pieces", str(saving.MAX_KEPT), "the oldest is forgotten"
    yield "files in `state_folder`", str(state_files.MAX_FILES), "`busy`"
    yield (
        "snapshots in memory",
        f"{services.MAX_SNAPSHOTS}, names of {services.MAX_SNAPSHOT_NAME} characters",
        "`busy`, `out_of_range`",
    )


def _messages() -> Iterator[Row]:
    yield "bytes", _bytes(bounds.MESSAGE_LIMIT), "`too_large`"
    yield f"plain texts (ASCII, from {bounds.PLAIN_TEXT} bytes on)", _bytes(bounds.MAX_PLAIN), "`too_large`"
    yield "binary values of msgpack", _bytes(bounds.MAX_BINARY), "`too_large`"
    long = f"JSON with more than {bounds.FEW} numbers that have an exponent or {bounds.LONG_NUMBER} digits"
    huge = f"{_bytes(bounds.LONG_NUMBERS_LIMIT)}; {_bytes(bounds.HUGE_LIMIT)} if more than {bounds.FEW} have an exponent of three digits"
    yield long, huge, "`too_large`"
    yield "digits of a number, if there are more such numbers", str(bounds.MAX_DIGITS), "`invalid_request`"
    yield "maps and lists", f"{bounds.MAX_CONTAINERS}, {bounds.MAX_DEPTH} deep", "`invalid_request`"
    yield "values, keys included", str(bounds.MAX_VALUES), "`invalid_request`"
    yield "texts in JSON", str(bounds.MAX_TEXTS), "`invalid_request`"
    yield "names, patterns, ids", f"{base.WORD_LIMIT} characters", "`bad_argument`, `invalid_request`"
    yield "unanswered commands and calls of a peer", str(conversation.UNANSWERED), "`overload`"
    yield "a turn, and the rest before the next", f"{_ms(connection.TURN_S)}, {_ms(connection.REST_S)}", "read later"


def _clients() -> Iterator[Row]:
    yield "requests a second", _setting(SocketsConfig, "max_requests_per_s"), "`overload`, then not read"
    yield "subscriptions", _setting(SocketsConfig, "max_subscriptions"), "`overload`"
    covered = f"{fanout.COVERED}, or twice all ports if that is more; each port counts for each subscription"
    yield "ports that its subscriptions cover", covered, "`overload`"
    yield "unanswered commands and calls", _setting(SocketsConfig, "max_unanswered"), "`overload`"
    yield (
        "unread samples of one kind of delivery",
        _setting(SocketsConfig, "queue_samples"),
        "the oldest dropped; `reliable`: disconnected",
    )
    yield "unread bytes", _setting(SocketsConfig, "queue_bytes"), "the oldest sample dropped; replies: disconnected"
    yield "clients", _setting(SocketsConfig, "max_clients"), "`overload`, disconnected"
    yield "clients of one other host", _setting(SocketsConfig, "max_clients_per_host"), "`overload`, disconnected"
    yield (
        "messages before a valid `hello`",
        f"{sockets_connection.TRIES}, of {_bytes(bounds.STRANGER_LIMIT)}",
        "disconnected",
    )
    yield (
        "wall time for the first valid message, and for the TLS handshake before it",
        _setting(SocketsConfig, "hello_timeout_s", " s"),
        "disconnected",
    )


def _datagrams() -> Iterator[Row]:
    yield "a datagram", _bytes(datagrams.DATAGRAM_LIMIT), "`too_large`"
    yield "a datagram without a session", _bytes(datagrams.STRANGER_LIMIT), "not read"
    yield "datagrams of all addresses without a session", f"{datagrams.STRANGERS_PER_S} a second", "not read"
    yield "silence", _setting(SocketsConfig, "udp_lease_s", " s"), "forgotten"


def _strangers() -> Iterator[Row]:
    yield (
        "connections without a valid message",
        f"{peers.STRANGERS}; `sockets`: {_setting(SocketsConfig, 'max_strangers')}",
        "the oldest of the host with most is closed",
    )
    yield "connections that the system queues before they are accepted", str(accepting.BACKLOG), "refused by the system"
    yield "TLS handshake", f"{accepting.HANDSHAKE_S:g} s", "disconnected"
    yield (
        "no file descriptors left",
        f"connections are accepted again after {accepting.PAUSE_S:g} s",
        "new connections wait",
    )
    yield "a log message of one cause", f"once in {base.TELL_S:g} s", "counted"


def _world() -> Iterator[Row]:
    waiting = (
        f"{mailbox.MAX_WAITING} of a client, {mailbox.MAX_WAITING_OF_ALL} of all, but {mailbox.FREE_PLACES} of each"
    )
    yield "commands and calls that wait for their tick", waiting, "`overload`"
    size = (
        f"{_bytes(mailbox.MAX_BYTES)} of a client, {_bytes(mailbox.MAX_BYTES_OF_ALL)} of all, but one request of each"
    )
    yield "their bytes; decoded lists and maps count four times", size, "`overload`"
    yield "steps and runs under way", str(thread.MAX_GOALS), "`overload`"
    yield "profiles at the same time", str(profiling.MAX_MEASUREMENTS), "`overload`"
    spent = f"{_ms(intake.REQUESTS_NS / NANOSECONDS)} for commands and calls, {_ms(thread.STEERING_NS / NANOSECONDS)} for the clock"
    yield "wall time for requests in a tick, in real time", spent, "the rest waits for the next tick"
    ahead = f"real time: {bus.MAX_TICKS} ticks; else {_ms(bus.AHEAD_NS / NANOSECONDS)} of their work"
    yield "samples on their way to the adapters", ahead, "real time: dropped and counted; else the world waits"


def _moos() -> Iterator[Row]:
    yield "a packet, its messages", f"{_bytes(wire.PACKET_LIMIT)}, {wire.MESSAGES_LIMIT}", "disconnected"
    yield "names and other short texts, a text", f"{wire.NAMES_LIMIT}, {wire.TEXT_LIMIT} bytes", "refused unread"
    yield "open calls, and how long", f"{calls.OPEN}, {calls.TIMEOUT_S:g} s", "refused"
    yield "`moosdb`: clients", _setting(MoosDbConfig, "max_clients"), "disconnected"
    yield (
        "`moosdb`: time to send a name; length of the name",
        f"{guests.NAME_S:g} s; {guests.CLIENT_NAME_LIMIT}",
        "disconnected",
    )
    yield "`moosdb`: kept mail, filters of a client", f"{_bytes(database.KEPT_BYTES)}, {database.FILTERS}", "refused"
    stars = f"{database.FILTERS_OF_ALL}: each counts 1 and for each `*` 1, with a `?` {variable.MARKED}"
    yield "`moosdb`: filters of all clients", stars, "refused"
    yield "`moosdb`: variables in a summary, and variables of each client", str(database.LISTED), "left out"
    yield "`moos_text`: clients", _setting(MoosTextConfig, "max_clients"), "disconnected"
    yield "`moos_text`: a line, its pairs", f"{_bytes(lines.LINE_LIMIT)}, {lines.PAIRS}", "an error line"


def _morse() -> Iterator[Row]:
    yield "clients, of requests and streams", _setting(MorseConfig, "max_clients"), "disconnected"
    yield "requests, or lines of a stream, in a second", _setting(MorseConfig, "max_requests_per_s"), "refused"
    yield "calls of a client that wait", _setting(MorseConfig, "max_unanswered"), "refused"
    yield (
        "a request; a line of a stream",
        f"{_bytes(grammar.LINE_LIMIT)}; {_bytes(connections.STREAM_LINE)}",
        "refused, skipped",
    )
    yield (
        "data that wait for a slow client",
        _setting(MorseConfig, "queue_bytes"),
        "samples are left out; answers: disconnected",
    )


def _mavlink() -> Iterator[Row]:
    yield "downloads under way on a channel", str(channel.BACKLOG), "the oldest ends"
    yield "a call in JSON", _bytes(json_form.LONGEST), "refused"
    yield "`px4_hil`: strangers, and their time", f"{door.GUESTS}, {door.GREETING_S:g} s", "disconnected"


def _ros() -> Iterator[Row]:
    longest = f"{_bytes(bounds.MESSAGE_LIMIT)}; {_bytes(ros_types.ARRAY_LIMIT)} if only arrays of numbers have no bound"
    yield "a message with a command", longest, "refused"
    yield "items of a list of messages or texts", str(ros_plain.LONGEST), "refused"
    yield "parameters of one request", str(ros_parameters.AT_ONCE), "the rest is refused, each with a reason"
    yield (
        "entities: vehicles, copies counted, and objects",
        str(checks.MOST_BODIES),
        "refused, with a result that says so",
    )


def _ros2() -> Iterator[Row]:
    yield "commands and calls that wait", _setting(Ros2Config, "queue_requests"), "dropped and counted"
    yield "unfinished goals of an action", str(ros2_actions.GOALS), "rejected"
    yield "ended goals that are remembered", str(ros2_actions.GOALS), "the oldest is forgotten"
    yield "clients that wait for the result of a goal", str(ros2_actions.WAITERS), "an empty result of unknown status"
    yield "tokens of other nodes that are remembered, over zenoh", str(rmw_zenoh.NODES), "the rest is not remembered"


def _rosbridge() -> Iterator[Row]:
    yield "clients", _setting(RosbridgeConfig, "max_clients"), "disconnected"
    yield "messages of a client in a second", _setting(RosbridgeConfig, "max_requests_per_s"), "refused"
    yield (
        "subscriptions of a client; its advertisements; its services; its actions",
        _setting(RosbridgeConfig, "max_subscriptions"),
        "refused",
    )
    yield (
        "commands, calls and goals of a client that wait; goals that wait for it",
        _setting(RosbridgeConfig, "max_unanswered"),
        "refused",
    )
    yield "topics that clients advertise, all together", str(rosbridge_hub.TOPICS), "refused"
    yield "a name, a type", f"{wishes.LONGEST_NAME} characters", "refused"
    yield "`queue_length`", str(rosbridge_subscriptions.LONGEST_QUEUE), "this length is used"
    yield "`fragment_size`", f"at least {wishes.LEAST_PIECE} bytes", "this size is used"
    yield "time in which a client answers a call of its service", f"{rosbridge_session.ANSWER_S:g} s", "failed"
    waiting = f"{_setting(RosbridgeConfig, 'queue_samples')}; {_setting(RosbridgeConfig, 'queue_bytes')}"
    yield "data that wait for a slow client", waiting, "messages are left out"


def _ros1() -> Iterator[Row]:
    yield "subscribers, service clients and callers", _setting(Ros1Config, "max_clients"), "disconnected"
    yield "a header, its fields", f"{_bytes(tcpros.HEADER_LIMIT)}, {tcpros.FIELDS}", "an `error` header, disconnected"
    yield "a message; calls that come before their answer", _bytes(tcpros.MESSAGE_LIMIT), "disconnected"
    rate = _setting(Ros1Config, "max_requests_per_s")
    yield "messages of a publisher, or calls of a client, in a second", rate, "not read; refused"
    yield "data that wait for a slow subscriber", _setting(Ros1Config, "queue_bytes"), "messages are left out"
    yield "calls of the API by one caller in a second", str(ros1_peers.CALLS_PER_S), "not read until the second is over"
    http = f"{_bytes(xmlrpc.HEAD_LIMIT)}, {_bytes(xmlrpc.BODY_LIMIT)}"
    yield "a head of a call of the API, its body", http, "4xx, disconnected"
    yield "publishers of a topic", str(node.PUBLISHERS), "the rest is ignored"
    yield "time in which the master, or a publisher, answers", f"{node.CALL_S:g} s", "tried again"


def _yarp() -> Iterator[Row]:
    yield "incoming and outgoing connections", _setting(YarpConfig, "max_clients"), "disconnected; not made"
    yield "a binary message, a line, a sender's name", (
        f"{_bytes(yarp_wire.MESSAGE_LIMIT)}, {_bytes(yarp_wire.LINE_LIMIT)}, {_bytes(yarp_wire.NAME_LIMIT)}"
    ), "disconnected"  # fmt: skip
    yield "items of a bottle, lists within lists", f"{bottle.ITEMS}, {bottle.DEPTH}", "refused"
    yield "the texts of a bottle", _bytes(bottle.TEXTS), "refused"
    yield "a blob in text", _bytes(bottle.TEXT_BLOB), "empty; binary carriers send it"
    rate = _setting(YarpConfig, "max_requests_per_s")
    yield "messages of a peer in a second", rate, "refused, not read until the second is over"
    yield "data that wait for a slow reader", _setting(YarpConfig, "queue_bytes"), "samples are left out"
    yield "connections that are being made", str(yarp_adapter.LINKS), "refused"
    server = f"{links.ANSWER_S:g} s, {_bytes(links.ANSWER_LIMIT)}"
    yield "an answer of the name server, or of a port that is connected", server, "tried again; refused"


def _player() -> Iterator[Row]:
    yield "clients", _setting(PlayerConfig, "max_clients"), "disconnected"
    yield "a message", _bytes(player_wire.MESSAGE_LIMIT), "disconnected"
    rate = _setting(PlayerConfig, "max_requests_per_s")
    yield "messages of a client in a second", rate, "refused, not read until the second is over"
    yield (
        "data that wait for a slow client",
        _setting(PlayerConfig, "queue_bytes"),
        "data are left out; answers: disconnected",
    )


def _video() -> Iterator[Row]:
    yield (
        "RTSP clients; those of one host",
        f"{_setting(VideoConfig, 'max_clients')}; {_setting(VideoConfig, 'max_clients_per_host')}",
        "453, disconnected",
    )
    yield "a head of a request, its body", f"{_bytes(rtsp.HEAD_LIMIT)}, {_bytes(rtsp.BODY_LIMIT)}", "4xx, disconnected"
    yield "requests of a client in a second", str(video_connection.REQUESTS_PER_S), "not read until the second is over"
    yield (
        "silence of a client that gets pictures; by TCP it also does not read",
        _setting(VideoConfig, "keep_alive_s", " s"),
        "its pictures end, disconnected",
    )
    yield "silence of a client that gets no pictures", f"{video_connection.IDLE_S:g} s", "disconnected"
    yield (
        "data that wait for a slow client",
        _setting(VideoConfig, "queue_bytes"),
        "pictures are left out up to the next key picture",
    )
    yield "pictures under way to one address by UDP", str(video_datagrams.WAITING), "left out, counted"
    yield "pictures that wait for an encoder", str(video_stream.WAITING), "left out, counted"
    yield "key pictures for new clients", f"one each {video_stream.FORCE_S:g} s", "they wait for the next"
    yield "commands of a ground station to cameras in a second", str(announcer.COMMANDS_PER_S), "dropped"


def _health() -> Iterator[Row]:
    yield "connections", str(http.MOST_PEERS), "the oldest is closed"
    yield "a request, and its time", f"{_bytes(http.HEAD_LIMIT)}, {http.REQUEST_TIMEOUT_S:g} s", "4xx, disconnected"


def _life() -> Iterator[Row]:
    yield (
        "a start without progress",
        f"{adapters.START_TIMEOUT_S:g} s",
        "the server ends and says what it waited for",
    )
    yield (
        "processor time of the present tick at the end",
        f"{life_cycle.STOP_WORK_NS / NANOSECONDS:g} s",
        "cut off; exit status 1 if it records",
    )
    yield "processor time from SIGTERM to the end", "2 s", "(tested)"


def _setting(config: type[msgspec.Struct], name: str, unit: str = "") -> str:
    default = next(field.default for field in msgspec.structs.fields(config) if field.name == name)
    shown = (
        _bytes(default) if name.endswith("_bytes") else f"{default:g}" if isinstance(default, float) else str(default)
    )
    return f"`{name}`, {shown}{unit}"


def _bytes(count: int) -> str:
    """Return a size in KiB, MiB or GiB if it is a multiple of one, else in MB or bytes."""
    for size, unit in ((1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")):
        if count % size == 0:
            return f"{count // size} {unit}"
    return f"{count // 1_000_000} MB" if count % 1_000_000 == 0 else f"{count} bytes"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:g} ms"

"""What an adapter may use of uwserver: the contract, how adapters are found, and a kit of what all adapters need."""

from __future__ import annotations

from uwserver.adapter.accepting import NO_DESCRIPTORS, TcpListener, note_no_descriptors, serve_tcp
from uwserver.adapter.access import (
    LOCKOUT_S,
    TOKEN_VARIABLE,
    WRONG_TOKENS,
    Lockout,
    NodeTable,
    OpenTable,
    Token,
    TokenTable,
    known_token,
    new_token,
    tls_context,
    token_for,
)
from uwserver.adapter.base import AdapterBase
from uwserver.adapter.bounds import MESSAGE_LIMIT, STRANGER_LIMIT
from uwserver.adapter.connection import HIGH_WATER, LINGER_S, TURN_S, Connection
from uwserver.adapter.contract import (
    ENTRY_POINT_GROUP,
    Adapter,
    AdapterContext,
    AdapterNotFound,
    AdapterStats,
    AdapterTable,
    Driver,
    Order,
    Subscriber,
    adapter_entries,
    installed_adapters,
    load_adapter,
)
from uwserver.adapter.conversation import UNANSWERED, Conversation, InFlightLimit, OnAnswer
from uwserver.adapter.foreign import REFUSALS, FirstBytes, http_answer
from uwserver.adapter.framing import EncodingName, Frames, Lines, TooLong, Undecodable, decode, frame, line
from uwserver.adapter.limits import RateMeter, TurnTimes, within
from uwserver.adapter.listening import (
    CannotListen,
    address_text,
    bound_socket,
    cannot_listen,
    host_here,
    host_name,
    is_host_known,
    is_loopback,
    may_connect,
    serving,
)
from uwserver.adapter.log_file import LogFile
from uwserver.adapter.peers import STRANGERS, Peer, Peers, host_of
from uwserver.adapter.readings import (
    Reading,
    Readings,
    field_of,
    port_of,
    port_of_kind,
    vehicle_of,
    vehicles_of,
)
from uwserver.adapter.refusals import CannotServe, Refusals, did_you_mean
from uwserver.adapter.salvage import json_member, msgpack_member
from uwserver.adapter.serial_port import SerialPort
from uwserver.adapter.threads import Inbox, InOrder, Worker
from uwserver.adapter.turns import BackgroundWork, DatagramTurns, InputTurns
from uwserver.adapter.values import SampleForm, in_pieces, raw_field
from uwserver.adapter.world import VehicleFacts, WorldFacts
from uwserver.modifiers.choosing import NOBODY, NOT_BEGUN, UNKNOWN, NotMet, choose
from uwserver.ports.decimation import Decimation, Decimations
from uwserver.ports.sample_batch import Origin, SampleBatch

__all__ = [
    "ENTRY_POINT_GROUP",
    "HIGH_WATER",
    "LINGER_S",
    "LOCKOUT_S",
    "MESSAGE_LIMIT",
    "NOBODY",
    "NOT_BEGUN",
    "NO_DESCRIPTORS",
    "REFUSALS",
    "STRANGERS",
    "STRANGER_LIMIT",
    "TOKEN_VARIABLE",
    "TURN_S",
    "UNANSWERED",
    "UNKNOWN",
    "WRONG_TOKENS",
    "Adapter",
    "AdapterBase",
    "AdapterContext",
    "AdapterNotFound",
    "AdapterStats",
    "AdapterTable",
    "BackgroundWork",
    "CannotListen",
    "CannotServe",
    "Connection",
    "Conversation",
    "DatagramTurns",
    "Decimation",
    "Decimations",
    "Driver",
    "EncodingName",
    "FirstBytes",
    "Frames",
    "InFlightLimit",
    "InOrder",
    "Inbox",
    "InputTurns",
    "Lines",
    "Lockout",
    "LogFile",
    "NodeTable",
    "NotMet",
    "OnAnswer",
    "OpenTable",
    "Order",
    "Origin",
    "Peer",
    "Peers",
    "RateMeter",
    "Reading",
    "Readings",
    "Refusals",
    "SampleBatch",
    "SampleForm",
    "SerialPort",
    "Subscriber",
    "TcpListener",
    "Token",
    "TokenTable",
    "TooLong",
    "TurnTimes",
    "Undecodable",
    "VehicleFacts",
    "Worker",
    "WorldFacts",
    "adapter_entries",
    "address_text",
    "bound_socket",
    "cannot_listen",
    "choose",
    "decode",
    "did_you_mean",
    "field_of",
    "frame",
    "host_here",
    "host_name",
    "host_of",
    "http_answer",
    "in_pieces",
    "installed_adapters",
    "is_host_known",
    "is_loopback",
    "json_member",
    "known_token",
    "line",
    "load_adapter",
    "may_connect",
    "msgpack_member",
    "new_token",
    "note_no_descriptors",
    "port_of",
    "port_of_kind",
    "raw_field",
    "serve_tcp",
    "serving",
    "tls_context",
    "token_for",
    "vehicle_of",
    "vehicles_of",
    "within",
]  # fmt: skip

"""How a session of zenoh is opened, and what its callbacks and large payloads need."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from uwserver.adapter import CannotServe
from uwserver_adapters.zenoh_session.config import ZenohConfig, endpoints, settings

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")

LARGE_BYTES = 1 << 15
"""A payload above this goes out in fragments, for which zenoh may wait: not on the loop."""
REFUSED_PEERS = "error,zenoh_link_tls=warn,zenoh_link_quic=warn"
"""What zenoh logs (on stdout, as it always does) where certificates decide who may enter; RUST_LOG says otherwise."""


class NobodyThere(Exception):
    """The session needs a connection, and nobody answers yet."""


def opened(config: ZenohConfig, listen: tuple[str, ...]) -> zenoh.Session:
    """Open a session. Not on the loop: it may take half a second.

    Raises:
        NobodyThere: it must connect first, and nobody answers.
        CannotServe: zenoh is not installed, or a setting is wrong.
    """
    try:
        import zenoh
    except ImportError as error:
        raise CannotServe(f"{error.name} is not installed: pip install uwserver") from error
    made = _zenoh_config(config, listen)
    if any(endpoint.startswith(("tls/", "quic/")) for endpoint in listen):
        zenoh.init_log_from_env_or(REFUSED_PEERS)
    try:
        return zenoh.open(made)
    except zenoh.ZError as error:
        reason = str(error).split(" at /")[0].strip()
        if "nable to connect" in reason:
            raise NobodyThere(
                f"{reason} It is tried again; start what should be there, or correct `connect`."
            ) from None
        hint = "stop what uses it, or change `listen`" if "in use" in reason else "correct the adapter's table"
        raise CannotServe(f"zenoh cannot open a session: {reason}: {hint}") from None


def _zenoh_config(config: ZenohConfig, listen: tuple[str, ...]) -> zenoh.Config:
    import zenoh

    try:
        made = zenoh.Config.from_file(config.config_file) if config.config_file else zenoh.Config()
    except zenoh.ZError as error:
        raise CannotServe(f"config_file {config.config_file}: {str(error).split(' at /')[0]}") from None
    for path, value in settings(config, listen):
        try:
            made.insert_json5(path, value)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]
            raise CannotServe(f'zenoh refuses the setting "{path}" = {value[:200]}: {reason}') from None
    return made


def free(config: ZenohConfig) -> tuple[str, ...]:
    """Where it listens, with ports of its own where the table says 0.

    Raises:
        CannotServe: this machine has no such address.
    """
    try:
        return endpoints(config)
    except OSError as error:
        raise CannotServe(
            f"cannot listen at {', '.join(config.listen or ())}: {error}; 127.0.0.1 is always there, 0.0.0.0 means all"
        ) from None


def direct(callback: Callable[[T], None]) -> Callable[[T], None]:
    """A callback of zenoh's that only hands over: zenoh needs to start no thread of Python for it."""
    import zenoh

    return zenoh.handlers.Callback(callback, indirect=False)

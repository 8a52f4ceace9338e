"""The tables of the adapter `video` in a scenario."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from msgspec import Meta, field

from uwserver.adapter import AdapterTable, CannotServe, did_you_mean
from uwserver.adapter.pictures import EXTRA, can_encode_jpeg, picture_place
from uwserver.ports import Port, Service
from uwserver.table import Count, Name, PortNumber, Table

SystemNumber = Annotated[int, Meta(ge=1, le=255)]


class StreamTable(Table, kw_only=True, frozen=True):
    """One stream.

    Attributes:
        port: camera, or another sensor with pictures: "rov/camera".
        rtp: one or several addresses to which RTP is sent whether or not somebody listens; QGroundControl listens at "127.0.0.1:5600".
        codec: "h264" needs `pip install 'uwserver[video]'`; "jpeg" needs more bandwidth, and QGroundControl does not support it.
        bit_rate: most bits per second of H.264.
        preset: preset of x264; a slower one needs fewer bits for the same quality.
        quality: quality of JPEG.
        system: system number of the vehicle in MAVLink, for `mavlink`.
    """

    port: Name
    rtp: Name | tuple[Name, ...] = ()
    codec: Literal["h264", "jpeg"] = "h264"
    bit_rate: Annotated[int, Meta(ge=50_000, le=200_000_000)] = 4_000_000
    preset: Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium"] = "ultrafast"
    quality: Annotated[int, Meta(ge=1, le=100)] = 80
    system: SystemNumber = 1

    def __post_init__(self) -> None:
        """Raise ValueError if an address is not valid."""
        for address in self.targets:
            host_and_port("rtp", address)

    @property
    def targets(self) -> tuple[str, ...]:
        """The addresses of `rtp`."""
        return (self.rtp,) if isinstance(self.rtp, str) else self.rtp


class VideoConfig(AdapterTable, tag="video", kw_only=True, frozen=True):
    """Attributes:
    streams: streams by names of your own, which are their paths: rtsp://127.0.0.1:8554/NAME. Default: each port with pictures, by its path.
    rtsp: serve RTSP.
    bind: address of the RTSP server. It has no passwords: whoever can reach an address other than loopback sees the pictures.
    rtsp_port: port of the RTSP server; 0 takes a free one.
    udp: send by UDP to RTSP clients that request it; else only over their connection.
    codec: codec of streams without a table.
    mavlink: addresses of ground stations to which each stream is announced as a MAVLink camera: "127.0.0.1:14550".
    max_clients: RTSP clients at a time.
    max_clients_per_host: RTSP clients of one host other than this machine.
    hello_timeout_s: wall time for the first request of a client.
    keep_alive_s: wall time after which a client that receives pictures but sends nothing counts as gone; over TCP only if it does not read either.
    queue_bytes: bytes that may wait for a slow client; above, pictures are left out.
    """

    streams: dict[Name, StreamTable] = field(default_factory=dict)
    rtsp: bool = True
    bind: Name = "127.0.0.1"
    rtsp_port: PortNumber = 8554
    udp: bool = True
    codec: Literal["h264", "jpeg"] = "h264"
    mavlink: tuple[Name, ...] = ()
    max_clients: Annotated[int, Meta(ge=1, le=256)] = 16
    max_clients_per_host: Count = 8
    hello_timeout_s: Annotated[float, Meta(gt=0)] = 10.0
    keep_alive_s: Annotated[float, Meta(ge=1)] = 10.0
    queue_bytes: Annotated[int, Meta(ge=1 << 16)] = 1 << 20

    def __post_init__(self) -> None:
        """Raise ValueError if an address is not valid, or nothing would be served."""
        for address in self.mavlink:
            host_and_port("mavlink", address)
        if not self.rtsp and not any(table.targets for table in self.streams.values()):
            raise ValueError("nothing would be served: set rtp of a stream, or leave rtsp = true")

    def faults(
        self, ports: Mapping[str, Port], services: Mapping[str, Service]
    ) -> Iterable[tuple[tuple[str, ...], str]]:
        """Yield the streams whose ports have no pictures."""
        for name, table in self.streams.items():
            try:
                port_with_pictures(table.port, ports)
            except CannotServe as error:
                yield ("streams", name, "port"), str(error)

    def needs(self) -> Mapping[str, str]:
        """Return the modules that are needed: encoders, and the dialect of MAVLink."""
        codecs = {table.codec for table in self.streams.values()} or {self.codec}
        needed = {"av": "uwserver[video]"} if "h264" in codecs else {}
        if "jpeg" in codecs and not can_encode_jpeg():
            needed["simplejpeg"] = EXTRA  # Pillow would do as well
        return {**needed, **({"pymavlink.dialects.v20.common": "uwserver"} if self.mavlink else {})}


def port_with_pictures(path: str, ports: Mapping[str, Port]) -> Port:
    """Return the port of a stream.

    Raises:
        CannotServe: there is no such port, or it has no pictures.
    """
    port = ports.get(path)
    with_pictures = sorted(known for known, its in ports.items() if picture_place(its) is not None)
    there = f"ports with pictures: {', '.join(with_pictures) or 'none'}"
    if port is None:
        raise CannotServe(f'no port "{path}"{did_you_mean(path, with_pictures)}; {there}')
    if picture_place(port) is None:
        raise CannotServe(f'"{path}" has no pictures; {there}')
    return port


def host_and_port(key: str, address: str) -> tuple[str, int]:
    """Split ``host:port``. Raises ValueError if the text is no address."""
    host, colon, port = address.rpartition(":")
    if not (host and colon and port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
        raise ValueError(f'{key}: "{address}" is no address: write host:port, as 127.0.0.1:5600')
    return host.strip("[]"), int(port)

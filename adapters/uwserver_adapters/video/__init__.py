"""Video of cameras: H.264 or JPEG over RTP, an RTSP server, and MAVLink cameras that announce the streams (docs/how-to/video.md)."""

from uwserver_adapters.video.adapter import VideoAdapter

__all__ = ["VideoAdapter"]

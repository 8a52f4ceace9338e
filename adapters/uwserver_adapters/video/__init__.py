"""Video of cameras: H.264 or JPEG by RTP, an RTSP server, and a camera of MAVLink that announces them (docs/how-to/video.md)."""

from uwserver_adapters.video.adapter import VideoAdapter

__all__ = ["VideoAdapter"]

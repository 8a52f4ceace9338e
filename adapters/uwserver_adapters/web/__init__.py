"""The web view: a page that shows and steers the world, and its data, on one port (docs/how-to/web.md, docs/reference/web.md)."""

from uwserver_adapters.web.adapter import WebAdapter

__all__ = ["WebAdapter"]

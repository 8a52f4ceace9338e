"""The web view: a page, what it draws and what it steers, on one port (docs/how-to/web.md, docs/reference/web.md)."""

from uwserver_adapters.web.adapter import WebAdapter

__all__ = ["WebAdapter"]

"""uwclient is imported with nothing but the standard library."""

from __future__ import annotations

import sys

import pytest


def test_imports_need_nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("numpy", "msgpack", "matplotlib", "uwserver"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in [name for name in sys.modules if name.split(".")[0] == "uwclient"]:
        monkeypatch.delitem(sys.modules, name)
    import uwclient
    import uwclient.cli

    assert uwclient.connect == uwclient.Client.connect
    assert callable(uwclient.cli.main)

"""The environment's token is nobody's in these tests."""

import pytest


@pytest.fixture(autouse=True)
def no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)

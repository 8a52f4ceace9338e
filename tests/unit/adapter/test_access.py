"""The token of an adapter: where it comes from, and when one is made; and addresses that others can reach.

Also of uwserver.adapter.base.
"""

from __future__ import annotations

import asyncio

import pytest

from uwserver.adapter import (
    TOKEN_VARIABLE,
    AdapterBase,
    CannotListen,
    NodeTable,
    OpenTable,
    Token,
    known_token,
    new_token,
    token_for,
)
from uwserver.testing import FakeContext


def test_the_table_stands_above_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "outside")
    assert known_token("mine") == "mine"
    assert known_token(None) == known_token("") == "outside"
    monkeypatch.setenv(TOKEN_VARIABLE, "")
    assert known_token(None) is None


def test_one_is_made_only_where_one_is_needed_and_none_is_known() -> None:
    assert token_for("mine", True) == token_for("mine", False) == Token("mine")
    assert token_for(None, False) == Token(None)
    made = token_for(None, True)
    assert made.is_new
    assert made.text is not None
    assert len(bytes.fromhex(made.text)) == 24
    assert new_token() != new_token()


class _Open(OpenTable, tag="open", kw_only=True, frozen=True): ...


class _Node(NodeTable, tag="node", kw_only=True, frozen=True): ...


def test_without_a_token_other_machines_are_let_in_only_on_purpose() -> None:
    _Open().check_bind("It")
    _Open(bind="0.0.0.0", allow_network=True).check_bind("It")
    with pytest.raises(CannotListen, match=r"It knows no token: whoever reaches 0\.0\.0\.0 .*allow_network = true"):
        _Open(bind="0.0.0.0").check_bind("It")


def test_others_must_be_told_an_address_that_leads_here() -> None:
    assert (_Node().reached_at(), _Node(bind="::", host="rov").reached_at()) == ("127.0.0.1", "rov")
    for bind in ("0.0.0.0", "::"):
        with pytest.raises(CannotListen, match=r"leads nobody here\. Say host = "):
            _Node(bind=bind).reached_at()


def test_an_adapter_begins_with_table_context_and_refusals() -> None:
    async def scene() -> None:
        config, context = _Open(), FakeContext()
        adapter = AdapterBase(config, context)
        assert (adapter.config, adapter.context) == (config, context)
        adapter.refusals.note("cause", "text")
        assert context.stats.details["refused"] == {"cause": 1}

    asyncio.run(scene())

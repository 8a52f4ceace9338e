"""The token of an adapter: where it comes from, and when one is made."""

from __future__ import annotations

import pytest

from uwserver.adapter import TOKEN_VARIABLE, Token, known_token, new_token, token_for


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

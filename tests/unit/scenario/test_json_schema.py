from __future__ import annotations

import json
from pathlib import Path

import pytest

from uwserver.scenario.json_schema import FILES, FileKind, json_schema

COMMITTED = Path(__file__).parents[3] / "docs/reference"
REGENERATE = (
    "if the change is wanted, run: for k in scenario vehicle device; do "
    "uwserver schema --$k > docs/reference/$k.schema.json; done"
)


@pytest.mark.parametrize("kind", FILES)
def test_committed_schema_is_current(kind: FileKind) -> None:
    committed = (COMMITTED / f"{kind}.schema.json").read_text(encoding="utf-8")
    assert json.loads(json_schema(kind)) == json.loads(committed), REGENERATE

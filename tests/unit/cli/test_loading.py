"""Loading of a command's scenario, and changed copies of it."""

from __future__ import annotations

from dataclasses import replace

import click
import pytest

from uwserver.cli.loading import loaded, require_packages, with_adapter, with_changes
from uwserver.scenario.load.extras import Missing


def test_faults_are_printed_and_end_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        loaded("bluerov2_pol")
    assert ended.value.code == 1
    assert 'did you mean "bluerov2_pool"' in capsys.readouterr().err


def test_a_changed_copy_leaves_the_scenario_as_it_is() -> None:
    resolved, kinds = loaded("bluerov2_pool")
    before = dict(resolved.scenario.adapters)
    another = with_adapter(resolved, "more", kinds["sockets"](port=0))
    assert list(another.scenario.adapters) == [*before, "more"]
    assert with_changes(another, adapters={}).scenario.adapters == {}
    assert resolved.scenario.adapters == before


def test_a_missing_package_ends_the_command() -> None:
    resolved, _ = loaded("bluerov2_pool")
    require_packages(resolved)
    with pytest.raises(
        click.ClickException,
        match="bluerov2_pool: not installed: scipy; install all that this scenario needs: pip install scipy",
    ):
        require_packages(replace(resolved, missing=Missing(("scipy",), "pip install scipy")))

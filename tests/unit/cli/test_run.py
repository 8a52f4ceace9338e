"""`uwserver run`: what it refuses before anything starts."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from uwserver.cli.run import run


@pytest.mark.parametrize("option", ["--until", "--speed"])
@pytest.mark.parametrize("value", ["nan", "inf", "-1", "soon"])
def test_times_and_speeds_that_are_none_are_refused(option, value):
    result = CliRunner().invoke(run, [option, value])
    assert result.exit_code == 2
    assert option in result.output

"""The browser of tests that need one."""

from __future__ import annotations

import pytest

from uwserver.cli.browser.chromium import NoChromium, chromium


def chromium_or_skip() -> str:
    """Its path; the test is skipped where there is none."""
    try:
        return chromium()
    except NoChromium as error:
        pytest.skip(str(error))

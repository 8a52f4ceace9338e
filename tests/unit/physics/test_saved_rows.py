"""What arrays from outside must be like."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.physics import saved_rows
from uwserver.physics.kernel import layout


def test_whole_numbers_that_change_are_those_of_the_rows() -> None:
    """A state from outside may set them; another name would let none of them pass, or a wrong one."""
    rows = (layout.BODY, layout.THRUSTER, layout.WRENCH)
    whole = {name for dtype in rows for name in dtype.names or () if dtype[name].kind == "i"}
    assert set(saved_rows._FLAGS) <= whole


def test_only_what_has_no_limit_may_be_infinite() -> None:
    now = np.zeros(1, layout.BODY)
    new = now.copy()
    new["floor"] = np.inf
    saved_rows.check_rows("bodies", new, now)
    new["weight"] = np.inf
    with pytest.raises(ValueError, match="weight that is not finite"):
        saved_rows.check_rows("bodies", new, now)


def test_rows_of_other_bodies_are_refused() -> None:
    now = np.zeros(1, layout.BODY)
    new = now.copy()
    new["strip_count"] = 3
    with pytest.raises(ValueError, match="of other bodies"):
        saved_rows.check_rows("bodies", new, now)

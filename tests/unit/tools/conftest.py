"""Makes the scripts of tools/ importable by the tests beside it."""

from __future__ import annotations

import sys
from pathlib import Path

# Behind all others: a script may have the name of a module of Python, as `site` has.
sys.path.append(str(Path(__file__).parents[3] / "tools"))

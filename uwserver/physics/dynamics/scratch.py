"""The rows of a step's work space, `layout.SCRATCH`. An index costs nothing in compiled code, a slice two atomic counts."""

from __future__ import annotations

K1, K2, K3, K4, STAGE, STATE = range(6)
"""Of `s`: four stage derivatives, a stage state, the state itself."""

NU, NU_R, TAU, MOMENTUM, EXTRA, APPLIED, CENTER, UP, _, WATER, DU_DT, ACTUATED, PASSIVE, EXTERNAL = range(14)
STREAM, STREAM_RATE, PULL = range(14, 17)
"""Of `work`. ACTUATED, PASSIVE and EXTERNAL are input: what `appendages` gave for the same instant, and the external wrench of the tick, or
zero. UP has two rows. The last three are of a hull with strips (`strips.along_hull`)."""

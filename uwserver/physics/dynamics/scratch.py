"""The rows of the work space of a step, `layout.SCRATCH`. In compiled code an index costs nothing; a slice costs two atomic counts."""

from __future__ import annotations

K1, K2, K3, K4, STAGE, STATE = range(6)
"""Rows of `s`: four stage derivatives, a stage state, the state itself."""

NU, NU_R, TAU, MOMENTUM, EXTRA, APPLIED, CENTER, UP, _, WATER, DU_DT, ACTUATED, PASSIVE, EXTERNAL = range(14)
STREAM, STREAM_RATE, PULL = range(14, 17)
"""Rows of `work`. ACTUATED, PASSIVE and EXTERNAL are input: the results of `appendages` for the same instant, and the external wrench of the tick,
or zero. UP has two rows. The last three are for a hull with strips (`strips.along_hull`)."""

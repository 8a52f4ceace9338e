"""A batch held against worlds."""

from __future__ import annotations

import numpy as np

from uwserver.copies.batch import Batch
from uwserver.world.world import World


def check_equal(batch: Batch, k: int, world: World) -> None:
    """Copy k and a world have the same states and the same newest samples, bit by bit."""
    for name in batch.vehicles:
        row = world.vehicles[name].row
        assert batch.states(name)[k].tobytes() == world.hydro.state[row].tobytes(), (name, k)
    for port in batch.ports:
        ours, theirs = batch.read(port), world.read(port)
        if theirs is None:
            assert ours.seq[k] == -1, port
            continue
        assert ours.stamps[k].tolist() == [theirs.seq, theirs.t_ns, theirs.t_sent_ns, theirs.valid], port
        for field in ours:
            wanted = np.asarray(theirs.array(field))
            if ours[field].dtype.kind == "i" and wanted.dtype.kind == "f":  # no value
                wanted = np.where(np.isnan(wanted), -(2**63), wanted).astype(np.int64)
            assert np.array_equal(ours[field][k], wanted, equal_nan=True), (port, field)

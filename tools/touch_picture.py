"""The picture of docs/how-to/touch-something.md: a vehicle reaches a crate, pushes it and backs off."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

import uwserver

# Before pyplot is imported: no display.
matplotlib.use("Agg")
from matplotlib import pyplot as plt

FILE = Path(__file__).parents[1] / "docs" / "images" / "push_the_crate.png"
HALF_ROV_M, HALF_CRATE_M = 0.2285, 0.25


def main() -> None:
    """Ten seconds ahead, five astern."""
    world = uwserver.load("push_the_crate").core
    rov, crate = world.vehicles["rov"], world.vehicles["crate"]
    rows = []
    for k in range(15 * 240):
        u = 0.4 if k < 10 * 240 else -0.4
        if k % 24 == 0:
            world.command("rov/thrusters", u=[-u, -u, u, u, 0.3, 0.3, 0.3, 0.3])
        world.step()
        contacts, impulse = world.hydro.touched
        between = np.minimum(contacts.body_a, contacts.body_b) >= 0
        force = np.abs(impulse[between, 0]).sum() / world.hydro.dt
        rows.append(((k + 1) / 240, rov.p_NB[0] + HALF_ROV_M, crate.p_NB[0] - HALF_CRATE_M, force))
    t, bow, face, force = np.array(rows).T
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.4), layout="constrained")
    left.plot(t, bow, label="bow of the vehicle")
    left.plot(t, face, label="near side of the crate")
    left.set(xlabel="time, s", ylabel="north, m", title="10 s ahead, 5 s astern")
    left.legend(fontsize=8)
    # A blow is over within a tick: the mean of 50 ms is what can be seen.
    right.plot(t.reshape(-1, 12)[:, -1], force.reshape(-1, 12).mean(axis=1))
    right.set(xlabel="time, s", ylabel="force, N", title="Between vehicle and crate, means of 50 ms")
    for axes in (left, right):
        axes.grid(visible=True, alpha=0.3)
    # Without the version of matplotlib in it, the same plot is the same file.
    figure.savefig(FILE, dpi=90, metadata={"Software": None})
    print(f"{FILE.name}: {FILE.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()

"""PX4 against a running server, by the scenario that comes with it.

Opt-in: `UWSERVER_PX4` names a `px4` of a SITL build. It listens on all interfaces and speaks to UDP 14550: run these in a network namespace
(``unshare -n``, loopback up). Figures are printed (``pytest -s``).
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest
import uwserver_scenarios
from autopilot_server import Server, serving, until
from test_real_autopilots import Gcs

PX4 = os.environ.get("UWSERVER_PX4", "")
MODEL = os.environ.get("UWSERVER_PX4_MODEL", "gazebo-classic_uuv_bluerov2_heavy")

pytestmark = pytest.mark.skipif(not PX4, reason="UWSERVER_PX4 is not set: a px4 binary of a SITL build")


class Station(Gcs):
    """A ground station with a joystick, as PX4 takes it: surge, sway, heave and yaw, -1 to 1."""

    MODES: ClassVar[dict[str, int]] = {"MANUAL": 1, "ALTCTL": 2, "POSCTL": 3, "ACRO": 5, "OFFBOARD": 6, "STABILIZED": 7}

    def __init__(self) -> None:
        super().__init__(14550)
        self.surge = self.sway = self.up = self.yaw = 0.0

    def steer(self) -> None:
        x, y, z, r = (round(stick * 1000.0) for stick in (self.up, self.sway, (self.surge + 1.0) / 2.0, self.yaw))
        self.send(self.mav.manual_control_encode(1, x, y, z, r, 0))

    @property
    def time_s(self) -> float:
        return float(self.last["ATTITUDE"].time_boot_ms) * 1e-3

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw as it believes."""
        message = self.last["ATTITUDE"]
        return math.degrees(message.roll), math.degrees(message.pitch), math.degrees(message.yaw)

    def mode(self, name: str) -> None:
        wanted = self.MODES[name]
        self.command(176, 1.0, float(wanted))
        self.until(lambda: self.last["HEARTBEAT"].custom_mode >> 16 & 0xFF == wanted, f"mode {name}")

    @property
    def is_armed(self) -> bool:
        return bool(self.last["HEARTBEAT"].base_mode & 128)


@contextlib.contextmanager
def px4(folder: Path, **params: float) -> Iterator[subprocess.Popen[bytes]]:
    """A real one with an empty parameter file, killed with the test."""
    binary = Path(PX4).resolve()
    folder.mkdir(exist_ok=True)
    environment = os.environ | {"PX4_SIM_MODEL": MODEL}
    environment |= {f"PX4_PARAM_{name}": f"{value:g}" for name, value in params.items()}
    command = [str(binary), "-d", str(binary.parents[1] / "etc")]
    with (folder / "px4.log").open("wb") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=folder, env=environment
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def scenario(clock: str = "max_speed = 1.0", **adapter: object) -> str:
    """The one that comes with it, on free ports but PX4's, its truth to be seen."""
    text = (Path(uwserver_scenarios.__file__).parent / "bluerov2_px4.toml").read_text(encoding="utf-8")
    text = text.replace("port = 7600", "port = 0\ntruth = true")
    text = re.sub(r"^max_speed = .*$", clock, text, flags=re.MULTILINE)
    keys = "".join(f"{key} = {value}\n" for key, value in adapter.items())
    return text.replace("[adapters.px4]\n", f"[adapters.px4]\n{keys}")


def wait_for_estimator(station: Station) -> None:
    station.until(lambda: "ATTITUDE" in station.last, "an attitude", 120)

"""The pictures that README and docs show of the web view: `uwserver shot` for what stands still, a drive with the page's own keys for what moves.

Needs Chromium, and Pillow (which matplotlib brings) for the films. Give names to make only these: `python tools/pictures.py web_view web_drive`.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from uwserver.cli.browser.chromium import Page, chromium
from uwserver.cli.browser.shot import advance, showing, wait_until_still

FOLDER = Path(__file__).parents[1] / "docs" / "images"
MOST_KIB, MOST_MOVING_KIB = 300, 3000
SMALL = ("--size", "640x400")
BARE = ("--link", "dock=off&theme=dark")
STILL: dict[str, tuple[str, ...]] = {
    "web_view": ("pool_inspection", "--at", "6", "--link", "theme=dark"),
    "web_pilot": ("rov_autopilot", "--at", "8", "--link", "tab=pilot&theme=dark"),
    "web_scenario_bluerov2_pool": ("bluerov2_pool", "--at", "2", *SMALL, *BARE),
    "web_scenario_bluerov2_open_sea": ("bluerov2_open_sea", "--at", "5", *SMALL, *BARE),
    "web_scenario_pool_inspection": ("pool_inspection", "--at", "5", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_subsea_template": ("subsea_template", "--at", "5", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_slope": ("slope", "--at", "5", "--view", "orbit", "--vehicle", "lander", *SMALL, *BARE),
    "web_scenario_push_the_crate": ("push_the_crate", "--at", "2", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_rov_autopilot": ("rov_autopilot", "--at", "5", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_pilot_training": ("pilot_training", "--at", "5", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_inspect_the_anodes": ("inspect_the_anodes", "--at", "3", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_follow_the_pipe": ("follow_the_pipe", "--at", "3", "--view", "orbit", *SMALL, *BARE),
    "web_training": (
        "inspect_the_anodes",
        "--at",
        "3",
        "--view",
        "orbit",
        "--size",
        "1280x720",
        "--link",
        "tab=pilot&theme=dark",
    ),
    "web_scenario_remus_survey": ("remus_survey", "--at", "5", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_filter_review": ("filter_review", "--at", "100", "--view", "orbit", *SMALL, *BARE),
    "web_scenario_swarm_100": ("swarm_100", "--at", "5", "--view", "orbit", *SMALL, *BARE),
}
"""Names of files, and what is asked of `uwserver shot`."""


class Film(NamedTuple):
    """What is steered by the keys of the page.

    Attributes:
        scenario: by name.
        parts: parts of the page's address.
        keys: seconds of simulation time, and the keys that are held.
        begin_s: simulation time of the first frame.
        frame_s: time from one frame to the next.
        shown: pixels of the film.
        camera: where it is from the vehicle: east, up, south, in m; as the view has it if there is none.
    """

    scenario: str
    parts: dict[str, str]
    keys: tuple[tuple[float, tuple[str, ...]], ...]
    begin_s: float
    frame_s: float
    shown: tuple[int, int]
    camera: tuple[float, float, float] | None = None


FILMS = {
    "web_drive": Film(
        "pool_inspection",
        {"view": "follow", "dock": "off", "theme": "dark", "quality": "high"},
        ((2.0, ("KeyW",)), (2.5, ("KeyW", "KeyD")), (2.0, ("KeyW", "KeyF"))),
        0.5,
        0.2,
        (640, 360),
    ),
    "web_crate": Film(
        "push_the_crate",
        {"dock": "off", "theme": "dark", "quality": "high"},
        ((4.5, ("KeyW", "KeyF")), (1.25, ("KeyS",)), (1.75, ("KeyR", "KeyW"))),
        0.2,
        0.125,
        (800, 450),
        (1.5, 0.75, 1.25),
    ),
}
PAGE = (960, 540)
"""Pixels of the page that is filmed."""
STEER = """
(async () => {
  const { commands } = await import("/pilot/allocation.js");
  const { app, pilot } = uw;
  const { actuators } = app.world.vehicles[app.chosen];
  for (const [port, value] of commands(app.vehicle, app.description.ports, actuators, pilot.sticks)) app.link.notify("command", { port, value });
})()
"""
"""What the page does with its sticks twenty times a second; but for it time stands still here between two frames, and then it does not."""

PLACE = """
(() => {
  const { camera, controls } = uw.drawing.views;
  camera.position.copy(controls.target).add({ x: %g, y: %g, z: %g });
})()
"""


def main() -> None:
    """Make all, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[*STILL, *FILMS], help="of pictures; default: all")
    for name in parser.parse_args().names:
        file = FOLDER / f"{name}.webp"
        if name in FILMS:
            film(file, FILMS[name])
        else:
            still(file, STILL[name])
        kib = file.stat().st_size // 1024
        print(f"{file.name}: {kib} KiB", flush=True)
        if kib >= (MOST_MOVING_KIB if name in FILMS else MOST_KIB):
            sys.exit(f"{file.name} is too large")


def still(file: Path, asked: tuple[str, ...]) -> None:
    """One picture."""
    scenario, *options = asked
    subprocess.run([sys.executable, "-m", "uwserver", "shot", scenario, str(file), *options], check=True)


def film(file: Path, film: Film) -> None:
    """A vehicle that is steered as a person does, by the keys of the page; frame by frame, so that it is smooth on any machine."""
    frames: list[Image.Image] = []
    with showing(film.scenario, chromium(), PAGE, film.parts) as page:
        t = film.begin_s
        advance(page, t)
        if film.camera is not None:
            page.ask(PLACE % film.camera)
        wait_until_still(page)
        for seconds, keys in film.keys:
            with page.holding(*keys):
                page.wait("uw.pilot.owns && uw.pilot.sticks.some((stick) => stick !== 0)", "the keys steer")
                for _ in range(round(seconds / film.frame_s)):
                    t += film.frame_s
                    page.ask(STEER)
                    advance(page, t)
                    frames.append(_picture(page, film.shown))
    frames[0].save(
        file, save_all=True, append_images=frames[1:], duration=round(1000 * film.frame_s), loop=0, quality=60, method=4
    )


def _picture(page: Page, shown: tuple[int, int]) -> Image.Image:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "frame.png"
        page.picture(file)
        return Image.open(io.BytesIO(file.read_bytes())).convert("RGB").resize(shown)


if __name__ == "__main__":
    main()

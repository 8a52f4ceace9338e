"""The pictures of docs/tutorial/sonar-and-camera.md: its scenario and the dock as the page of the web view shows them, and what camera and sonar see.

The dive into the dock is drawn by examples/dock_tags.py.

Needs Chromium, and Pillow and matplotlib (extras pictures and plot).
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

import uwserver

# Before pyplot is imported: no display.
matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
DOCS, DOCK = ROOT / "docs", ROOT / "examples/dock_tags.toml"
PAGE, IMAGES = DOCS / "tutorial/sonar-and-camera.md", DOCS / "images"
PANELS = "tab=data&panels=picture:rov/camera,picture:rov/sonar&theme=dark"
HEIGHT = 360
"""Of one picture in the row, pixels."""
BEFORE_DOCK = "position_ned_m = [4.22, 1.09, 8.0]\nattitude_rpy_deg = [0.0, 0.0, 32.0]"


def main() -> None:
    """Write all."""
    (scenario,) = re.findall(r"^`look.toml`:\n```toml\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "look.toml"
        file.write_text(scenario, encoding="utf-8")
        row(file).save(IMAGES / "tutorial_pictures.jpg", quality=84)
        shown = IMAGES / "tutorial_look.webp"
        command = [sys.executable, "-m", "uwserver", "shot", str(file), str(shown), "--at", "4", "--link", PANELS]
        subprocess.run(command, check=True)
        dock(Path(folder)).save(IMAGES / "tutorial_dock.webp", quality=80)


def dock(folder: Path) -> Image.Image:
    """The vehicle before the dock, from behind it."""
    shutil.copy(DOCK.with_suffix(".glb"), folder)
    file, shown = folder / DOCK.name, folder / "dock.png"
    text = re.sub(
        r"(?<=^\[vehicles.rov\]\nmodel = \"bluerov2_heavy\"\n).*\n.*$",
        BEFORE_DOCK,
        DOCK.read_text(encoding="utf-8"),
        count=1,
        flags=re.M,
    )
    file.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "uwserver", "shot", str(file), str(shown), "--at", "0.1", "--view", "follow"]
    subprocess.run(command, check=True)
    with Image.open(shown) as whole:
        return whole.convert("RGB").crop((170, 110, 690, 600))


def row(file: Path) -> Image.Image:
    """Camera without and with lamps, and sonar."""
    pictures = []
    for level in (0.0, 0.8):
        world = uwserver.load(file)
        heard = world.record("rov/*")
        world.command("rov/lights", levels=[level, level])
        world.step(960)
        pictures.append(Image.fromarray(heard["rov/camera"].image[-1]))
    sonar = heard["rov/sonar"]
    pictures.append(fan(sonar.image[-1], sonar.azimuth[-1], float(sonar.range[-1])))
    small = [picture.resize((HEIGHT * picture.width // picture.height, HEIGHT)) for picture in pictures]
    whole = Image.new("RGB", (sum(picture.width for picture in small), HEIGHT))
    x = 0
    for picture in small:
        whole.paste(picture, (x, 0))
        x += picture.width
    return whole


def fan(counts: np.ndarray, azimuth: np.ndarray, reach: float) -> Image.Image:
    """As the listing of the page draws it."""
    rows = len(counts)
    figure, axis = plt.subplots(figsize=(6.4, 4.2), layout="constrained", subplot_kw={"projection": "polar"})
    axis.pcolormesh(azimuth, (np.arange(rows) + 0.5) / rows * reach, counts, cmap="copper")
    axis.set(theta_zero_location="N", theta_direction=-1, thetamin=-65, thetamax=65)
    axis.grid(visible=False)
    binary = io.BytesIO()
    figure.savefig(binary, format="png", dpi=100)
    plt.close(figure)
    return Image.open(binary).convert("RGB")


if __name__ == "__main__":
    main()

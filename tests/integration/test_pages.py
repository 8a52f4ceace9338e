"""Readers follow README, tutorial, how-tos and client pages to the letter, each against the server that the page starts.

All of them do so in `make test-all`. `make test` follows the README and what else is cheap, and reads all pages: each command line by the
parser of its program, each listing of Python by Python. It also steps each scenario of a how-to: the first that a page shows or runs is whole; a
part runs when it is put at the end of what `uwserver new tank` writes, or of the file that the page names.
"""

from __future__ import annotations

import ast
import itertools
import re
import runpy
import shlex
import shutil
import socket
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import tomli_w
from reader import ROOT, STARTS, Reader, blocks
from readers_files import FILES
from uwclient import cli as client_cli

from uwserver.adapter import installed_adapters
from uwserver.cli import main
from uwserver.scenario.authoring.starter import starter
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.tables import VehicleFile

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FOLLOWED = (
    "README.md",
    "clients/nc/README.md",
    "clients/python/README.md",
    "docs/how-to/batch.md",
    "docs/how-to/coming-from.md",
    "docs/how-to/faults.md",
    "docs/how-to/training.md",
    "docs/how-to/view-from-python.md",
)
"""Pages of which nothing else is asked than that all works; the tests below follow others and look at what they show."""
CHEAP = ("README.md", "docs/how-to/batch.md")
"""Of these what `make test` follows."""
ELSEWHERE = {
    "docs/how-to/ros2.md": "tests/unit/adapters/ros2/test_rmw_zenoh.py",
    "docs/how-to/rosbridge.md": "tests/unit/adapters/rosbridge/test_peers.py",
    "docs/how-to/ardusub.md": "tests/integration/test_real_how_to.py",
    "docs/how-to/autopilot.md": "tests/integration/test_autopilot.py",
    "docs/how-to/cameras.md": "tests/unit/sensors/optical/camera/test_how_to.py",
    "docs/how-to/browser.md": "tests/unit/adapters/sockets/test_websocket.py",
    "docs/how-to/install.md": "tests/integration/test_distributions.py",
    "docs/how-to/logs.md": "tests/unit/cli/recordings/test_export.py",
    "docs/how-to/modem.md": "tests/examples/test_programs.py",
    "docs/how-to/moos.md": "tests/unit/adapters/moos/test_how_to.py",
    "docs/how-to/playback.md": "tests/integration/test_playback.py",
    "docs/how-to/morse.md": "tests/integration/test_morse.py",
    "docs/how-to/ros1.md": "tests/integration/test_ros1.py",
    "docs/how-to/yarp.md": "tests/integration/test_yarp.py",
    "docs/how-to/player.md": "tests/integration/test_player.py",
    "docs/how-to/px4.md": "tests/integration/test_real_px4.py",
    "docs/how-to/write-an-adapter.md": "tests/unit/testing/test_adapters.py",
    "docs/how-to/video.md": "tests/integration/test_video.py",
    "docs/how-to/review.md": "tests/integration/test_review.py",
    "docs/how-to/your-vehicle.md": "tests/examples/test_your_vehicle.py",
    "docs/how-to/zenoh.md": "tests/integration/test_zenoh.py",
}
"""Pages whose listings need a peer or a vehicle of their own, and the tests that have it."""
NOT_FOLLOWED = ("docs/how-to/container.md",)
"""Needs a container engine; tests/integration/test_image.py builds and runs the image without one."""


def follow(page: str, folder: Path) -> dict[str, str]:
    """What a page's commands and listings print."""
    with Reader(folder) as reader:
        reader.follow(page)
        return reader.said


def printed(said: dict[str, str], part: str) -> str:
    """What the only line or listing printed that has this part."""
    (found,) = [text for typed, text in said.items() if part in typed]
    return found


def pages() -> list[str]:
    """All that have commands or listings."""
    found = [ROOT / "README.md", ROOT / "docs/tutorial.md", *(ROOT / "clients").glob("*/README.md")]
    found += (ROOT / "docs/how-to").glob("*.md")
    found += (ROOT / "docs/tutorial").glob("*.md")
    return [str(path.relative_to(ROOT)) for path in found]


def commands(page: str) -> Iterator[list[str]]:
    """The words of each line of a page that calls `uwserver` or `uwclient`."""
    for block in blocks(page, "sh"):
        for line in re.sub(r"\\\n\s*", "", block.text).splitlines():
            if line.startswith(("uwserver ", "uwclient ")):
                words = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
                words.whitespace_split = True
                yield list(itertools.takewhile(lambda word: not re.match("[|&;<>]", word), words))


def parse(words: list[str]) -> None:
    """Raises what a program raises that does not know a command or an option of the line; nothing is run."""
    if words[0] == "uwclient":
        client_cli._parser().parse_args(words[1:])
        return
    command: click.Command = main
    rest = words[1:]
    context = click.Context(command)
    while isinstance(command, click.Group) and rest and (inner := command.get_command(context, rest[0])) is not None:
        command, rest = inner, rest[1:]
        context = click.Context(command, parent=context)
    if command is main and rest and not rest[0].startswith("-"):
        raise click.UsageError(f"no command {rest[0]}")
    command.make_parser(context).parse_args(list(rest))


def test_every_command_line_is_one_that_its_program_takes() -> None:
    wrong, count = [], 0
    for page in pages():
        for words in commands(page):
            count += 1
            try:
                parse(words)
            except (click.ClickException, SystemExit) as error:
                wrong.append(f"{page}: {shlex.join(words)}: {error}")
    assert count > 100
    assert not wrong, "\n".join(wrong)


def test_every_listing_of_python_is_python() -> None:
    count = 0
    for page in pages():
        for block in blocks(page, "python"):
            compile(block.text, page, "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
            count += 1
    assert count > 30


# -- scenarios of the how-tos ---------------------------------------------------------------------------------------------------------------

HOW_TOS = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs/how-to").rglob("*.md"))
OF_SCENARIOS = frozenset(Scenario.__struct_fields__)
OF_VEHICLES = frozenset(VehicleFile.__struct_fields__)
_LISTING = re.compile(
    r"(?:at the end of `(?P<longer>[\w.]+)`:\n+)?(?P<indent> *)```toml\n(?P<text>.*?)^(?P=indent)```", re.S | re.M
)
_RUN = re.compile(r"\buwserver (?:run|play) (?![-A-Z.])([\w./]+)|uwserver\.(?:load|batch)\(['\"]([\w./]+)")


def with_part(base: str, part: str) -> str:
    """A scenario with a part of a page at its end. What a vehicle file takes, a vehicle of a scenario takes as an override."""
    keys = set(tomllib.loads(part))
    if keys <= OF_SCENARIOS:
        return f"{base}\n{part}"
    assert keys <= OF_VEHICLES, f"neither of a scenario nor of a vehicle: {sorted(keys - OF_SCENARIOS)}"
    return base + "\n" + tomli_w.dumps({"vehicles": {"rov": {"override": tomllib.loads(part)}}})


def adapters_beside(folder: Path) -> dict[str, Any]:
    """Configuration types of adapters by kind: the installed ones, and those that a page's own Python files define."""
    made = (value for file in folder.glob("*.py") for value in runpy.run_path(str(file)).values())
    own = [value.Config for value in made if isinstance(getattr(value, "Config", None), type)]
    return installed_adapters() | {str(config.__struct_config__.tag): config for config in own}


@pytest.mark.parametrize("page", HOW_TOS)
def test_scenarios_of_a_how_to_run(page: str, tmp_path: Path) -> None:
    """The first that it shows or runs is whole, and its parts fit where they are put."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for block in blocks(page):
        if block.file:
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
    for name, write in FILES.items():
        if name in text:
            write(tmp_path / name)
    adapters = adapters_beside(tmp_path)
    shipped = {path.stem: path for path in (ROOT / "scenarios/uwserver_scenarios").glob("*.toml")}
    first_run = _RUN.search(text)
    whole_at = [first_run.start()] if first_run and (first_run[1] or first_run[2]) in shipped else []
    if "uwserver new tank" in text:
        whole_at.append(text.index("uwserver new tank"))
    for found in _LISTING.finditer(text):
        listing = textwrap.dedent(found["text"])
        keys = set(tomllib.loads(listing))
        if not keys & (OF_SCENARIOS | OF_VEHICLES):
            continue  # a mapping of a log, the metadata of a package
        if "schema" in keys:
            whole_at.append(found.start())
        elif keys <= OF_SCENARIOS:
            assert min(whole_at, default=len(text)) < found.start(), f"a part before anything whole:\n{listing}"
        longer = (found["longer"] or "").removesuffix(".toml")
        if longer in shipped:
            assert f"uwserver copy {longer}" in text
        base = (
            shipped.get(longer, tmp_path / f"{longer}.toml").read_text()
            if longer
            else starter("tank", "bluerov2_heavy")
        )
        scenario = tmp_path / f"{len(whole_at)}_{found.start()}.toml"
        scenario.write_text(listing if "schema" in keys else with_part(base, listing), encoding="utf-8")
        try:
            build(load(scenario, adapters=adapters)).step(2)
        except ScenarioError as error:
            raise AssertionError(f"{listing}\n{error}") from error
    if first_run is not None:
        assert min(whole_at, default=len(text)) <= first_run.start(), (
            f"runs a scenario that it has not shown: {first_run[0]}"
        )


@pytest.mark.parametrize(
    "page", [page if page in CHEAP else pytest.param(page, marks=pytest.mark.slow) for page in FOLLOWED]
)
def test_a_reader_can_follow_the_page(page, tmp_path):
    assert follow(page, tmp_path)


@pytest.mark.slow
def test_the_tutorial_leads_to_a_controller_that_holds_its_depth(tmp_path):
    said = follow("docs/tutorial.md", tmp_path)
    before, after = (
        float(re.findall(r"depth=([\d.]+)", printed(said, f"echo bluerov2/depth -n {n}"))[-1]) for n in (3, 1)
    )
    assert after > before + 0.5
    assert re.search(r"depth (3\.9\d|4\.0\d) m", printed(said, "client.pause()"))
    assert "rov/cheap_depth 10 Hz" in printed(said, "uwserver check") or (tmp_path / "dive.mcap").exists()


@pytest.mark.slow
def test_camera_and_sonar_are_looked_at_saved_recorded_and_searched(tmp_path):
    for module in ("PIL", "av", "matplotlib", "embreex"):
        pytest.importorskip(module, reason="pip install 'uwserver[pictures,video,plot,solid]'")
    import av
    from PIL import Image

    said = follow("docs/tutorial/sonar-and-camera.md", tmp_path)
    assert "% of a core" in printed(said, "uwserver check")
    with Image.open(tmp_path / "camera.png") as picture:
        assert picture.size == (640, 480)
    assert np.load(tmp_path / "sonar.npz")["image"].shape == (400, 512)
    found = printed(said, "client.reset()")
    (camera,) = (float(n) for n in re.findall(r"camera: \d{4} pixels at ([\d.]+) degrees", found))
    ((distance, sonar),) = [map(float, pair) for pair in re.findall(r"sonar: ([\d.]+) m at ([\d.]+) degrees", found)]
    # The float's centre is 2.4 m ahead of the lens, 2.35 m of the sonar, 0.3 m to starboard and 0.4 m below.
    assert camera == pytest.approx(7.1, abs=1.0)
    assert sonar == pytest.approx(7.3, abs=1.0)
    assert distance == pytest.approx(2.15, abs=0.1)
    for name in ("camera.mp4", "sonar.mp4"):
        with av.open(tmp_path / name) as video:
            assert sum(1 for _ in video.decode(video=0)) > 15


@pytest.mark.slow
def test_the_c_program_is_built_and_run_as_its_page_says(tmp_path):
    """tests/unit/client/test_examples.py has it speak to a server that is none."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: cc is not installed")
    said = follow("clients/c/README.md", tmp_path)
    assert printed(said, "./uw_drive").count('"port":"bluerov2/imu"') == 5


@pytest.mark.slow
def test_own_components_are_checked_served_and_commanded(tmp_path):
    said = follow("docs/how-to/extend.md", tmp_path)
    assert printed(said, "echo rov/turbidity").count("turbidity=") == 5
    assert "50 commands applied" in printed(said, "send rov/jet")
    assert printed(said, "echo rov/oxygen").count("oxygen=") == 5
    assert "5 passed" in printed(said, "def test_jet")


@pytest.mark.slow
def test_a_dive_is_recorded_read_drawn_and_replayed(tmp_path):
    said = follow("docs/how-to/record.md", tmp_path)
    assert (tmp_path / "dive.mcap").exists()
    assert list(tmp_path.glob("*.png"))
    assert "replay" in " ".join(said)


@pytest.mark.slow
def test_a_report_is_written(tmp_path):
    follow("docs/how-to/report.md", tmp_path)
    assert "</html>" in (tmp_path / "dive.html").read_text()
    assert {path.suffix for path in (tmp_path / "results").iterdir()} == {".html", ".png", ".pdf"}


@pytest.mark.slow
def test_the_sea_moves(tmp_path):
    said = follow("docs/how-to/sea.md", tmp_path)
    velocity = re.findall(r"-?\d\.\d+(?:e-\d+)?", printed(said, "ScenarioBuilder"))
    assert any(abs(float(v)) > 1e-3 for v in velocity[:3])


@pytest.mark.slow
def test_something_is_touched(tmp_path):
    said = follow("docs/how-to/touch-something.md", tmp_path)
    crate = [float(place) for place in re.findall(r"crate at ([\d.]+) m", printed(said, "client.send"))]
    assert len(crate) == 10
    assert crate[0] == 0.8
    assert crate[-1] > 1.5


@pytest.mark.slow
def test_a_state_is_saved_and_loaded(tmp_path):
    said = follow("docs/how-to/states.md", tmp_path)
    assert (tmp_path / "later.uwstate").stat().st_size > 1000
    assert "tick 480" in printed(said, "state = world.save()")
    assert "back at tick" in printed(said, "first = rov.call")
    assert [path.name for path in (tmp_path / "states").iterdir()] == ["calm.uwstate"]


@pytest.mark.slow
def test_where_the_time_goes_is_told(tmp_path):
    said = follow("docs/how-to/profile.md", tmp_path)
    assert "altimeter" in printed(said, "call world/profile")
    assert printed(said, "profile.close").startswith("profile of 2400 ticks")


@pytest.mark.slow
def test_a_dive_over_mavlink(tmp_path):
    """The scenario of the page, with the UDP port changed in it and in the listing."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    (listing,) = blocks("docs/how-to/mavlink.md", "python")
    command = blocks("docs/how-to/mavlink.md", "sh")[0].text.strip()
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shipped = ROOT / "scenarios/uwserver_scenarios/bluerov2_qgc.toml"
    assert "14550" in listing.text
    assert command.split()[-1] == shipped.stem
    (tmp_path / "dive.toml").write_text(shipped.read_text().replace("127.0.0.1:14550", f"127.0.0.1:{port}"))
    with Reader(tmp_path) as reader:
        reader.type(command.replace("bluerov2_qgc", "dive.toml"))
        code = listing.text.replace("14550", str(port))
        reader.run_python(code)
        assert "LOCAL_POSITION_NED {" in reader.said[code]


def test_a_grid_is_made_and_one_is_converted(tmp_path):
    page = "docs/how-to/seabed-and-structures.md"
    (tmp_path / "g.asc").write_text(
        "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -1\n-1 -2\n-3 -4\n"
    )
    (convert,) = [line for line in blocks(page, "sh")[0].text.splitlines() if line.startswith("python -c")]
    (slope,) = blocks(page, "python")
    with Reader(tmp_path) as reader:
        reader.type(convert)
        reader.run_python(slope.text)
    assert np.load(tmp_path / "slope.npy").shape == (101, 101)
    assert np.load(tmp_path / "g.npy").tolist() == [[3.0, 4.0], [1.0, 2.0]]


def test_a_rate_that_does_not_divide_is_refused_with_those_that_do(tmp_path):
    """What the tutorial proposes as a mistake."""
    with Reader(tmp_path) as reader:
        reader.type("uwserver new tank")
        text = (tmp_path / "tank.toml").read_text()
        (tmp_path / "tank.toml").write_text(text.replace("rate_hz = 30", "rate_hz = 100"))
        with pytest.raises(AssertionError, match=r"(?s)tank.toml:\d+:\d+.*80.*120"):
            reader.type("uwserver check tank.toml")


@pytest.mark.parametrize(("target", "command"), STARTS.items())
def test_make_starts_what_the_reader_starts(target, command):
    recipe = re.search(rf"^{target.removeprefix('make ')}:.*\n\t(.*)$", (ROOT / "Makefile").read_text(), re.M)
    assert recipe
    assert re.sub(r"@exec \$\(BIN\)/| \$\(ARGS\)", "", recipe[1]) == command


def test_every_page_with_a_command_is_followed():
    here = Path(__file__).read_text()
    for page in pages():
        if page in NOT_FOLLOWED:
            continue
        if page in ELSEWHERE:
            text = (ROOT / ELSEWHERE[page]).read_text()
            assert Path(page).name in text or "PAGE" in text, page
        elif blocks(page, "sh") or blocks(page, "python"):
            assert page in FOLLOWED or f'"{page}"' in here, page

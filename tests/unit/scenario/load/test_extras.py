"""What a scenario needs and this machine has not is told in one line, with one command, before anything else is done."""

from __future__ import annotations

from importlib.util import find_spec

import msgspec
import pytest
from click.testing import CliRunner
from uwserver_adapters.ardupilot.dvl import DvlTable

from uwserver.cli import main
from uwserver.packages import install_command
from uwserver.scenario.load import extras
from uwserver.scenario.load.extras import Missing, missing_extras
from uwserver.scenario.load.scenario import load

MAVLINK = "pymavlink.dialects.v20.ardupilotmega"


@pytest.fixture
def without(monkeypatch):
    """Makes packages look as if they were not installed."""

    def hide(*packages: str) -> None:
        def find(name: str):
            if name.partition(".")[0] in packages:
                if "." in name:
                    raise ModuleNotFoundError(name)
                return None
            return find_spec(name)

        monkeypatch.setattr(extras, "find_spec", find)
        monkeypatch.setattr("uwserver.physics.collision.engine.find_spec", find)
        monkeypatch.setattr("uwserver.scenario.solids.shapes.find_spec", find)

    return hide


@pytest.mark.parametrize("scenario", ["bluerov2_qgc", "bluerov2_px4"])
def test_the_extras_of_adapters_are_named(without, adapters, scenario):
    assert load(scenario, adapters=adapters).missing is None
    without("pymavlink")
    command = install_command("uwserver")
    assert str(load(scenario, adapters=adapters).missing) == (
        f"not installed: pymavlink; install all that this scenario needs: {command}"
    )


def test_one_command_installs_all(without, adapters, tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(
        'schema = 1\n[vehicles.a]\nmodel = "bluerov2"\nposition_ned_m = [0, 0, 2]\n[server]\nuvloop = true\n'
        '[adapters.gcs]\nkind = "mavlink"\nlinks = ["zenoh:tcp/127.0.0.1:7117"]\n'
    )
    without("pymavlink", "zenoh", "uvloop")
    missing = load(path, adapters=adapters).missing
    assert str(missing).endswith(install_command("uwserver[uvloop]"))
    path.write_text(path.read_text() + "required = false\n")
    assert str(load(path, adapters=adapters).missing).endswith(install_command("uwserver[uvloop]"))


def test_faults_of_missing_engines_come_with_the_command_for_everything(without):
    without("pybullet", "coal", "pymavlink")
    done = CliRunner().invoke(main, ["check", "bluerov2_qgc", "pool_inspection"])
    assert done.exit_code == 1
    assert (
        f"not installed: pymavlink, pybullet or coal; install all that this scenario needs: {install_command('uwserver[solid]')}"
        in done.output
    )
    assert (
        f"warning: not installed: pybullet or coal; install all that this scenario needs: {install_command('uwserver[solid]')}"
        in done.output
    )


def test_check_fails_and_run_ends_before_it_compiles(without, monkeypatch):
    without("pymavlink")
    monkeypatch.setattr("uwserver.scenario.build.world.prepare", lambda *_: pytest.fail("came to compiling"))
    for command in ("check", "run"):
        done = CliRunner().invoke(main, [command, "bluerov2_qgc"])
        assert done.exit_code == 1
        assert install_command("uwserver") + "\n" in done.output
        assert "ok: " not in done.output


def test_adapters_name_what_they_need_as_they_are_set(adapters):
    assert list(adapters["zenoh"]().needs().items()) == [("zenoh", "uwserver")]
    assert list(adapters["px4_hil"]().needs()) == ["pymavlink.dialects.v20.common"]
    assert list(adapters["mavlink"]().needs()) == [MAVLINK]
    assert list(adapters["mavlink"](links=("zenoh:tcp/127.0.0.1:7117",)).needs()) == [MAVLINK, "zenoh"]
    assert not adapters["ardupilot_json"]().needs()
    assert list(adapters["ardupilot_json"](dvl=DvlTable()).needs()) == [MAVLINK]
    assert not adapters["sockets"]().needs()
    assert not adapters["moos"]().needs()


@pytest.mark.parametrize(
    ("engine", "missing"),
    [
        ("auto", None),
        ("bullet", ("pybullet",)),
        ("coal", None),
    ],
)
def test_one_engine_is_enough_unless_another_is_named(engine, missing, adapters, monkeypatch):
    monkeypatch.setattr(
        "uwserver.physics.collision.engine.find_spec", lambda name: None if name == "pybullet" else name
    )
    scenario = load("pool_inspection", adapters=adapters).scenario
    chosen = msgspec.structs.replace(scenario, world=msgspec.structs.replace(scenario.world, engine=engine))
    assert missing_extras(chosen, is_solid=True) == (missing and Missing(missing, install_command(*missing)))

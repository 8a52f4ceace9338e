from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from msgspec import UNSET, UnsetType

import uwserver.cli.scenarios.check as commands
import uwserver.cli.scenarios.listing as listing
from uwserver.adapter import AdapterTable
from uwserver.cli import main
from uwserver.modifiers import ModifierConfig
from uwserver.ports import Port, Service
from uwserver.scenario.files.convert import kinds_of
from uwserver.sensors import SensorConfig

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class SocketsTable(AdapterTable, tag="sockets", kw_only=True, frozen=True):
    """Stands for the installed adapter."""

    port: int = 7600


class SeveralTable(AdapterTable, tag="several", kw_only=True, frozen=True):
    """Serves more than one thing."""

    def parts(self) -> Mapping[str, str]:
        return {"echo": "rov/ping at 9090", "dvl": "rov/dvl at 9091"}


class FindingTable(AdapterTable, tag="finding", kw_only=True, frozen=True):
    """Looks for a free port unless one is given."""

    port: int | UnsetType = UNSET


class NamingTable(AdapterTable, tag="naming", kw_only=True, frozen=True):
    """Names a port."""

    port: str = ""

    def faults(
        self, ports: Mapping[str, Port], services: Mapping[str, Service]
    ) -> Iterable[tuple[tuple[str, ...], str]]:
        assert "rov/depth/set" in services
        if self.port not in ports:
            yield ("port",), f'no port "{self.port}"'


_kinds = cache(listing.sensor_kinds)
_ADAPTERS = {"sockets": SocketsTable, "several": SeveralTable, "naming": NamingTable, "finding": FindingTable}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(commands, "installed_adapters", lambda: _ADAPTERS)
    monkeypatch.setattr(listing, "sensor_kinds", _kinds)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(name: str, *arguments: str) -> Result:
    return CliRunner().invoke(main, [name, *arguments])


def test_check_sums_up_what_is_right() -> None:
    result = run("check", "bluerov2_pool")
    assert result.exit_code == 0
    assert result.stdout.startswith(
        "ok: bluerov2_pool: physics 240 Hz; vehicles: bluerov2 (bluerov2_heavy); ports: bluerov2/"
    )
    assert "bluerov2/mocap 60 Hz" in result.stdout
    assert result.stdout.endswith("; adapters: tcp (sockets, port 7600)\n")


@pytest.mark.parametrize(("port", "shown"), [("", "(finding)"), ("port = 80", "(finding, port 80)")])
def test_a_port_that_is_looked_for_is_not_shown(port: str, shown: str, folder: Path) -> None:
    (folder / "a.toml").write_text(f'schema = 1\n[adapters.f]\nkind = "finding"\n{port}\n')
    assert run("check", "a.toml").stdout.endswith(f"; adapters: f {shown}\n")


def test_check_tells_what_an_adapter_serves_where(folder: Path) -> None:
    (folder / "a.toml").write_text('schema = 1\n[adapters.d]\nkind = "several"\n')
    result = run("check", "a.toml")
    assert result.stdout.endswith("; adapters: d (several)\n  d.echo: rov/ping at 9090\n  d.dvl: rov/dvl at 9091\n")
    explained = run("check", "--explain", "a.toml")
    assert tomllib.loads(explained.stdout)["adapters"]["d"]["kind"] == "several"
    assert "d.echo: rov/ping at 9090" in explained.stderr


NAMES = """schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
truth = {{ rate_hz = 10 }}
[vehicles.rov.sensors.night]
kind = "pressure"
rate_hz = 10
enabled = false
[adapters.n]
kind = "naming"
port = "{port}"
required = {required}
truth = {truth}
"""


@pytest.mark.parametrize(
    ("port", "fault"),
    [
        ("rov/depth", ""), ("rov/dept", 'a.toml:11:1: adapters.n.port: no port "rov/dept"\n1 error\n'),
        ("rov/night", 'a.toml:11:1: adapters.n.port: no port "rov/night"; it is off: set enabled = true in its table\n1 error\n'),
    ],
)  # fmt: skip
def test_check_refuses_what_a_run_would_refuse(folder: Path, port: str, fault: str) -> None:
    (folder / "a.toml").write_text(NAMES.format(port=port, required="true", truth="false"))
    result = run("check", "a.toml")
    assert (result.exit_code, result.stderr) == (int(bool(fault)), fault)


def test_check_warns_of_what_a_run_would_try_again(folder: Path) -> None:
    (folder / "a.toml").write_text(NAMES.format(port="rov/dept", required="false", truth="false"))
    result = run("check", "a.toml")
    assert result.exit_code == 0
    assert 'a.toml:11:1: adapters.n.port: warning: no port "rov/dept"\n' in result.stderr


@pytest.mark.parametrize("truth", [False, True])
def test_ground_truth_is_there_for_adapters_that_may_serve_it(folder: Path, truth: bool) -> None:
    (folder / "a.toml").write_text(NAMES.format(port="rov/truth/pose", required="true", truth=str(truth).lower()))
    assert run("check", "a.toml").exit_code == int(not truth)


SONARS = """schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
copies = {{ count = {copies} }}
[vehicles.rov.sensors.sonar]
kind = "multibeam"
profile = "gemini_720im"
rate_hz = 10
"""


@pytest.mark.parametrize(("copies", "most"), [(2, False), (100, True)])
def test_check_tells_what_pictures_cost(folder: Path, copies: int, most: bool) -> None:
    path = folder / "sonars.toml"
    path.write_text(SONARS.format(copies=copies), encoding="utf-8")
    result = run("check", str(path))
    assert result.exit_code == 0
    found = re.search(r"pictures: in real time about (\d+) % of a core .*?\(rov_\d+/sonar (\d+) %", result.stderr)
    assert found is not None, result.stderr
    assert int(found[1]) == pytest.approx(copies * int(found[2]), rel=0.1)
    assert ("most will be dropped" in result.stderr) is most
    assert ("and 96 more" in result.stderr) is most


def test_check_tells_all_faults_of_all_files_and_fails(folder: Path) -> None:
    (folder / "a.toml").write_text("schema = 1\nsede = 1\n")
    (folder / "b.toml").write_text("schema = \n")
    result = run("check", "a.toml", "bluerov2_pool", "b.toml")
    assert result.exit_code == 1
    assert 'a.toml:2:1: unknown key "sede" (did you mean "seed"?)\n1 error\n' in result.stderr
    assert "b.toml:1:10: not valid TOML: invalid value\n1 error\n" in result.stderr
    assert result.stdout.startswith("ok: bluerov2_pool: ")


def test_check_explain_prints_toml_only() -> None:
    result = run("check", "--explain", "bluerov2_pool")
    assert result.exit_code == 0
    assert tomllib.loads(result.stdout)["vehicles"]["bluerov2"]["file"]["name"] == "bluerov2_heavy"
    assert "ok: bluerov2_pool" in result.stderr


def test_warnings_do_not_fail(folder: Path) -> None:
    text = "schema = 1\n[vehicles.v]\nmodel = 'bluerov2_heavy'\noverride.buoyancy.volume_m3 = 0.02\n"
    (folder / "light.toml").write_text(text)
    result = run("check", "light.toml")
    assert result.exit_code == 0
    assert "light.toml:4:10: vehicles.v.override.buoyancy: warning: the vehicle floats up with" in result.stderr
    assert result.stdout.startswith("ok: light.toml")


def test_check_says_which_code_it_ran(folder: Path) -> None:
    (folder / "mine.py").write_text("SENSORS = ()\n")
    (folder / "a.toml").write_text('schema = 1\nextensions = ["mine.py"]\n')
    assert run("check", "a.toml").stdout.endswith("adapters: sockets (sockets, port 7600); ran mine.py\n")


@pytest.mark.parametrize(("option", "key"), [("--scenario", "vehicles"), ("--vehicle", "rigid_body")])
def test_schema_is_json_of_the_right_file(option: str, key: str) -> None:
    document = json.loads(run("schema", option).stdout)
    name = document["$ref"].rsplit("/", 1)[1]
    assert key in document["$defs"][name]["properties"]


def test_schema_is_of_scenarios_by_default() -> None:
    assert run("schema").stdout == run("schema", "--scenario").stdout


def test_list_names_everything_with_one_line_each() -> None:
    result = run("list")
    assert result.exit_code == 0
    for section in ("scenarios", "vehicles", "devices", "sensors", "actuators", "modifiers", "adapters"):
        lines = [line for line in run("list", section).stdout.splitlines() if not line.startswith(" ")]
        assert lines
        assert all(len(line.split(maxsplit=1)) == 2 for line in lines), lines
        assert f"{section}:\n" in result.stdout
        assert all(f"  {line}" in result.stdout for line in lines)
    assert any(line.startswith("pressure ") for line in run("list", "sensors").stdout.splitlines())
    assert run("list", "boats").exit_code == 2


def test_list_sensors_tells_fields_units_frames_keys_and_profiles() -> None:
    """Of every kind, however it is configured."""
    text = run("list", "sensors").stdout
    assert re.search(r"^      pressure +scalar +Pa +- +absolute pressure$", text, re.M)
    assert re.search(r"^      depth +scalar  m +- ", text, re.M)
    assert re.search(r"^      v_S +3 +m/s +S +velocity of the mount over ground$", text, re.M)
    assert "profiles: a50 (Water Linked DVL A50), dvl1000" in text
    assert "beam_angle_deg (22.5)" in text
    for kind in kinds_of(SensorConfig):
        alone = run("list", "sensors", kind).stdout
        assert alone.startswith(f"{kind} ")
        assert alone in text
        assert "\n    keys: " in alone
    assert run("list", "sensors", "dvl2").exit_code == 2


def test_list_modifiers_tells_their_keys() -> None:
    lines = run("list", "modifiers").stdout.splitlines()
    assert len(lines) == 2 * len(kinds_of(ModifierConfig))
    assert "    keys: field (required), rate (0), rate_sigma (0), density (0)" in lines

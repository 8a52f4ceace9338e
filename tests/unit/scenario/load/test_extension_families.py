"""Actuators, currents and faults of an extension: the examples of the how-to page in a world, and every way to get them wrong."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from run_rig import recorded_run

from uwserver.recording.replay import NotReplayable, replay
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.world.state import snapshot
from uwserver.world.world import World


def built(scenario: Path, seed: int | None = None) -> World:
    return build(load(scenario, adapters={}), seed)


def changed(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def refused(scenario: Path) -> str:
    with pytest.raises(ScenarioError) as error:
        load(scenario, adapters={})
    return str(error.value)


def restored_runs_on_as_before(world: World, ticks: int, act: Callable[[World], object] = lambda _: None) -> None:
    """From a snapshot on, `act` and the ticks after it give the same state each time."""
    world.call("world/snapshot")
    act(world)
    world.step(ticks)
    first = world.call("world/state_hash")
    world.step(7)
    world.call("world/restore")
    act(world)
    world.step(ticks)
    assert world.call("world/state_hash") == first


# -- an actuator ------------------------------------------------------------------------------------------------------------------------


def test_the_jet_pushes_and_its_valve_sticks(beside: Path) -> None:
    world = built(beside / "pool.toml")
    port = world.ports["rov/jet"]
    assert (port.kind, port.direction, [field.name for field in port.fields]) == ("jet", "actuator", ["u"])
    moved = []
    for u in (0.3, 0.8, 0.3, 0.05, 0.3):
        world.call("world/reset") if u == 0.8 else None
        world.command("rov/jet", u=u)
        world.step(1)
        moved.append(world.hydro.wrenches["bias"][1].tolist())
    assert moved[0] == [0.0] * 6
    assert moved[1] == pytest.approx([0.0, 12.0, 0.0, 0.0, 0.0, 2.4])
    assert moved[2] == pytest.approx([0.0, 4.5, 0.0, 0.0, 0.0, 0.9])
    assert moved[3:] == [[0.0] * 6] * 2


def test_the_jet_moves_the_vehicle_along_its_axis(beside: Path) -> None:
    still, pushed = built(beside / "pool.toml"), built(beside / "pool.toml")
    pushed.command("rov/jet", u=1.0)
    for world in (still, pushed):
        world.step(200)
    assert pushed.vehicles["rov"].p_NB[1] > still.vehicles["rov"].p_NB[1] + 0.05
    assert pushed.vehicles["rov"].nu[5] > still.vehicles["rov"].nu[5] + 0.01


def test_the_jet_has_a_wrench_of_its_own_beside_a_force_torque(beside: Path) -> None:
    scenario = beside / "pool.toml"
    scenario.write_text(scenario.read_text() + '[vehicles.rov.override.actuators.push]\nkind = "force_torque"\n')
    world = built(scenario)
    world.command("rov/push", force_B=[1.0, 2.0, 3.0])
    world.command("rov/jet", u=1.0)
    world.step(1)
    assert world.hydro.wrenches["bias"].tolist()[0][:3] == [1.0, 2.0, 3.0]
    assert world.hydro.wrenches["bias"].tolist()[1][:3] == [0.0, 15.0, 0.0]
    world.call("rov/push/deactivate")
    assert world.hydro.wrenches["bias"].tolist()[1][:3] == [0.0, 15.0, 0.0]


def test_the_watchdog_closes_the_jet(beside: Path) -> None:
    world = built(beside / "pool.toml")
    world.command("rov/jet", u=1.0)
    world.step(242)
    assert world.hydro.wrenches["bias"][1].tolist() == [0.0] * 6


def test_the_valve_is_saved_with_the_world(beside: Path) -> None:
    """Open or closed decides what 0.3 does: the memory must come back, not only the rows."""
    world = built(beside / "pool.toml")
    world.command("rov/jet", u=0.8)
    world.step(2)
    restored_runs_on_as_before(world, 5, lambda w: w.command("rov/jet", u=0.3))
    world.call("world/snapshot")
    open_hash = world.call("world/state_hash")
    world.actuators["rov/jet"].actuator.memory.is_open = False
    assert world.call("world/state_hash") != open_hash
    world.call("world/restore")
    assert world.call("world/state_hash") == open_hash


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("return Jet(self, body)", "return Jet(body)", "override.actuators.jet: a component of kind \"jet\" cannot be built (jet.py:19): TypeError"),
        ("fields = (Field(", "fields = [Field(", "not valid Python"),
        ("fields = (Field(", "fields = (), (Field(", "its fields must be a tuple of uwserver.ports.Field"),
        ("self.memory = Valve()", "self.memory = {'open': False}", "its memory must be a msgspec Struct of plain typed values, not {'open': False}"),
        ("self.apply(((0.0,),))", "self.apply(0.0)", "(jet.py:37): TypeError"),
        ("    def build(self, body", "    def made(self, body", "jet.py:11:1: ACTUATORS: JetConfig has no method build()"),
        ('tag="jet"', 'tag="thrusters"', 'ACTUATORS: there is a kind "thrusters" already: give the class JetConfig another tag'),
        ("JetConfig(ActuatorTable", "JetConfig(Struct", "does not derive from uwserver.actuators.ActuatorTable: derive it as the shipped kinds do"),
        ("import numpy as np", "import numpy as np, no_such_module", "jet.py:3:1: running it failed: ModuleNotFoundError"),
    ],
)  # fmt: skip
def test_faults_of_an_actuator_are_told(beside: Path, old: str, new: str, told: str) -> None:
    changed(beside / "jet.py", old, new)
    text = refused(beside / "pool.toml")
    assert told in text, text


def test_keys_of_an_actuator_are_checked(beside: Path) -> None:
    changed(beside / "pool.toml", "max_force_N = 15", "max_force = 15")
    assert 'unknown key "max_force" (did you mean "max_force_N"?)' in refused(beside / "pool.toml")


def test_a_jet_that_is_taken_out_is_not_built(beside: Path) -> None:
    changed(beside / "jet.py", "return Jet(self, body)", "return Jet(body)")
    changed(beside / "pool.toml", "max_force_N = 15", "max_force_N = 15\nenabled = false")
    assert "rov/jet" not in built(beside / "pool.toml").ports


# -- a current --------------------------------------------------------------------------------------------------------------------------


def test_the_river_flows(beside: Path) -> None:
    """Tide at flood, no gusts: and the logarithmic law in the layer."""
    changed(beside / "river.toml", "gust_mps = 0.05", "gust_mps = 0.0")
    world = built(beside / "river.toml")
    north, east, down = world.water.velocity((0.0, 0.0, 5.0), 0.0)
    layer = 0.4 * np.log(7.0 / 0.01) / np.log(12.0 / 0.01)
    assert (north, east, down) == pytest.approx((0.6 + layer, 0.2, 0.0), abs=2e-3)
    surface, bottom = (world.water.velocity((0.0, 0.0, depth), 0.0)[0] for depth in (0.0, 11.995))
    assert (surface, bottom) == pytest.approx((1.0, 0.6), abs=1e-2)


def test_the_tide_turns_and_is_linear_between_its_draws(beside: Path) -> None:
    changed(beside / "river.toml", "gust_mps = 0.05", "gust_mps = 0.0\nperiod_s = 8")
    world = built(beside / "river.toml")
    seen = []
    for _ in range(4 * 240):
        world.step(1)
        seen.append(world.water.sea.rows.uniform[0])
    assert seen[480 - 1] == pytest.approx(0.0, abs=1e-9)
    assert seen[960 - 1] == pytest.approx(-0.6, abs=1e-9)
    bends = np.flatnonzero(np.abs(np.diff(seen, n=2)) > 1e-9) + 2
    assert set(bends % 120) == {0}
    assert world.vehicles["rov"].nu[0] != 0.0


def test_gusts_come_from_the_stream_of_their_path(beside: Path) -> None:
    first, same, other = (built(beside / "river.toml", seed) for seed in (1, 1, 2))
    for world in (first, same, other):
        world.step(300)
    assert first.water.sea.rows.uniform.tolist() == same.water.sea.rows.uniform.tolist()
    assert first.water.sea.rows.uniform.tolist() != other.water.sea.rows.uniform.tolist()


def test_the_river_is_saved_with_the_world(beside: Path) -> None:
    world = built(beside / "river.toml")
    world.step(130)
    restored_runs_on_as_before(world, 400)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("return Tide(self)", "return None", "something with velocity() and an interval_s above 0, not NoneType"),
        ("interval_s = 0.5", "interval_s = 0.0", "an interval_s above 0, not Tide"),
        ("            return tide + gust", "            return [1.0, 2.0]", "velocity() must return three finite numbers, not [1.0, 2.0]"),
        ("            return tide + gust", "            return tide / 0.0 * gust", "velocity() must return three finite numbers"),
        ("gust = c.gust_mps * rng", "gust = c.gusts * rng", "AttributeError: 'TideConfig' object has no attribute 'gusts'"),
        ("(self.bottom_depth_m, self.roughness_m, 20)", "(self.roughness_m, self.bottom_depth_m, 20)", "environment.currents.layer.depth_m[1]: "),
        ('tag="tide"', 'tag="uniform"', 'CURRENTS: there is a kind "uniform" already: give the class TideConfig another tag'),
        ('tag="tide", ', "", "CURRENTS: TideConfig has no tag"),
        ("    def build(self) -> \"Tide\":", "    def made(self) -> \"Tide\":", "CURRENTS: TideConfig has no method build()"),
        ("TideConfig(CurrentTable, ", "TideConfig(Table, ", "from uwserver.environment.currents.CurrentTable: derive it as the shipped kinds do"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_faults_of_a_current_are_told(beside: Path, old: str, new: str, told: str) -> None:
    changed(beside / "river.py", old, new)
    changed(beside / "river.py", "NonNegative, Positive, Vector3", "NonNegative, Positive, Table, Vector3")
    text = refused(beside / "river.toml")
    assert told in text, text


def test_a_current_refuses_keys_that_do_not_go_together(beside: Path) -> None:
    changed(beside / "river.toml", "bottom_depth_m = 12", "bottom_depth_m = 12\nroughness_m = 7")
    text = refused(beside / "river.toml")
    assert (
        'river.toml:9:23: environment.currents.layer: a component of kind "bottom_layer" cannot be built (river.py:'
        in text
    )
    assert "ValueError: roughness_m must be below half of bottom_depth_m" in text


# -- a fault ----------------------------------------------------------------------------------------------------------------------------


def test_the_loose_connector_comes_to_faults_of_a_shipped_kind(beside: Path) -> None:
    world = built(beside / "trial.toml")
    faults = world.call("world/faults")
    assert len(faults) > 3
    assert [fault["name"] for fault in faults] == [f"plug/{k}" for k in range(1, len(faults) + 1)]
    assert {(fault["kind"], fault["target"]) for fault in faults} == {("thruster_dead", "rov/thrusters")}
    assert faults[0]["at_s"] == 10.0
    assert all(a["until_s"] < b["at_s"] for a, b in pairwise(faults))
    assert max(fault["until_s"] for fault in faults) <= 60.0


def test_the_thrusters_stop_while_it_is_loose(beside: Path) -> None:
    changed(beside / "trial.toml", "at_s = 10", "at_s = 0.5\ndead_s = 0.25")
    world = built(beside / "trial.toml")
    working = []
    for _ in range(192):
        world.step(1)
        working.append(set(world.hydro.thrusters["efficiency"].tolist()))
    assert [k for k, values in enumerate(working) if values == {0.0}] == list(range(120, 180))


def test_its_times_depend_on_the_seed_alone(beside: Path) -> None:
    first, same, other = (built(beside / "trial.toml", seed).call("world/faults") for seed in (1, 1, 2))
    assert first == same
    assert first != other


def test_the_fault_is_saved_with_the_world(beside: Path) -> None:
    changed(beside / "trial.toml", "at_s = 10", "at_s = 0.1\ndead_s = 0.2")
    world = built(beside / "trial.toml")
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(40)
    restored_runs_on_as_before(world, 60)
    assert world.call("world/clear_fault", name="plug/1") is None


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("return tuple(faults)", "return ()", "build() must give a tuple of faults of shipped kinds, not ()"),
        ("return tuple(faults)", "return (self,)", "build() must give a tuple of faults of shipped kinds, not (LooseConnectorConfig("),
        ("return tuple(faults)", "return faults[0].nothing", "AttributeError"),
        ("target=self.target", "target='rov/legs'", 'plug: it results in a "thruster_dead" fault with an error: target: no actuator of thrusters'),
        ("every_s: Positive = 10.0", "every_s: Positive", 'missing key "every_s"'),
        ('tag="loose_connector"', 'tag="mass_loss"', 'FAULTS: there is a kind "mass_loss" already: give the class LooseConnectorConfig another tag'),
        ("    def build(self", "    def made(self", "FAULTS: LooseConnectorConfig has no method build()"),
        ("Config(FaultTable", "Config(msgspec.Struct", "does not derive from uwserver.world.faults.FaultTable: derive it as the shipped kinds do"),
        ("import msgspec\n", "import msgspec\nraise RuntimeError('no')\n", "loose.py:4:1: running it failed: RuntimeError: no"),
    ],
)  # fmt: skip
def test_faults_of_a_fault_are_told(beside: Path, old: str, new: str, told: str) -> None:
    changed(beside / "loose.py", old, new)
    if "missing" in told:
        changed(beside / "trial.toml", "every_s = 5", "")
    text = refused(beside / "trial.toml")
    assert told in text, text


def test_a_fault_refuses_keys_that_do_not_go_together(beside: Path) -> None:
    changed(beside / "trial.toml", "until_s = 60\n", "")
    assert "ValueError: give until_s: it would never end" in refused(beside / "trial.toml")
    changed(beside / "trial.toml", "at_s = 10", "at_s = 10\nuntil_s = 100000")
    assert "faults.plug: " in (text := refused(beside / "trial.toml"))
    assert "at most 256 faults" in text


# -- recordings -------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scenario", "extension"), [("pool", "jet"), ("river", "river"), ("trial", "loose")])
def test_a_recording_is_replayed_bit_for_bit_with_the_file(beside: Path, scenario: str, extension: str) -> None:
    changed(beside / "trial.toml", "at_s = 10", "at_s = 0.5")
    recorded_run(beside / f"{scenario}.toml", Path("x.mcap"), 1.5)
    with pytest.raises(
        NotReplayable, match=rf"its components come from the extension {extension}\.py: give --trust-files"
    ):
        replay(Path("x.mcap"))
    replayed = replay(Path("x.mcap"), [beside / f"{extension}.py"])
    assert replayed.difference is None
    assert replayed.hashes > 0


@pytest.mark.parametrize("scenario", ["tank", "pool", "river", "trial"])
def test_a_state_goes_on_in_another_world(beside: Path, scenario: str) -> None:
    changed(beside / "trial.toml", "at_s = 10", "at_s = 0.1")
    first, second = (built(beside / f"{scenario}.toml") for _ in range(2))
    if scenario == "pool":
        first.command("rov/jet", u=0.8)  # opens the valve, which a weaker command would not
    first.step(130)
    snapshot.from_bytes(second, snapshot.to_bytes(first, snapshot.take(first)))
    for world in (first, second):
        if scenario == "pool":
            world.command("rov/jet", u=0.3)
    assert first.step(60) == second.step(60)
    assert snapshot.take(first).hash() == snapshot.take(second).hash()

"""The keys of an external vehicle: what goes together, and what is told where it does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.export import explain, to_toml
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.entry import Following

HEAD = 'schema = 1\n[adapters]\n[vehicles.rov]\nmodel = "bluerov2"\ntruth = {}\n'


def loaded(tmp_path: Path, ghost: str, rov: str = ""):
    path = tmp_path / "s.toml"
    path.write_text(f'{HEAD}{rov}\n[vehicles.ghost]\nmodel = "bluerov2"\n{ghost}\n')
    return load(path, adapters={})


@pytest.mark.parametrize(
    ("ghost", "text"),
    [
        ('kind = "external"\nsolid = 1', "expected true or false"),
        ('kind = "extern"', 'one of "external", "simulated"'),
        ("solid = true", '"solid" is for vehicles of kind = "external"'),
        ('log = "a.mcap"', '"log" is for vehicles of kind = "external"'),
        ('kind = "external"\ntrack = "a"', '"track" is for poses from a log'),
        ('kind = "external"\nspeed = 2.0', '"speed" is for poses from a log'),
        ('kind = "external"\nlog = "a.mcap"', "a.mcap: it cannot be opened as a log: No such file"),
        ('kind = "external"\nlog = "a.mcap"\ntrack = "x"', "a.mcap: it cannot be opened as a log: No such file"),
        ('kind = "external"\nlog = "a.mcap"\ntrack = "x"\nstart = "today"', 'not "today"'),
        ('kind = "external"\nlog = "a.mcap"\ntrack = "x"\nspeed = 0', "greater than 0"),
        ('kind = "external"\nlog = "a.mcap"\ntrack = "x"\ncopies = { count = 2 }', "all copies would follow the same log"),
        ('kind = "external"\nlog = "a.mcap"\ntrack = "x"\npredict_s = 1.0', "is for poses that come as commands"),
        ('kind = "external"\nautopilot = {}', "is for simulated vehicles"),
        ('kind = "external"\nvelocity_frd_mps = [1.0, 0.0, 0.0]', "is for simulated vehicles"),
        ('kind = "external"\nsensors = { a = { kind = "imu", rate_hz = 10 } }', "an external vehicle measures nothing"),
        ('kind = "external"\ncompare_with = "rof"', 'no vehicle "rof" (did you mean "rov"?)'),
        ('kind = "external"\ncompare_with = "ghost"', "cannot be compared with itself"),
        ('kind = "external"\nrate_hz = 7', "7 Hz does not divide the physics rate"),
        ('kind = "external"\nmax_gap_s = 0', "greater than 0"),
        ('kind = "external"\ncolour = [1.0, 2.0, 0.0]', "a number from 0 to 1"),
        ('kind = "external"\noffset_s = nan', "it must be finite"),
        ('kind = "external"\nsolid = true\n[vehicles.ghost.override]\ncollision = {}', ""),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path, ghost, text):
    if not text:  # a table is merged, so that the shapes of the model stay
        loaded(tmp_path, ghost)
        return
    with pytest.raises(ScenarioError) as refused:
        loaded(tmp_path, ghost)
    told = [str(problem) for problem in refused.value.problems if problem.severity == "error"]
    assert any(text in line for line in told), told
    assert all("vehicles.ghost" in line for line in told)


def test_solid_without_a_shape_is_refused(tmp_path):
    bare = tmp_path / "bare.toml"
    bare.write_text(
        """schema = 1
name = "bare"
description = "no shape"
[rigid_body]
source = "test"
status = "guess"
mass_kg = 10.0
inertia_kgm2 = [1.0, 1.0, 1.0]
[buoyancy]
source = "test"
status = "guess"
volume_m3 = 0.01
[added_mass]
source = "test"
status = "guess"
diagonal = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
[damping]
"""
    )
    for solid, fine in (("false", True), ("true", False)):
        path = tmp_path / "s.toml"
        path.write_text(f'{HEAD}[vehicles.ghost]\nmodel = "bare.toml"\nkind = "external"\nsolid = {solid}\n')
        if fine:
            load(path, adapters={})
        else:
            with pytest.raises(ScenarioError, match="has no collision shapes"):
                load(path, adapters={})


def test_of_its_model_remains_what_can_be_seen_and_touched(tmp_path):
    ghost = loaded(tmp_path, 'kind = "external"').vehicles["ghost"]
    assert not ghost.vehicle.sensors
    assert not ghost.vehicle.actuators
    assert ghost.vehicle.thrusters  # which turn in the view
    assert ghost.solid is None
    assert ghost.ghost is not None
    solid = loaded(tmp_path, 'kind = "external"\nsolid = true').vehicles["ghost"]
    assert solid.ghost is None
    assert solid.solid is not None


def test_ghosts_make_nothing_solid(tmp_path):
    """Two solid vehicles need the engines of contact; one beside a ghost needs none."""
    assert not loaded(tmp_path, 'kind = "external"').is_solid
    assert loaded(tmp_path, 'kind = "external"\nsolid = true').is_solid


def test_its_place_is_not_judged(tmp_path):
    """It may stand in another vehicle or in a wall: its source knows."""
    assert [warning.path for warning in loaded(tmp_path, 'kind = "external"').warnings] == ["adapters"]


def test_simulated_vehicles_say_nothing_of_it(tmp_path):
    shown = explain(loaded(tmp_path, 'kind = "external"\ncolour = [1.0, 0.0, 0.0]'))
    rov, ghost = shown.split("[vehicles.ghost]")
    assert "max_gap_s" not in rov
    assert "max_gap_s = 1.0" in ghost


def test_it_is_written_as_it_was_read(tmp_path):
    scenario = loaded(tmp_path, 'kind = "external"\noutside = "hold"\nmax_gap_s = 3.0').scenario
    (tmp_path / "again.toml").write_text(to_toml(scenario))
    assert load(tmp_path / "again.toml", adapters={}).scenario.vehicles == scenario.vehicles


def test_start_is_a_word_or_a_number():
    for start in ("first", 3, 2.5):
        raw: dict[str, Any] = {"start": start}
        assert msgspec.convert(raw, Following).start == start

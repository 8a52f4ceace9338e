"""What a kind declares: others go by it, also where the kind is of an extension, and it is told where it cannot be.

Also of uwserver.ports.messages and uwserver.sensors.base.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from uwserver_adapters.ros.messages.catalogue import topics_of
from uwserver_adapters.ros.messages.ros_port import Facts
from uwserver_adapters.ros.messages.types import Types

from uwserver.adapter import installed_adapters
from uwserver.physics.kernel.store import kernel_name
from uwserver.ports.messages import STANDARD
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.fittings import sensor_views
from uwserver.sensors import Pose
from uwserver.sensors.compiled import CompiledSensor, loops_of
from uwserver.world.stepping.kernel_stages import kernels_of
from uwserver.world.stepping.piloting import Piloting

SCENARIO = """
schema = 1
extensions = ["mine.py"]

[vehicles.rov]
model = "bluerov2"
position_ned_m = [0.0, 0.0, 5.0]
autopilot = {}
override.sensors.imu.enabled = false

[vehicles.rov.sensors.feeling]
kind = "feeling"
rate_hz = 60
"""
KIND = """
from uwserver.ports import BeamView, Field
from uwserver.sensors import IdealSensor, Pose, Scope, SensorTable, Traits


class FeelingConfig(SensorTable, tag="feeling", kw_only=True, frozen=True):
    message = "Imu"

    def traits(self) -> Traits:
        return Traits(beams=(BeamView((0.0, 1.0, 0.0), 0.0, 0.0, 3.0),), sigmas={"w_S": (0.01,)})

    def build(self, mount: Pose) -> "Feeling":
        return Feeling(mount)


class Feeling(IdealSensor):
    doc = "Feels."
    fields = (Field("f_S", "m/s^2", "force", "S", (3,)), Field("w_S", "rad/s", "rate", "S", (3,)))
    needs_rates = True

    def __init__(self, mount: Pose) -> None:
        self.mount = mount

    def measure(self, scope: Scope):
        return True, [tuple(scope.specific_force(self.mount)), tuple(scope.w_NB_B)]


SENSORS = (FeelingConfig,)
"""


def loaded(folder: Path, kind: str = KIND) -> Resolved:
    (folder / "mine.py").write_text(kind)
    (folder / "mine.toml").write_text(SCENARIO)
    return load(folder / "mine.toml", adapters={})


def test_an_extension_that_says_imu_is_one(tmp_path: Path) -> None:
    resolved = loaded(tmp_path)
    world = build(resolved)
    port = world.ports["rov/feeling"]
    assert port.message == "Imu"
    (sensor_topic,) = topics_of(Types(), Facts(), port)
    assert sensor_topic.type == "sensor_msgs/msg/Imu"
    (view,) = (view for view in sensor_views("rov", resolved.vehicles["rov"].vehicle) if view.kind == "feeling")
    assert (view.beams[0].far, view.sigmas) == (3.0, {"w_S": (0.01,)})
    pilot = world.parts["rov/autopilot"]
    assert isinstance(pilot, Piloting)
    assert "rov/feeling" in pilot.pilot.spec.inputs.ports


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('"w_S", "rad/s"', '"turn_S", "rad/s"', 'message = "Imu" needs a field "w_S"'),
        ("return Traits(beams", "return 1 / 0, Traits(beams", "cannot be built .*mine.py:10.*ZeroDivisionError"),
        (
            "return Traits(beams=",
            'return Traits(("warp",), beams=',
            "there is no stage warp; there are: fins in contact",
        ),
        ("return Traits(beams", "return dict(beams", "must return a uwserver.sensors.Traits"),
    ],
)
def test_what_cannot_be_declared_is_told(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert old in KIND
    with pytest.raises(ScenarioError, match=text):
        loaded(tmp_path, KIND.replace(old, new))


def test_shipped_kinds_have_the_fields_of_their_messages_and_the_stages_of_their_kernels() -> None:
    vehicles = load("one_of_everything", adapters=installed_adapters()).vehicles.values()
    seen = set()
    for config in (config for vehicle in vehicles for config in vehicle.vehicle.sensors.values()):
        built = config.build(Pose())
        assert set(STANDARD.get(config.message, ())) <= {field.name for field in built.fields}, config
        if isinstance(built, CompiledSensor):
            names = {kernel_name(kernel.py_func) for kernel in loops_of(built.kernel)}
            (stage,) = (each for each in ("sensors", "soundings", "sonars") if names <= {*kernels_of(each)})
            assert stage == "sensors" or stage in config.traits().stages, config
        seen.add(config.message)
    assert STANDARD.keys() - {"Teleport", "Wrench"} <= seen

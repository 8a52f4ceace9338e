"""Parameters of the node, without a transport: what is listed, read and changed, and what is refused."""

from __future__ import annotations

import asyncio

import pytest
from ros2_rig import Rig, story
from ros_rig import flying
from uwserver_adapters.ros import parameters as ros_parameters
from uwserver_adapters.ros2.parameters import value_of

from uwserver.adapter import Conversation
from uwserver.ports import Argument, Refused, Service
from uwserver.testing import FakeContext

RATE = Argument("rate_hz", "float", "samples a second", "Hz", required=False, minimum=0.1)
BEAMS = Argument("beams", "int", "number", required=False, shape=(2,))
NAME = Argument("name", "str", "gain", choices=("depth_p", "depth_i"))
SERVICES = (
    *(Service(f"rov/imu/{verb}", "Of an IMU.") for verb in ("get", "activate", "deactivate")),
    Service("rov/imu/set", "Of an IMU.", (RATE, Argument("colour", "str", "word", required=False, choices=("red", "blue")), BEAMS)),
    *(Service(f"rov/dvl/{verb}", "Of a DVL.") for verb in ("get",)),
    Service("rov/dvl/set", "Of a DVL.", (RATE, Argument("more", "json", "anything", required=False))),
    Service("rov/autopilot/get_gains", "Gains."),
    Service("rov/autopilot/set_gain", "Change one.", (NAME, Argument("value", "float", "its value"))),
)  # fmt: skip
DOUBLE, STRING = 3, 4


class Settable(Rig):
    """A world with a few settings, and what a client does with them."""

    def __init__(self):
        world = flying()
        world.services = {**world.services, **{service.path: service for service in SERVICES}}
        self.imu = {"rate_hz": 100.0, "active": True, "colour": "red", "beams": [1, 2], "mount": {"x": 1}}
        world.scripts.update({
            "rov/imu/get": lambda _: self.imu, "rov/dvl/get": lambda _: {"rate_hz": None},
            "rov/autopilot/get_gains": lambda _: {"depth_p": 0.8}, "rov/imu/set": self.change,
        })  # fmt: skip
        super().__init__(world)

    def change(self, args):
        given = {key: value for key, value in args.items() if value is not None}
        if given.get("rate_hz") == 33.0:
            raise Refused("bad_argument", "33 Hz does not divide the physics rate", "rate_hz")
        self.imu.update(given)

    async def ask(self, short, **fields):
        answers = self.wire.call(f"/uwserver/{short}", **fields)
        for _ in range(20):
            await asyncio.sleep(0)
        (answer,) = answers
        return answer

    def parameter(self, name, kind, value):
        field = {1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 7: "integer_array_value"}[
            kind
        ]
        filled = self.types.filled("rcl_interfaces/msg/ParameterValue", field, value)
        made = self.types.make("rcl_interfaces/msg/ParameterValue", type=kind, **{field: filled})
        return self.types.make("rcl_interfaces/msg/Parameter", name=name, value=made)


IMU = ["rov.imu.active", "rov.imu.beams", "rov.imu.colour", "rov.imu.rate_hz"]


@story(Settable)
async def test_all_settings_are_listed(rig):
    told = (await rig.ask("list_parameters")).result
    assert told.names == ["rov.autopilot.depth_i", "rov.autopilot.depth_p", "rov.dvl.rate_hz", *IMU]
    assert told.prefixes == ["rov.autopilot", "rov.dvl", "rov.imu"]
    assert (await rig.ask("list_parameters", prefixes=["rov.imu"])).result.names == IMU
    assert (await rig.ask("list_parameters", prefixes=["rov.im"])).result.names == []
    assert (await rig.ask("list_parameters", prefixes=["rov"], depth=1)).result.names == []
    assert (await rig.ask("list_parameters", prefixes=["rov"], depth=2)).result.prefixes == told.prefixes
    assert (await rig.ask("list_parameters", depth=2)).result.names == []


@story(Settable)
async def test_values_are_read_with_one_call_of_each_component(rig):
    names = [*IMU, "rov.dvl.rate_hz", "rov.autopilot.depth_p", "rov.autopilot.depth_i", "rov.imu.mount", "x" * 500]
    told = (await rig.ask("get_parameters", names=names)).values
    assert [value_of(one) for one in told] == [True, [1, 2], "red", 100.0, None, 0.8, None, None, None]
    assert len([call for call in rig.world.calls if call.service == "rov/imu/get"]) == 1
    kinds = (await rig.ask("get_parameter_types", names=names)).types.tolist()
    assert kinds == [1, 7, STRING, DOUBLE, DOUBLE, DOUBLE, DOUBLE, 0, 0]
    assert len((await rig.ask("get_parameters")).values) == 0


@story(Settable)
async def test_descriptions_tell_bounds_and_choices(rig):
    told = (await rig.ask("describe_parameters", names=["rov.imu.rate_hz", "rov.imu.colour", "nothing"])).descriptors
    assert (told[0].description, told[0].floating_point_range[0].from_value) == ("samples a second (Hz)", 0.1)
    assert told[1].additional_constraints == "one of: red, blue"
    assert told[2].type == 0


@story(Settable)
async def test_values_are_changed_and_told(rig):
    rig.wire.heard["/parameter_events"]("/parameter_events", True)
    wanted = [
        rig.parameter("rov.imu.rate_hz", 2, 50), rig.parameter("rov.imu.colour", 4, "blue"), rig.parameter("rov.imu.beams", 7, [3, 4]),
        rig.parameter("rov.autopilot.depth_p", 3, 0.5), rig.parameter("rov.imu.active", 1, False),
    ]  # fmt: skip
    assert [one.reason for one in (await rig.ask("set_parameters", parameters=wanted)).results] == [""] * 5
    assert (rig.imu["rate_hz"], rig.imu["colour"], rig.imu["beams"]) == (50.0, "blue", [3, 4])
    asked = [(call.service, call.args) for call in rig.world.calls]
    assert ("rov/autopilot/set_gain", {"name": "depth_p", "value": 0.5}) in asked
    assert ("rov/imu/deactivate", {}) in asked
    (event,) = rig.wire.of("/parameter_events")
    assert event.node == "/uwserver"
    assert [value_of(one.value) for one in event.changed_parameters] == [50.0, "blue", [3, 4], 0.5, False]


@story(Settable)
async def test_each_that_cannot_be_changed_says_why(rig):
    wanted = [
        rig.parameter("rov.imu.rate", 3, 1.0), rig.parameter("rov.imu.rate_hz", 4, "fast"), rig.parameter("rov.imu.rate_hz", 3, 33.0),
        rig.parameter("rov.imu.rate_hz", 3, float("nan")), rig.parameter("rov.imu.active", 2, 1), rig.parameter("rov.imu.beams", 2, 1),
        rig.parameter("rov.imu.colour", 4, "green"), rig.parameter("rov.imu.rate_hz", 3, 20.0),
    ]  # fmt: skip
    told = (await rig.ask("set_parameters", parameters=wanted)).results
    words = ['did you mean "rov.imu.rate_hz"', "a number", "does not divide", "finite", "a boolean", "a list", "red"]
    assert [word in one.reason for word, one in zip(words, told[:-1], strict=True)] == [True] * 7
    assert told[-1].successful
    assert rig.imu["rate_hz"] == 20.0
    assert rig.world.stats.details["refused"] == {"parameter": 7}
    unset = rig.types.make("rcl_interfaces/msg/Parameter", name="rov.imu.rate_hz")
    (one,) = (await rig.ask("set_parameters", parameters=[unset])).results
    assert not one.successful


@story(Settable)
async def test_several_of_one_component_are_changed_at_once_or_not_at_all(rig):
    two = [rig.parameter("rov.imu.rate_hz", 3, 25.0), rig.parameter("rov.imu.colour", 4, "blue")]
    assert (await rig.ask("set_parameters_atomically", parameters=two)).result.successful
    assert (rig.imu["rate_hz"], rig.imu["colour"]) == (25.0, "blue")
    bad = [rig.parameter("rov.imu.colour", 4, "red"), rig.parameter("rov.imu.rate_hz", 3, 33.0)]
    assert not (await rig.ask("set_parameters_atomically", parameters=bad)).result.successful
    assert rig.imu["colour"] == "blue"
    mixed = [rig.parameter("rov.imu.colour", 4, "red"), rig.parameter("rov.dvl.rate_hz", 3, 5.0)]
    told = (await rig.ask("set_parameters_atomically", parameters=mixed)).result
    assert (told.successful, "one by one" in told.reason) == (False, True)
    assert rig.imu["colour"] == "blue"


@story(Settable)
async def test_requests_that_are_none_are_answered(rig):
    for short in ("list_parameters", "get_parameters", "set_parameters", "describe_parameters"):
        (answer,) = rig.wire.call(f"/uwserver/{short}", data=b"\0\1\0\0\xff\xff\xff\xff")
        assert answer is not None
    assert len((await rig.ask("get_parameters", names=["x"] * 5000)).values) == 0
    assert rig.world.stats.details["refused"]["message"] == 5


@pytest.mark.parametrize("distro", ["humble", "rolling"])
def test_other_distributions(distro):
    async def told():
        rig = Rig(distro=distro)
        (answer,) = rig.wire.call("/uwserver/list_parameters")
        assert answer.result.names == []
        await rig.node.close()

    asyncio.run(told())


def test_the_name_that_was_meant_is_looked_for_once_a_request(monkeypatch) -> None:
    """Nine hundred names that are nearly right took a third of a second of the loop."""
    looked: list[str] = []
    monkeypatch.setattr(ros_parameters, "did_you_mean", lambda name, _: looked.append(name) or " (did you mean?)")
    told: list[list[str]] = []
    parameters = ros_parameters.Parameters(Conversation(FakeContext(), "peer"), dict)
    parameters.set([(f"rov.imu.ra{k}", 1.0) for k in range(300)], told.append)
    assert looked == ["rov.imu.ra0"]
    assert told[0][:2] == ['no parameter "rov.imu.ra0" (did you mean?)', 'no parameter "rov.imu.ra1"']
    assert len(told[0]) == 300

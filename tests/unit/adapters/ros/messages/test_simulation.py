"""simulation_interfaces on a world of a test: states, steps, and entities that are seen, put elsewhere, spawned and taken away."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest
from ros_rig import ACTUATORS, PORTS
from uwserver_adapters.ros.feed import call
from uwserver_adapters.ros.messages import Catalogue, Facts, Types
from uwserver_adapters.ros.messages.plain import built

from uwserver.adapter import Conversation
from uwserver.ports import Argument, EntityList, Field, Port, Present, Refused, SceneState, Service
from uwserver.testing.fake_context import FakeContext

OK, UNSUPPORTED, NOT_FOUND, WRONG_STATE, FAILED = 1, 0, 2, 3, 4
HALF = math.sqrt(0.5)
SERVICES = (
    Service("world/status", "State.", reads_only=True),
    *(Service(f"world/{name}", "Of time.") for name in ("pause", "resume", "reset", "shutdown")),
    Service("world/remove", "Away.", (Argument("name", "str", "who"),)),
    Service("world/step", "Run.", (Argument("n", "int", "ticks", required=False, default=1),), long_running=True),
    Service(
        "world/spawn", "Add.", (
            Argument("name", "str", "who"), Argument("like", "str", "what", choices=("rov", "crate")),
            Argument("p_NB", "float", "place", "m", shape=(3,)),
            Argument("q_NB", "float", "attitude", shape=(4,), required=False, default=[1.0, 0.0, 0.0, 0.0]),
        ),
    ),
)  # fmt: skip


class World:
    """A vehicle that looks east and a crate, and a client of ROS."""

    def __init__(self, distro="jazzy", truth=True, epoch_ns=0):
        east = (HALF, 0.0, 0.0, HALF)
        entities = EntityList(1, (Present("rov", "rov"),), (Present("crate", "crate"),))
        poses = np.array([(1.0, 2.0, 3.0, *east), (0.0, 0.0, 9.0, 1.0, 0.0, 0.0, 0.0)])
        self.fake = FakeContext(services={service.path: service for service in SERVICES})
        self.fake.scene_state = SceneState(entities, 2_500_000_000, poses, np.zeros(0, np.int8), (0.0, 0.0, 0.0))
        self.fake.ports = {port.path: port for port in (PORTS["rov/truth/velocity"], PORTS["rov/imu"], *ACTUATORS)}
        self.status = {"paused": False, "t_ns": 5}
        self.fake.scripts["world/status"] = lambda _: self.status
        self.types = Types(distro)
        self.catalogue = Catalogue.of(self.types, Facts(epoch_ns=epoch_ns, truth=truth), self.fake)
        self.conversation = Conversation(self.fake, "peer")

    async def ask(self, name, /, **given):
        offer = self.catalogue.offers[f"/uwserver/{name}"]
        told = []
        request = built(self.types, f"{offer.type}_Request", given)
        call(self.conversation, offer, request, lambda response, text: told.append((response, text)))
        for _ in range(20):
            await asyncio.sleep(0)
        ((response, text),) = told
        if hasattr(response, "result"):
            assert text in ("", response.result.error_message)
            assert text or response.result.result in (OK, 101)
        self.types.from_cdr(self.types.cdr(response), f"{offer.type}_Response")
        assert self.conversation.in_flight.count == 0
        return response

    @property
    def asked(self):
        return [(one.service, dict(one.args)) for one in self.fake.calls if one.service != "world/status"]


def story(**settings):
    def decorated(work):
        def test():
            asyncio.run(asyncio.wait_for(work(World(**settings)), 120))

        test.__name__ = work.__name__
        return test

    return decorated


def code(response):
    return response.result.result


@story()
async def test_states_of_the_simulation(world):
    assert (await world.ask("get_simulation_state")).state.state == 1
    assert code(await world.ask("set_simulation_state", state={"state": 1})) == 101  # already
    assert code(await world.ask("set_simulation_state", state={"state": 2})) == OK
    assert world.asked == [("world/pause", {})]
    world.status = {"paused": True, "t_ns": 5}
    assert (await world.ask("get_simulation_state")).state.state == 2
    assert code(await world.ask("set_simulation_state", state={"state": 0})) == OK
    assert world.asked[1:] == [("world/pause", {}), ("world/reset", {})]
    world.status = {"paused": True, "t_ns": 0}
    assert (await world.ask("get_simulation_state")).state.state == 0
    assert code(await world.ask("set_simulation_state", state={"state": 1})) == OK
    assert code(await world.ask("set_simulation_state", state={"state": 3})) == OK
    assert world.asked[3:] == [("world/resume", {}), ("world/shutdown", {})]
    lost = await world.ask("set_simulation_state", state={"state": 7})
    assert (code(lost), "state 7" in lost.result.error_message) == (UNSUPPORTED, True)


@story()
async def test_a_fault_on_the_way_ends_it(world):
    def refuse(_):
        raise Refused("busy", "not now")

    world.fake.scripts["world/pause"] = refuse
    told = await world.ask("set_simulation_state", state={"state": 0})
    assert (code(told), told.result.error_message) == (WRONG_STATE, "not now")
    assert world.asked == [("world/pause", {})]


@story()
async def test_steps_and_resets(world):
    assert code(await world.ask("step_simulation", steps=9)) == OK
    assert code(await world.ask("reset_simulation", scope=255)) == OK
    assert world.asked == [("world/step", {"n": 9}), ("world/reset", {})]
    assert code(await world.ask("reset_simulation", scope=1)) == UNSUPPORTED


@story(epoch_ns=10**9)
async def test_entities_are_seen(world):
    assert (await world.ask("get_entities")).entities == ["crate", "rov"]
    assert code(await world.ask("get_entities", filters={"filter": "r.*"})) == UNSUPPORTED
    info = (await world.ask("get_entity_info", entity="rov")).info
    assert (info.category.category, info.description) == (1, "fake")
    assert (await world.ask("get_entity_info", entity="crate")).info.category.category == 0
    state = (await world.ask("get_entity_state", entity="rov")).state
    p, q = state.pose.position, state.pose.orientation
    assert (p.x, p.y, p.z) == (2.0, 1.0, -3.0)
    assert (q.w, q.z) == pytest.approx((1.0, 0.0))  # it looks along x of map
    assert (state.header.frame_id, state.header.stamp.sec, state.header.stamp.nanosec) == ("map", 3, 500_000_000)
    # The truth sensor of the test tells v = (0, 1, 2) and w = (100, 101, 102) in the axes of the body.
    v, w = state.twist.linear, state.twist.angular
    assert (v.x, v.y, v.z) == pytest.approx((0.0, -1.0, -2.0))
    assert (w.x, w.y, w.z) == pytest.approx((100.0, -101.0, -102.0))
    assert math.isnan(state.acceleration.linear.x)
    both = await world.ask("get_entities_states")
    assert both.entities == ["rov", "crate"]
    assert both.states[1].pose.position.z == -9.0
    assert math.isnan(both.states[1].twist.linear.x)
    for service in ("get_entity_state", "get_entity_info"):
        assert code(await world.ask(service, entity="nobody")) == NOT_FOUND


@story(truth=False)
async def test_ground_truth_is_told_where_it_may_be(world):
    lost = await world.ask("get_entity_state", entity="rov")
    assert (code(lost), "truth = true" in lost.result.error_message) == (UNSUPPORTED, True)
    assert code(await world.ask("get_entities_states")) == UNSUPPORTED
    assert world.fake.scene_requests == 0
    assert 10 not in (await world.ask("get_simulator_features")).features.features
    assert (await world.ask("get_entities")).entities == ["crate", "rov"]


TELEPORT = Port(
    "rov/teleport", "actuator", "teleport", (
        Field("p_NB", "m", "place", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,)), Field("v_NB_B", "m/s", "speed", "B", (3,)),
        Field("w_NB_B", "rad/s", "rate", "B", (3,)),
    ), "Elsewhere.", message="Teleport",
)  # fmt: skip
POSE = {"position": {"x": 2.0, "y": 1.0, "z": -3.0}, "orientation": {"w": 1.0}}


@story()
async def test_an_entity_is_put_elsewhere(world):
    world.fake.ports = {**world.fake.ports, "rov/teleport": TELEPORT}
    state = {"pose": POSE, "twist": {"linear": {"x": 1.0}, "angular": {"z": 0.5}}}
    assert code(await world.ask("set_entity_state", entity="rov", state=state)) == OK
    (command,) = world.fake.commands
    p, q, v, w = command.value
    assert (command.port, p) == ("rov/teleport", (1.0, 2.0, 3.0))
    assert q == pytest.approx((HALF, 0.0, 0.0, HALF))
    assert (v, w) == (pytest.approx((1.0, 0.0, 0.0)), pytest.approx((0.0, 0.0, -0.5)))
    for wrong, expected in (
        ({"entity": "boat"}, NOT_FOUND),
        ({"entity": "rov", "state": {**state, "header": {"frame_id": "rov/odom"}}}, 101),
        ({"entity": "rov", "state": {"pose": {"orientation": {"w": 2.0}}}}, 101),
        ({"entity": "rov", "state": {"pose": {"orientation": {"w": 0.0}}}}, 101),
    ):
        assert code(await world.ask("set_entity_state", **wrong)) == expected
    world.fake.ports = {path: port for path, port in world.fake.ports.items() if port.kind != "teleport"}
    assert code(await world.ask("set_entity_state", entity="rov", state=state)) == UNSUPPORTED
    assert len(world.fake.commands) == 1


@story(distro="rolling")
async def test_of_rolling_a_part_of_the_state_may_be_set(world):
    world.fake.ports = {**world.fake.ports, "rov/teleport": TELEPORT}
    twist = {"twist": {"linear": {"y": 1.0}}}  # which is ahead to port of a vehicle that looks along x
    assert code(await world.ask("set_entity_state", entity="rov", state=twist, set_twist=True)) == OK
    p, q, v, _ = world.fake.commands[0].value
    assert (p, q) == (None, None)
    assert v == pytest.approx((0.0, -1.0, 0.0))
    assert code(await world.ask("set_entity_state", entity="rov", state=twist, set_acceleration=True)) == UNSUPPORTED


def resource(world, uri, text=""):
    given = {"uri": uri, "resource_string": text}
    return {"entity_resource": given} if world.types.distro == "rolling" else given


async def spawned(world):
    names = (await world.ask("get_spawnables")).spawnables
    assert [getattr(one, "entity_resource", one).uri for one in names] == ["rov", "crate"]
    pose = {"pose": POSE}
    told = await world.ask("spawn_entity", name="second", **resource(world, "rov"), initial_pose=pose)
    assert (code(told), told.entity_name) == (OK, "second")
    ((_, args),) = world.asked
    assert (args["name"], args["like"], args["p_NB"]) == ("second", "rov", [1.0, 2.0, 3.0])
    assert args["q_NB"] == pytest.approx([HALF, 0.0, 0.0, HALF])
    again = await world.ask("spawn_entity", name="rov", allow_renaming=True, **resource(world, "crate"))
    assert again.entity_name == "rov_1"
    assert (await world.ask("spawn_entity", allow_renaming=True, **resource(world, "rov"))).entity_name == "rov_1"
    for wrong, expected in (
        ({"name": "rov", **resource(world, "rov")}, 101), (resource(world, "rov"), 102), ({"name": "x", **resource(world, "", "<sdf/>")}, 103),
        ({"name": "x"}, 104), ({"name": "x", **resource(world, "boat")}, 104),
        ({"name": "x", "entity_namespace": "/y", **resource(world, "rov")}, 105),
        ({"name": "x", **resource(world, "rov"), "initial_pose": {"header": {"frame_id": "odom"}}}, 109),
        ({"name": "x", **resource(world, "rov"), "initial_pose": {"pose": {"orientation": {"w": 3.0}}}}, 109),
    ):  # fmt: skip
        assert code(await world.ask("spawn_entity", **wrong)) == expected
    assert len(world.asked) == 3

    def buried(_):
        raise Refused("bad_argument", '"x" would begin inside the seabed', "p_NB")

    world.fake.scripts["world/spawn"] = buried
    told = await world.ask("spawn_entity", name="x", **resource(world, "rov"))
    assert (code(told), "seabed" in told.result.error_message) == (109, True)


test_what_the_scenario_has_is_spawned = story()(spawned)
test_what_the_scenario_has_is_spawned_by_clients_of_rolling = story(distro="rolling")(spawned)


@story()
async def test_an_entity_is_taken_away(world):
    assert code(await world.ask("delete_entity", entity="rov")) == OK
    assert world.asked == [("world/remove", {"name": "rov"})]

    def nobody(_):
        raise Refused("bad_argument", 'no "boat" here', "name")

    world.fake.scripts["world/remove"] = nobody
    assert code(await world.ask("delete_entity", entity="boat")) == NOT_FOUND


@story()
async def test_features_are_what_there_is(world):
    told = (await world.ask("get_simulator_features")).features.features
    assert list(told) == [0, 1, 10, 11, 12, 14, 20, 24, 25, 26, 31, 32, 33]


@story()
async def test_who_asks_for_too_much_waits(world):
    world.conversation.in_flight.limit = 0
    offer, told = world.catalogue.offers["/uwserver/get_entities"], []
    request = world.types.make(f"{offer.type}_Request")
    call(world.conversation, offer, request, lambda *answer: told.append(answer))
    ((response, text),) = told
    assert (response, "wait for some" in text) == (None, True)

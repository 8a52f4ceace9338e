"""What pages may do: with the lease, without it, and those that only watch. All of it is checked by the server."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from uwserver_adapters.web.rights import SERVICES
from web_rig import Stage, ask, call, code_of, play, state_of, world_of
from websockets.exceptions import ConnectionClosed, InvalidStatus

from uwserver.ports import Service
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import SERVICES as WORLD_SERVICES

OF_ROV = ("rov/autopilot/disarm", "rov/autopilot/arm", "rov/thrusters/deactivate", "rov/thrusters/activate")
U = {"port": "rov/thrusters", "value": {"u": [0.5] * 8}}


def with_autopilot() -> FakeContext:
    services = (*WORLD_SERVICES, *(Service(path, "Does it.") for path in OF_ROV))
    return FakeContext(
        scene_state=state_of(), world=world_of("rov"), services={service.path: service for service in services}
    )


def called(context: FakeContext) -> list[str]:
    """What was asked of the world, but for its status."""
    return [held.service for held in context.calls if held.service != "world/status"]


def test_a_page_steers_with_the_lease_alone() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page, stage.page() as other:
            assert code_of(await ask(page, "command", **U)) == "denied"
            assert code_of(await call(page, "rov/autopilot/arm")) == "denied"
            assert code_of(await call(page, "web/lease/take", vehicle="rov")) == ""
            assert code_of(await ask(page, "command", **U)) == ""
            assert code_of(await call(page, "rov/autopilot/arm")) == ""
            assert code_of(await ask(other, "command", **U)) == "denied"
            assert code_of(await call(other, "web/lease/take", vehicle="rov")) == "denied"
            assert code_of(await call(other, "world/pause")) == "", "time is everybody's"
            assert code_of(await call(other, "web/lease/take", vehicle="rov", force=True)) == ""
            assert code_of(await ask(page, "command", **U)) == "denied"

    context = play(scene, with_autopilot())
    assert len(context.commands) == 1


def test_who_loses_the_lease_leaves_its_actuators_neutral() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await call(page, "web/lease/take", vehicle="rov")
            await ask(page, "command", **U)
        for _ in range(3000):
            if "rov/thrusters/activate" in called(stage.context):
                return
            await asyncio.sleep(0.02)
        raise AssertionError("a closed page keeps the thrusters running")

    assert called(play(scene, with_autopilot())) == ["rov/thrusters/deactivate", "rov/thrusters/activate"]


def test_a_lease_given_back_stops_nothing_that_the_page_did_not_command() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await call(page, "web/lease/take", vehicle="rov")
            await call(page, "rov/autopilot/arm")
            assert (await call(page, "web/lease/keep"))["result"]["value"] == ["rov"]
            assert (await call(page, "web/lease/give"))["result"]["value"] == ["rov"]

    assert called(play(scene, with_autopilot())) == ["rov/autopilot/arm"]


def test_all_stop_needs_no_lease() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as pilot, stage.page() as other:
            await call(pilot, "web/lease/take", vehicle="rov")
            assert (await call(other, "web/stop"))["result"]["value"] == ["rov"]
            assert code_of(await ask(pilot, "command", **U)) == "denied"

    context = play(scene, with_autopilot())
    assert called(context) == ["rov/autopilot/disarm", "rov/thrusters/deactivate", "rov/thrusters/activate"]
    assert context.queues.count("1") == 3, "in the queue of the pilot, so that it overtakes what this has asked"


@pytest.mark.parametrize(
    ("active", "asked"), [(True, ["rov/thrusters/deactivate", "rov/thrusters/activate"]), (False, [])]
)
@pytest.mark.parametrize("how", ["all stop", "lost"])
def test_what_somebody_has_deactivated_stays_so(active: bool, asked: list[str], how: str) -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await call(page, "web/lease/take", vehicle="rov")
            await ask(page, "command", **U)
            await call(page, "web/stop" if how == "all stop" else "web/lease/give")
            for _ in range(5):
                await ask(page, "ping")

    context = with_autopilot()
    context.services = {
        **context.services,
        "rov/thrusters/get": Service("rov/thrusters/get", "Properties."),
    }
    context.scripts["rov/thrusters/get"] = lambda args: {"active": active}
    stopped = [service for service in called(play(scene, context)) if not service.startswith("rov/autopilot")]
    assert stopped == ["rov/thrusters/get", *asked]


def test_a_stop_of_one_component_needs_no_lease() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            assert code_of(await call(page, "rov/thrusters/deactivate")) == ""
            assert code_of(await call(page, "rov/thrusters/activate")) == "denied"

    play(scene, with_autopilot())


def test_what_changes_nothing_needs_no_lease() -> None:
    """The page shows how sensors are set before anybody steers, and to who may only watch."""

    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            assert code_of(await call(page, "rov/thrusters/get")) == ""
            assert code_of(await call(page, "rov/autopilot/get_mission")) == ""
            assert code_of(await call(page, "rov/thrusters/set", timeout_s=2.0)) == "denied"

    for options in ({}, {"read_only": True}):
        context = with_autopilot()
        for path in ("rov/thrusters/get", "rov/autopilot/get_mission", "rov/thrusters/set"):
            context.services = {**context.services, path: Service(path, "Properties.")}
            context.scripts[path] = lambda args: {}
        assert called(play(scene, context, **options)) == ["rov/thrusters/get", "rov/autopilot/get_mission"]


async def does_nothing(page: Any) -> None:
    """All that would change anything is refused."""
    assert code_of(await ask(page, "command", **U)) == "denied"
    for service, args in (
        ("world/pause", {}), ("world/step", {"n": 1}), ("rov/autopilot/disarm", {}), ("web/stop", {}),
        ("web/lease/take", {"vehicle": "rov", "force": True}), ("web/lease/give", {}),
    ):  # fmt: skip
        assert code_of(await call(page, service, **args)) == "denied", service
    assert code_of(await ask(page, "step", n=1)) == "denied"
    assert code_of(await call(page, "world/status")) == ""
    assert "result" in await ask(page, "describe", pattern="rov/*")
    assert "result" in await ask(page, "subscribe", pattern="rov/*")
    assert "result" in await ask(page, "view", frames=True)


def test_a_page_that_may_only_watch_changes_nothing() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await does_nothing(page)

    context = play(scene, with_autopilot(), read_only=True)
    assert (context.commands, called(context)) == ([], [])


@pytest.mark.parametrize("token", [None, "sesame"])
def test_a_token_that_only_lets_watch(token: str | None, caplog: pytest.LogCaptureFixture) -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page, stage.page() as pilot:
            assert "result" in await ask(page, "hello", version=1, token="peek")
            await does_nothing(page)
            assert code_of(await call(pilot, "web/lease/take", vehicle="rov")) == "denied", (
                "who shows none may do nothing"
            )
            assert code_of(await ask(pilot, "hello", version=1)) == "denied"
        assert (stage.adapter.token in caplog.text) == (token is None), "one that was made is told"
        async with stage.page() as pilot:
            assert "result" in await ask(pilot, "hello", version=1, token=stage.adapter.token)
            assert code_of(await call(pilot, "web/lease/take", vehicle="rov")) == ""

    context = play(scene, with_autopilot(), token=token, view_token="peek")
    assert context.commands == []


def test_without_the_token_nothing_is_told() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            for method in ("view", "seen", "describe"):
                reply = await ask(page, method, **({"frames": True} if method == "view" else {}))
                assert code_of(reply) == "denied"
                if method == "seen":
                    break
        async with stage.page() as page:
            assert code_of(await ask(page, "hello", version=1, token="wrong")) == "denied"
            with pytest.raises(ConnectionClosed):
                await page.recv()
        assert stage.context.scene_requests == 0

    play(scene, token="sesame")


@pytest.mark.parametrize("origin", ["http://evil.example", "https://127.0.0.1:1", "null", "http://localhost:7680"])
def test_pages_of_other_origins_get_no_live_data(origin: Any) -> None:
    async def scene(stage: Stage) -> None:
        with pytest.raises(InvalidStatus) as refused:
            await stage.page(origin=origin)
        assert refused.value.response.status_code == 403
        async with stage.page(origin=f"http://{stage.host}:{stage.port}") as page:
            assert "result" in await ask(page, "ping")
        async with stage.page(origin="https://ours.example") as page:
            assert "result" in await ask(page, "ping")

    assert play(scene, allowed_origins=("https://ours.example",)).stats.details["refused"] == {"origin": 1}


def test_a_name_that_was_made_to_point_here_gets_no_live_data() -> None:
    async def scene(stage: Stage) -> None:
        host = f"evil.example:{stage.port}"
        with pytest.raises(InvalidStatus) as refused:
            await stage.page(origin=f"http://{host}", additional_headers={"Host": host})
        assert refused.value.response.status_code == 421

    play(scene)


@pytest.mark.parametrize(
    ("service", "args", "code"),
    [("web/lease/take", {}, "bad_argument"), ("web/lease/take", {"vehicle": "rv"}, "bad_argument"),
     ("web/lease/take", {"vehicle": 7}, "bad_argument"),
     ("web/lease/take", {"vehicle": "rov", "force": "yes"}, "bad_argument"), ("web/lease/give", {"vehicel": "rov"}, "bad_argument"),
     ("web/lease/tak", {}, "unknown_service"), ("web/stop", {"vehicle": []}, "bad_argument")],
)  # fmt: skip
def test_what_the_services_do_not_take_is_refused(service: str, args: dict[str, Any], code: str) -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            assert code_of(await ask(page, "call", service=service, args=args)) == code

    play(scene, with_autopilot())


def test_the_services_of_pages_are_described() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            described = (await ask(page, "describe", pattern="web/**"))["result"]["services"]
            assert {service["path"] for service in described} == set(SERVICES)

    play(scene)


def test_pages_hold_up_no_lockstep_barrier() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            assert "result" in await ask(page, "hello", version=1, name="autopilot")
            assert stage.context.joined == []

    play(scene)

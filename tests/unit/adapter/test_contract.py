"""How adapters are found, and what a broken one says and spoils."""

from __future__ import annotations

import logging
import sys
import types
from importlib.metadata import EntryPoint

import pytest

from uwserver.adapter import (
    AdapterNotFound,
    AdapterTable,
    VehicleFacts,
    WorldFacts,
    adapter_entries,
    installed_adapters,
    load_adapter,
)
from uwserver.adapter import contract as adapter


class GoodTable(AdapterTable, tag="good", kw_only=True, frozen=True):
    port: int = 1


class Good:
    Config = GoodTable

    def __init__(self, config, context):
        pass

    async def run(self, ready):
        ready.set()


class WithoutRun:
    Config = GoodTable


class RunIsNoFunction(Good):
    run = "soon"


class WithoutConfig:
    run = Good.run


class ConfigOfSomethingElse(Good):
    Config = dict


class ConfigIsNoType(Good):
    Config = GoodTable()


class Distribution:
    name = "ocean-tools"


@pytest.fixture
def install(monkeypatch):
    """`install(kind="module:attribute")` pretends that a distribution offers these and no other adapters."""
    module = types.ModuleType("third_party")
    for thing in (Good, WithoutRun, RunIsNoFunction, WithoutConfig, ConfigOfSomethingElse, ConfigIsNoType):
        setattr(module, thing.__name__, thing)
    module.function = lambda: Good
    module.instance = Good(None, None)
    monkeypatch.setitem(sys.modules, "third_party", module)

    def pretend(**values):
        found = [
            EntryPoint(kind, value, adapter.ENTRY_POINT_GROUP)._for(Distribution()) for kind, value in values.items()
        ]
        monkeypatch.setattr(adapter, "entry_points", lambda group: found if group == "uwserver.adapters" else [])

    return pretend


BROKEN = {
    "no_module": ("missing_module:Thing", "cannot be imported: No module named 'missing_module'"),
    "no_name": ("third_party:Nothing", "cannot be imported: .*has no attribute 'Nothing'"),
    "no_run": ("third_party:WithoutRun", r"needs run\(\) and a Config derived from uwserver.adapter.AdapterTable"),
    "odd_run": ("third_party:RunIsNoFunction", r"needs run\(\)"),
    "no_config": ("third_party:WithoutConfig", r"needs run\(\)"),
    "odd_config": ("third_party:ConfigOfSomethingElse", r"needs run\(\)"),
    "no_type": ("third_party:ConfigIsNoType", r"needs run\(\)"),
    "function": ("third_party:function", r"needs run\(\)"),
    "instance": ("third_party:instance", r"needs run\(\)"),
}


def test_a_good_one(install):
    install(good="third_party:Good")
    assert load_adapter("good") is Good
    assert installed_adapters() == {"good": GoodTable}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_one_says_whose_it_is_and_why(install, kind):
    value, reason = BROKEN[kind]
    install(**{kind: value})
    with pytest.raises(AdapterNotFound, match=f'adapter "{kind}" of ocean-tools {reason}'):
        load_adapter(kind)


def test_broken_ones_do_not_keep_others_from_loading(install, caplog):
    install(good="third_party:Good", **{kind: value for kind, (value, _) in BROKEN.items()})
    with caplog.at_level(logging.WARNING, logger="uwserver.adapter"):
        assert installed_adapters() == {"good": GoodTable}
    assert len(caplog.messages) == len(BROKEN)
    for kind in BROKEN:
        assert sum(f'"{kind}" of ocean-tools' in message for message in caplog.messages) == 1


@pytest.mark.parametrize(
    "error", [ImportError("needs libfoo: install it"), SyntaxError("bad"), RuntimeError(), KeyError("x")]
)
def test_whatever_its_import_raises_is_told(install, monkeypatch, error):
    class Failing:
        def find_spec(self, name, path=None, target=None):
            if name == "failing_module":
                raise error

    monkeypatch.setattr(sys, "meta_path", [Failing(), *sys.meta_path])
    install(bad="failing_module:Thing")
    with pytest.raises(AdapterNotFound) as caught:
        load_adapter("bad")
    assert str(caught.value) == f'adapter "bad" of ocean-tools cannot be imported: {str(error) or "RuntimeError"}'
    assert caught.value.__cause__ is error


def test_an_unknown_kind_is_told_what_there_is(install):
    install(good="third_party:Good", other="third_party:Good")
    with pytest.raises(AdapterNotFound, match=r'no adapter "mavlnk" is installed, there are: good, other$'):
        load_adapter("mavlnk")
    install()
    with pytest.raises(AdapterNotFound, match="there are: none"):
        load_adapter("good")
    assert installed_adapters() == {}


def test_packages_are_looked_through_once_for_all(install, monkeypatch):
    """Where hundreds are installed that takes longer than all else that a world is loaded from; to read whose an adapter is, as long again."""
    install(a="third_party:Good", b="third_party:Good", c="third_party:Good")
    looked, real = [], adapter.entry_points
    monkeypatch.setattr(adapter, "entry_points", lambda group: (looked.append(group), real(group))[1])
    monkeypatch.setattr(Distribution, "name", property(lambda _: looked.append("name")), raising=False)
    assert installed_adapters() == dict.fromkeys("abc", GoodTable)
    assert looked == ["uwserver.adapters"]


def test_listing_does_not_import(install):
    install(zeta="missing_module:A", alpha="missing_module:B")
    assert list(adapter_entries()) == ["alpha", "zeta"]


def test_an_entry_point_without_distribution(monkeypatch):
    entry = EntryPoint("x", "missing_module:A", adapter.ENTRY_POINT_GROUP)
    monkeypatch.setattr(adapter, "entry_points", lambda group: [entry])
    with pytest.raises(AdapterNotFound, match='adapter "x" of unknown distribution'):
        load_adapter("x")


def facts(epoch_utc: str) -> WorldFacts:
    return WorldFacts(
        server="s", scenario="pool", rate_hz=250.0, epoch_utc=epoch_utc, mode="realtime", speed=1.0,
        vehicles=(VehicleFacts("rov", "BlueROV2 Heavy"),),
    )  # fmt: skip


@pytest.mark.parametrize(
    "text", ["2024-01-01T00:00:00Z", "2024-01-01T00:00:00", "2024-01-01T00:00:00+00:00", "2024-01-01T02:00:00+02:00"]
)
def test_the_epoch_is_utc_whatever_the_zone_of_this_machine(text: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TZ", "America/St_Johns")
    assert facts(text).epoch_ns == 1_704_067_200_000_000_000


def test_facts_do_not_change():
    with pytest.raises(AttributeError):
        facts("2024-01-01T00:00:00Z").speed = 2.0  # type: ignore[misc]

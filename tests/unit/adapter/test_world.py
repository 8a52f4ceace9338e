"""Facts of the world that adapters get typed: the epoch as a number, whatever way the scenario wrote it."""

from __future__ import annotations

import pytest

from uwserver.adapter import VehicleFacts, WorldFacts


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

"""Copies are what is tried here, not how their scenarios are read: each is read once."""

import pytest
from scenario_rig import adapters_here, read_once


@pytest.fixture(autouse=True)
def scenarios_read_once(monkeypatch):
    monkeypatch.setattr("uwserver.scenario.load.scenario.load", read_once)
    monkeypatch.setattr("uwserver.adapter.installed_adapters", adapters_here)

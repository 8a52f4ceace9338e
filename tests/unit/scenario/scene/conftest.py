"""A vehicle's file."""

import pytest

from uwserver.adapter import installed_adapters
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.tables import VehicleFile


@pytest.fixture(scope="session")
def tiny_file() -> VehicleFile:
    return load("bluerov2_pool", adapters=installed_adapters()).vehicles["bluerov2"].vehicle

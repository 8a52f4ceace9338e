"""The page about looking at a log: the dive that ships shows what it says, and its table reads a telemetry log."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest
from reader import Reader, blocks
from readers_files import write_tlog

import uwserver
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load

PAGE = "docs/how-to/review.md"


def test_the_page_s_table_reads_a_telemetry_log(tmp_path):
    (listing,) = [block.text for block in blocks(PAGE, "toml") if "dive.tlog" in block.text]
    (tmp_path / "dive.toml").write_text(listing)
    write_tlog(tmp_path / "dive.tlog")
    world = build(load(tmp_path / "dive.toml", adapters=uwserver_adapters()))
    world.step(1200)
    north, _, down = world.read("filter/state").p_NB
    assert north == pytest.approx(5.0, abs=0.3)
    assert down == pytest.approx(5.0, abs=1e-3)
    # Its first pose is the origin of what has latitudes alone, so the metre that it lags is not seen, and their ways are alike.
    assert world.read("gps/difference").distance < 0.3


def test_a_mapping_of_the_log_is_printed_and_read(tmp_path):
    write_tlog(tmp_path / "dive.tlog")
    (listing,) = [block.text for block in blocks(PAGE, "toml") if "dive.tlog" in block.text]
    from uwserver.logfiles import open_log
    from uwserver.logfiles.mapping import mapping_text
    from uwserver.logfiles.rules import mapping_of

    log = open_log(tmp_path / "dive.tlog")
    (tmp_path / "dive.mapping.toml").write_text(mapping_text(mapping_of(log)))
    log.close()
    mapped = listing.replace('log = "dive.tlog"', 'log = "dive.tlog"\nmapping = "dive.mapping.toml"')
    (tmp_path / "dive.toml").write_text(mapped)
    assert set(load(tmp_path / "dive.toml", adapters=uwserver_adapters()).tracks) == {"filter", "gps"}


def test_the_dive_that_ships_shows_what_the_page_says(tmp_path):
    log = Path(str(resources.files("uwserver_scenarios"))) / "assets" / "filter_review.mcap"
    assert log.stat().st_size < 2_000_000
    world = uwserver.load("filter_review")
    world.step(120 * 200)
    sensors, filtered = world.read("sensors/difference").distance, world.read("filter/difference").distance
    assert round(sensors) == 7
    assert round(filtered) == 2
    text = Path(__file__).parents[2].joinpath(PAGE).read_text()
    assert "dead reckoning is 7 m off after 200 s, the filter 2 m" in text


def test_a_boat_is_led_as_the_page_says(tmp_path):
    (command,) = [line for block in blocks(PAGE, "sh") for line in block.text.splitlines() if "boat/pose" in line]
    (tmp_path / "boat.toml").write_text(
        'schema = 1\n[adapters.tcp]\nkind = "sockets"\nport = 7600\n[vehicles.boat]\nkind = "external"\nmodel = "bluerov2"\n'
    )
    with Reader(tmp_path) as reader:
        reader.type("uwserver run boat.toml")
        reader.type(command)
        reader.type("uwclient echo boat/state -n 1")
        assert "count=1" in reader.said["uwclient echo boat/state -n 1"]


def uwserver_adapters():
    from uwserver.adapter import installed_adapters

    return installed_adapters()

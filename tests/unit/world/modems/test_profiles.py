"""Modems as they are sold: JANUS packets, and the speeds that each make bears and tells."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest
from modem_rig import Heard, counts, listen

from uwserver.scenario.build.world import build
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.devices import check_profile
from uwserver.sensors import AcousticModemConfig, Pose
from uwserver.world import World

TRIO = {"a": (0.0, 0.0), "b": (1200.0, 0.0), "c": (0.0, 900.0)}


def device(profile: str):
    keys = check_profile(read(shipped("devices")[profile]).raw, lambda *problem: pytest.fail(str(problem)))
    assert keys.pop("kind") == "acoustic_modem"
    return msgspec.convert({**keys, "rate_hz": 1.0}, AcousticModemConfig).build(Pose())


def world_of(tmp_path: Path, profile: str) -> World:
    text = "schema = 1\n[environment]\n"
    for k, (name, (x, y)) in enumerate(TRIO.items(), 1):
        text += f"""
[vehicles.{name}]
model = "lauv"
position_ned_m = [{x}, {y}, 25.0]
[vehicles.{name}.sensors.modem]
kind = "acoustic_modem"
profile = "{profile}"
rate_hz = 1
address = {k}
"""
    (tmp_path / "modems.toml").write_text(text.replace("[environment]\n", ""))
    return build(load(tmp_path / "modems.toml", adapters={}))


def test_a_janus_packet_is_as_long_as_its_chips():
    """32 chips of preamble and twice 72 bits, of 6.25 ms; cargo of 80 bit/s after it."""
    janus = device("janus")
    assert janus.duration(b"beep") == pytest.approx((32 + 2 * (64 + 8)) * 6.25e-3)
    assert janus.duration(b"") == janus.duration(b"beep")
    assert janus.duration(bytes(14)) - janus.duration(bytes(4)) == pytest.approx(10 * 8 / 80)


def test_its_tones_fill_its_band():
    table = device("janus").table
    assert table.frequency_hz - 0.5 * table.bandwidth_hz == 9440.0
    assert table.frequency_hz + 0.5 * table.bandwidth_hz == 13_600.0
    assert table.bandwidth_hz == 13 * 2 * 160.0


def test_everybody_hears_janus_and_nobody_is_named(tmp_path):
    world = world_of(tmp_path, "janus")
    world.command("a/modem/send", data=b"here")
    told: list[Heard] = listen(world, 3.0)
    assert [(m.by, m.source, m.destination, m.data) for m in told] == [
        ("c", 255, 255, b"here"),
        ("b", 255, 255, b"here"),
    ]
    away = math.dist((0.0, 0.0), TRIO["b"])
    assert told[1].t == pytest.approx(away / world.water.sound_speed(25.0), rel=5e-3)
    assert told[1].told == pytest.approx(told[1].t + 1.1, abs=0.01)
    assert abs(told[1].speed) < 2.0
    assert "a/modem/range" not in world.services


def test_janus_and_another_make_do_not_understand_each_other(tmp_path):
    world = world_of(tmp_path, "janus")
    other = world_of(tmp_path, "micromodem")
    janus, whoi = (w.sensors["a/modem/received"].sensor for w in (world, other))
    assert janus.overlap(whoi.signal((1.0, 0.0, 0.0, 0.0))) == 0.0


@pytest.mark.parametrize(("profile", "limit"), [("janus", 5.0), ("micromodem", 4.8)])
def test_faster_than_its_receiver_looks_for_it_hears_nothing(tmp_path, profile, limit):
    for speed, heard in ((limit - 0.5, True), (limit + 0.5, False)):
        world = world_of(tmp_path, profile)
        fast = world.vehicles["b"]
        world.command("a/modem/send", data=b"x")
        told = []
        for _ in range(330):
            fast.hydro.state[fast.row, 3:13] = (1.0, 0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0, 0.0)
            told += [m for m in listen(world, 1.0 / 60) if m.by == "b"]
        assert bool(told) == heard
        assert counts(world, "b") == ({"heard": 1} if heard else {"doppler": 1})


def test_who_tells_a_speed():
    found = {
        name: device(name).speed_sigma for name in ("m64", "s2cr_18_34", "seatrac_x150_modem", "micromodem", "janus")
    }
    assert found == {"m64": None, "s2cr_18_34": 0.1, "seatrac_x150_modem": None, "micromodem": None, "janus": 0.5}

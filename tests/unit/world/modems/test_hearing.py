"""What a modem makes of packets that are hopelessly weak, absurdly made, or too many at once."""

from __future__ import annotations

import msgspec
import pytest
from modem_rig import counts, listen, modem, world_of, world_with

from uwserver.sensors import AcousticModemConfig, OpticalModemConfig
from uwserver.sensors.acoustic.acoustic_modem import AcousticModem
from uwserver.sensors.modem import Signal
from uwserver.world.modems import medium


def test_a_packet_of_which_nothing_is_left_is_not_heard_and_the_world_goes_on():
    """The logarithm of nothing ended the server."""
    world = world_of({"a": (0.0, 0.0, 20.0), "b": (12_000.0, 0.0, 20.0)}, frequency_hz=1e6, bandwidth_hz=1e4)
    world.command("a/modem/send", destination=2, acknowledge=1)
    assert [(m.by, m.event) for m in listen(world, 20.0)] == [("a", "failed")]
    assert counts(world, "b") == {}


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        (AcousticModemConfig, {"bits_per_s": 1e-300}),
        (AcousticModemConfig, {"overhead_s": 1e300}),
        (AcousticModemConfig, {"turn_around_s": 1e305}),
        (AcousticModemConfig, {"processing_s": 1e300}),
        (AcousticModemConfig, {"max_range_m": 1e308}),
        (AcousticModemConfig, {"frequency_hz": 1e308}),
        (AcousticModemConfig, {"bandwidth_hz": 1e-300}),
        (AcousticModemConfig, {"source_level_db": 1e6}),
        (AcousticModemConfig, {"source_level_db": -1e6}),
        (AcousticModemConfig, {"noise_level_db": -1e5}),
        (OpticalModemConfig, {"power_w": 1e300}),
        (OpticalModemConfig, {"sensitivity_w": 1e-300}),
    ],
)
def test_numbers_that_would_end_a_run_later_are_refused_at_load(kind, keys):
    with pytest.raises(msgspec.ValidationError, match=next(iter(keys))):
        msgspec.convert({"kind": kind.__struct_config__.tag, "rate_hz": 1.0} | keys, kind)
    with pytest.raises(msgspec.ValidationError, match="bandwidth"):
        msgspec.convert({"protocol": "x", "frequency": 1.0, "bandwidth": 0.0, "level": 1.0}, Signal)


def test_many_packets_at_once_are_met_in_several_ticks_with_the_same_outcome(monkeypatch):
    """Each takes a fifth of a millisecond: thirty that came at once were a late tick."""
    places = {f"v{k:02}": (30.0 * k, 40.0 * (k % 3), 20.0) for k in range(7)}
    traced: list[int] = []
    real = AcousticModem.crossing

    def noted(*args):
        traced.append(1)
        return real(*args)

    monkeypatch.setattr(AcousticModem, "crossing", noted)

    def told(most: int) -> tuple[list[tuple[str, float, object, bytes]], int]:
        monkeypatch.setattr(medium, "_MOST_MET", most)
        modems = {name: modem(k, bits_per_s=1e6, queue=64, max_range_m=500.0) for k, name in enumerate(places, 1)}
        world, found, worst = world_with(places, modems), [], 0
        for name in places:
            for n in range(8):
                world.command(f"{name}/modem/send", destination=255, data=bytes([n]))
        for _ in range(240):
            before = len(traced)
            found += listen(world, 1.0 / 240.0)
            worst = max(worst, len(traced) - before)
        return sorted((m.by, round(m.t, 6), m.source, m.data) for m in found), worst

    shipped = medium._MOST_MET
    (freely, many), (bounded, few) = told(10_000), told(shipped)
    assert many > 20
    assert few <= shipped <= 8
    assert len(bounded) > 40
    assert bounded == freely

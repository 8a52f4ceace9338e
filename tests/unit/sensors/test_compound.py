"""Several sensors in one message. Also of uwserver.sensors.base."""

from __future__ import annotations

from sensor_rig import (
    world_with,
)

from uwserver.sensors import (
    CompoundConfig,
    LeakConfig,
)


def test_a_compound_holds_what_its_members_have_just_read():
    world = world_with(
        auto=CompoundConfig(rate_hz=120, members=("imu", "pressure")),
        slow=CompoundConfig(rate_hz=60, members=("pressure", "leak")),
        leak=LeakConfig(rate_hz=2),
    )
    names = [field.name for field in world.ports["rov/auto"].fields]
    assert names[:5] == ["age", "imu_valid", "imu_f_S", "imu_w_S", "imu_temperature"]
    by_port: dict[str, list] = {}
    for sample in world.step(240):
        by_port.setdefault(sample.port, []).append(sample)
    imu = {s.t_ns: s.value for s in by_port["rov/imu"]}  # delivered later too, so the last one is still under way
    pressure = {s.t_ns: s.value for s in by_port["rov/pressure"]}  # delivered later, measured then
    for sample in by_port["rov/auto"][:-1]:
        assert sample.value[2:5] == imu[sample.t_ns]
        newest = max(t for t in pressure if t <= sample.t_ns) if min(pressure) <= sample.t_ns else None
        if newest is not None and newest == sample.t_ns:
            assert sample.value[6:8] == pressure[newest]
            assert sample.value[0] == 0.0
    assert by_port["rov/slow"][0].t_ns == 500_000_000  # the first reading of the leak probe

"""Registers, asynchronous messages and binary outputs of the device; a driver of users over a pseudo-terminal."""

from __future__ import annotations

import asyncio
import math
import os
import pty
import sys
import tty
from typing import Any

import pytest
from adapter_rig import serving
from devices_rig import ATTITUDE, COMPASS, GPS, IMU, ask, make_context, sample
from uwserver_adapters.devices import DevicesAdapter
from uwserver_adapters.devices.vectornav import VectorNav, VectorNavTable
from uwserver_adapters.devices.vectornav_messages import line

HALF = math.radians(15.0)
NORTH_EAST = (math.cos(HALF), 0.0, 0.0, math.sin(HALF))  # a heading of 30 degrees
VN_100 = VectorNavTable(imu="rov/imu", attitude="rov/attitude", magnetometer="rov/compass", tcp_port=0)
VN_200 = VectorNavTable(imu="rov/imu", attitude="rov/attitude", gps="rov/gps", model="VN-200", tcp_port=0)


def said(device: VectorNav, t_s: float) -> list[bytes]:
    """What it says of itself at a reading of the IMU."""
    device.see(sample(ATTITUDE, (NORTH_EAST, HALF), t_s))
    device.see(sample(GPS, (1.0, 0.2, 3.0, (1.0, 2.0, 3.0), 9, 3), t_s))
    device.see(sample(COMPASS, ((2e-5, 0.0, 4e-5),), t_s))
    return device.see(sample(IMU, ((0.0, 0.0, -9.8), (0.1, 0.2, 0.3), 12.5), t_s))


def make(table: VectorNavTable = VN_100) -> VectorNav:
    device = table.build(make_context())
    said(device, 0.0)
    return device


def answer(device: VectorNav, *parts: str) -> bytes:
    (reply,), _ = ask(device, line(*parts))
    return reply


def test_registers_tell_what_the_sensors_measure():
    device = make()
    assert answer(device, "VNRRG", "1") == line("VNRRG", "01", "VN-100")
    assert answer(device, "VNRRG", "8") == line("VNRRG", "08", "+030.000,+000.000,+000.000")
    assert answer(device, "VNRRG", "17") == line("VNRRG", "17", "+00.2000,+00.0000,+00.4000")
    assert answer(device, "VNRRG", "54").endswith(b",+12.5,+000.000*" + answer(device, "VNRRG", "54")[-4:])
    assert answer(make(VN_200), "VNRRG", "58").split(b",")[4:6] == [b"3", b"09"]


def test_asynchronous_messages_come_at_their_rate_whatever_that_of_the_imu():
    device = make()
    answer(device, "VNWRG", "07", "10")
    assert answer(device, "VNWRG", "06", "1") == line("VNWRG", "06", "1")
    messages = [message for k in range(201) for message in said(device, 1.0 + k / 200)]
    assert len(messages) == 11
    assert set(messages) == {line("VNYPR", "+030.000,+000.000,+000.000")}
    answer(device, "VNWRG", "06", "0")
    assert said(device, 3.0) == []


def test_a_pause_ends_and_settings_outlive_it():
    device = make()
    assert answer(device, "VNASY", "0") == line("VNASY", "0")
    assert said(device, 1.0) == []
    answer(device, "VNASY", "1")
    assert said(device, 2.0)[0].startswith(b"$VNYMR,")


def test_binary_outputs_are_written_polled_and_sent():
    device = make()
    answer(device, "VNWRG", "06", "0")
    assert answer(device, "VNWRG", "75", "2", "80", "01", "0108") == line("VNWRG", "75", "2", "80", "01", "0108")
    assert answer(device, "VNRRG", "75") == line("VNRRG", "75", "2", "80", "01", "0108")
    sent = [message for k in range(200) for message in said(device, 1.0 + k / 200)]
    assert len(sent) == 10
    assert {message[:4] for message in sent} == {b"\xfa\x01\x08\x01"}
    assert answer(device, "VNBOM", "1") == sent[-1]


def test_settings_are_saved_and_those_of_the_factory_come_back():
    device = make()
    answer(device, "VNWRG", "07", "100")
    answer(device, "VNRST")
    assert answer(device, "VNRRG", "7") == line("VNRRG", "07", "40")
    answer(device, "VNWRG", "07", "100")
    answer(device, "VNWNV")
    answer(device, "VNRST")
    assert answer(device, "VNRRG", "7") == line("VNRRG", "07", "100")
    answer(device, "VNRFS")
    assert answer(device, "VNRRG", "7") == line("VNRRG", "07", "40")


@pytest.mark.parametrize(
    ("data", "number"),
    [
        (b"$VNRRG,8*00\r\n", 3), (line("VNXYZ"), 4), (line("VNRRG"), 5), (line("VNRRG", "8", "9"), 6), (line("VNRRG", "x"), 7),
        (line("VNRRG", "200"), 8), (line("VNRRG", "58"), 8), (line("VNWRG", "8", "1"), 9), (line("VNWRG", "26", "1"), 9),
        (line("VNWRG", "7", "33"), 7), (line("VNWRG", "7", "0"), 7), (line("VNWRG", "6", "99"), 7), (line("VNWRG", "6", "22"), 7),
        (line("VNWRG", "75", "1", "0", "01", "0001"), 7), (line("VNWRG", "75", "1", "4", "01", "0800"), 7),
        (line("VNWRG", "75", "9", "4", "01", "0001"), 7), (line("VNWRG", "75", "1"), 5), (line("VNBOM", "1"), 7), (line("VNTAR"), 4),
        (line("VNASY", "7"), 7), (line("VNWRG", "30", "1", "2", "3", "4", "5", "6", "7", "8"), 6),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_by_the_makers_number_and_changes_nothing(data: bytes, number: int):
    device = make()
    before = device.settings
    replies, bad = ask(device, data)
    assert replies == [line("VNERR", f"{number:02d}")]
    assert len(bad) == 1
    assert device.settings == before


def test_before_the_first_measurement_nothing_is_told():
    device = VN_100.build(make_context())
    assert answer(device, "VNRRG", "8") == line("VNERR", "07")
    assert device.see(sample(IMU, ((0.0, 0.0, -9.8), (0.1, 0.2, 0.3), 12.5))) == []


def test_after_a_reset_time_begins_again():
    device = make()
    said(device, 100.0)
    device.reset()
    assert len(said(device, 0.0)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_driver_of_users_reads_the_device_over_a_serial_line():
    driver: Any = pytest.importorskip("vectornav", reason="vectornav-vn200 is not installed")
    ours, theirs = pty.openpty()
    second, second_theirs = pty.openpty()
    for end in (ours, theirs, second, second_theirs):
        tty.setraw(end)
        os.set_blocking(end, False)

    async def scene() -> dict[str, float]:
        loop = asyncio.get_running_loop()

        def joined(a: int, b: int) -> None:
            # Two pseudo-terminals back to back stand for the cable: the adapter opens one, the driver the other.
            os.write(b, os.read(a, 4096))

        loop.add_reader(ours, joined, ours, second)
        loop.add_reader(second, joined, second, ours)
        table = VectorNavTable(
            imu="rov/imu", attitude="rov/attitude", gps="rov/gps", model="VN-200", serial=os.ttyname(theirs)
        )
        async with serving(DevicesAdapter(DevicesAdapter.Config(device={"ins": table}), make_context())) as context:

            def client() -> dict[str, float]:
                with driver.VN200(os.ttyname(second_theirs)) as vn:
                    return {
                        "model": vn.read_model_number(),
                        **vn.read_yaw_pitch_roll(),
                        **vn.read_accel(),
                        **vn.read_gps(),
                        **vn.read_ins(),
                    }

            done = loop.run_in_executor(None, client)
            for k in range(2000):
                t_s = k / 200
                context.put([
                    sample(ATTITUDE, (NORTH_EAST, HALF), t_s),
                    sample(GPS, (1.0, 0.2, 3.0, (1.0, 2.0, 3.0), 9, 3), t_s),
                    sample(IMU, ((0.0, 0.0, -9.8), (0.1, 0.2, 0.3), 12.5), t_s),
                ])  # fmt: skip
                await asyncio.wait([done], timeout=0.005)
                if done.done():
                    break
            loop.remove_reader(ours)
            loop.remove_reader(second)
            return done.result()

    try:
        told = asyncio.run(asyncio.wait_for(scene(), 120))
    finally:
        for end in (ours, theirs, second, second_theirs):
            os.close(end)
    assert told["model"] == "VN-200"
    assert (told["yaw"], told["accel_z"], told["gps_fix"], told["ned_vel_z"]) == (30.0, -9.8, 3, 3.0)
    assert told["latitude"] == pytest.approx(math.degrees(1.0), abs=1e-8)
    assert (told["gps_week"], told["ins_week"]) == (2295, 2295)

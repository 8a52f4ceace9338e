"""The lock-step, frame by frame: the driver called by hand on real loopback sockets, with a clock of the test's own."""

from __future__ import annotations

import contextlib
import gzip
import json
import math
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from uwserver_adapters.ardupilot.driver import COUNTS, NO_ECHO_M, RATE_FRAMES, ArduPilotDriver, State
from uwserver_adapters.sil.in_the_loop import Outputs, OutputTable, Scale
from uwserver_bench.autopilots.ardupilot_peer import ArduPilotPeer, read, servo_packet

from uwserver.adapter import AdapterStats, CannotServe, Order, Readings
from uwserver.frames import conjugate, rotate
from uwserver.ports import Fault, Field, Port, Sample

POSE = Port(
    "rov/truth/pose",
    "sensor",
    "truth_pose",
    (Field("p_NB", "m", "p", "N", (3,)), Field("q_NB", "1", "q", "NB", (4,))),
    "Pose.",
    1200.0,
)
VELOCITY = Port(
    "rov/truth/velocity",
    "sensor",
    "truth_velocity",
    (Field("v_NB_B", "m/s", "v", "B", (3,)), Field("w_NB_B", "rad/s", "w", "B", (3,))),
    "Velocity.",
    1200.0,
)
IMU = Port(
    "rov/imu",
    "sensor",
    "imu",
    (Field("f_S", "m/s^2", "f", "S", (3,)), Field("w_S", "rad/s", "w", "S", (3,)), Field("temperature", "degC", "t")),
    "IMU.",
    1200.0,
)
ALTIMETER = Port(
    "rov/altimeter",
    "sensor",
    "altimeter",
    (Field("range", "m", "range"), Field("confidence", "1", "c")),
    "Altimeter.",
    10.0,
)
BATTERY = Port(
    "rov/battery", "sensor", "battery", (Field("voltage", "V", "v"), Field("current", "A", "c")), "Battery.", 10.0
)
THRUSTERS = Port(
    "rov/thrusters",
    "actuator",
    "thrusters",
    (Field("u", "1", "u", shape=(8,), minimum=-1.0, maximum=1.0),),
    "Thrusters.",
)
RUDDER = Port(
    "rov/rudder", "actuator", "fin", (Field("angle_rad", "rad", "angle", minimum=-0.3, maximum=0.3),), "Rudder."
)
PORTS = {port.path: port for port in (POSE, VELOCITY, IMU, ALTIMETER, BATTERY, THRUSTERS, RUDDER)}

HALF = math.sqrt(0.5)
EAST = (HALF, 0.0, 0.0, HALF)
"""Attitude of a vehicle that looks east."""


class Rig:
    """A driver, its autopilot, and the world between them."""

    def __init__(self, endpoint: socket.socket, peer: ArduPilotPeer, rangefinders: tuple[str, ...] = ()) -> None:
        self.endpoint = endpoint
        self.peer = peer
        self.now = 100.0
        self.t_ns = 0
        self.conflicts: list[str] = []
        self.stats = AdapterStats()
        self.stats.details.update(dict.fromkeys((*COUNTS, "frame_rate_hz"), 0))
        readings = Readings(PORTS, "rov")
        state = State(
            readings.subscribe("pose", "truth/pose", [("p_NB", "q_NB")]),
            readings.subscribe("velocity", "truth/velocity", [("v_NB_B", "w_NB_B")]),
            readings.subscribe("imu", "imu", [("w_S", "f_S")]),
            [readings.subscribe("rangefinders", name, [("range",)], keeps=False) for name in rangefinders],
            readings.subscribe("battery", "battery", [("voltage", "current")]) if rangefinders else None,
            bool(rangefinders),
        )
        outputs = Outputs({}, PORTS, "rov")
        self.driver = ArduPilotDriver(
            endpoint,
            outputs,
            Scale(),
            state,
            lambda t_ns, samples: readings.see(samples),
            1200.0,
            3.0,
            lambda: self.now,
            self.stats,
            self.conflicts.append,
        )

    def tick(self, **values: tuple) -> None:
        """A tick of the world; `pose`, `velocity`, `imu` ... give other samples than the vehicle at rest."""
        self.t_ns += 1_000_000
        rest = {
            "truth/pose": ((1.0, 2.0, 3.0), EAST),
            "truth/velocity": ((0.5, 0.0, 0.0), (0.0, 0.0, 0.1)),
            "imu": ((0.0, 0.0, -9.81), (0.0, 0.0, 0.1), 15.0),
        }
        rest |= {name.replace("_", "/"): value for name, value in values.items()}
        self.driver.see(
            self.t_ns, [Sample(f"rov/{name}", 0, self.t_ns, self.t_ns, True, value) for name, value in rest.items()]
        )

    def order(self) -> Order | None:
        """What the driver orders for a frame that was sent."""
        return self.driver.order(60.0)

    def listen(self, seconds: float) -> None:
        """Wall time in which the driver is asked and nothing comes."""
        for _ in range(round(seconds / 0.4)):
            self.now += 0.4
            self.nothing()

    def nothing(self) -> None:
        """Nothing is there to be ordered."""
        assert self.driver.order(0.0) is None

    def turns_away(self, datagrams: int = 1) -> None:
        """Of so many that were sent none is a tick."""
        before, end = self.turned_away, time.monotonic() + 60.0
        while self.turned_away < before + datagrams and time.monotonic() < end:
            assert self.driver.order(0.01) is None
        assert self.turned_away == before + datagrams

    @property
    def turned_away(self) -> int:
        return sum(map(self.count, ("duplicates", "strangers", "bad_magic", "bad_length")))

    def step(self, pwm: list[int], number: int | None = None, **values: tuple) -> dict[str, tuple[float, ...]]:
        """A whole frame: sent, ordered, ticked, answered, read."""
        self.peer.send(pwm, number)
        order = self.order()
        assert order is not None
        assert order.ticks == 1
        self.tick(**values)
        self.driver.answer(self.t_ns)
        answer = self.peer.receive(60.0)
        assert answer is not None
        return read(answer)

    def count(self, name: str) -> int:
        return int(self.stats.details[name])  # type: ignore[arg-type]


@contextlib.contextmanager
def rig(channels: int = 16, rangefinders: tuple[str, ...] = (), rate_hz: int = 1200) -> Iterator[Rig]:
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as endpoint:
        endpoint.setblocking(False)
        endpoint.bind(("127.0.0.1", 0))
        with contextlib.closing(ArduPilotPeer("127.0.0.1", endpoint.getsockname()[1], channels, rate_hz)) as peer:
            yield Rig(endpoint, peer, rangefinders)


@contextlib.contextmanager
def another(rig: Rig) -> Iterator[ArduPilotPeer]:
    with contextlib.closing(ArduPilotPeer("127.0.0.1", rig.endpoint.getsockname()[1])) as peer:
        yield peer


def test_a_frame_is_a_tick_and_its_answer_the_state_after_it() -> None:
    with rig() as r:
        state = r.step([1500] * 8)
        assert state["timestamp"] == (0.001,)
        assert state["position"] == (1.0, 2.0, 3.0)
        assert state["quaternion"] == pytest.approx(EAST)
        assert state["velocity"] == pytest.approx((0.0, 0.5, 0.0), abs=1e-12), (
            "surge of a vehicle that looks east goes east"
        )
        assert state["imu/gyro"] == (0.0, 0.0, 0.1)
        assert state["imu/accel_body"] == (0.0, 0.0, -9.81)
        assert (r.stats.peers, r.count("frames")) == (1, 1)


def test_commands_go_to_the_thrusters_by_channel() -> None:
    with rig() as r:
        r.peer.send([1900, 1100, 1700, 1300, 0, 1500, 2200, 800, 1900])
        order = r.order()
        assert order == Order(1, [("rov/thrusters", {"u": [1.0, -1.0, 0.5, -0.5, 0.0, 0.0, 1.0, -1.0]})])
        assert r.count("limited") == 1
        assert r.stats.commands == 1
        r.peer.send([1500] * 8 + [5000] * 8, 1)  # outputs that move nothing here
        assert r.order() is not None
        assert r.count("limited") == 1


def test_thirty_two_channels() -> None:
    with rig(channels=32) as r:
        r.peer.send([1500] * 7 + [1600] + [1900] * 24)
        order = r.order()
        assert order is not None
        assert order.commands == [("rov/thrusters", {"u": [0.0] * 7 + [0.25]})]


def test_a_repeated_frame_is_answered_with_the_last_state_and_no_tick() -> None:
    with rig() as r:
        r.peer.send([1500] * 8, 5)
        assert r.order() is not None
        r.tick()
        r.driver.answer(r.t_ns)
        first = r.peer.receive(60.0)
        r.tick()  # the world's state is another now
        for again in (1, 2):
            r.peer.send([1900] * 8, 5)
            r.turns_away()
            assert r.peer.receive(60.0) == first
            assert r.count("duplicates") == again
        assert r.count("frames") == 1
        r.step([1500] * 8, 6)


def test_frames_that_were_lost_are_counted_and_are_no_ticks() -> None:
    with rig() as r:
        r.step([1500] * 8, 0)
        r.step([1500] * 8, 4)
        assert (r.count("lost"), r.count("frames")) == (3, 2)


def test_numbers_use_all_of_their_32_bits() -> None:
    with rig() as r:
        for number in (65_535, 65_536, 65_537, 2**31, 2**32 - 1):
            r.step([1500] * 8, number)
        assert (r.count("restarts"), r.count("duplicates")) == (0, 0)


def test_an_autopilot_that_restarts_is_taken_up_again() -> None:
    with rig() as r:
        for number in (0, 1, 2):
            r.step([1500] * 8, number)
        r.step([1500] * 8, 0)
        r.step([1500] * 8, 1)
        assert (r.count("restarts"), r.count("lost"), r.count("frames")) == (1, 0, 5)


def test_one_that_restarts_has_another_address() -> None:
    with rig() as r, another(r) as second:
        r.step([1500] * 8, 700)
        r.listen(1.2)
        second.send([1500] * 8, 0)
        assert r.order() is not None
        r.driver.answer(r.t_ns)
        assert second.receive(60.0) is not None
        assert r.count("restarts") == 1
        assert r.peer.receive(0.05) is None


def test_a_second_autopilot_is_kept_out_until_the_first_is_silent() -> None:
    with rig() as r, another(r) as second:
        r.step([1500] * 8, 700)
        second.send([1900] * 8, 33)
        r.turns_away()
        assert second.receive(0.05) is None
        assert r.count("strangers") == 1
        assert "two autopilots" in r.stats.last_error
        r.step([1500] * 8, 701)
        r.listen(4.0)
        assert r.stats.peers == 0
        second.send([1900] * 8, 34)
        assert r.order() is not None


def test_who_plays_back_what_an_autopilot_said_gets_neither_a_tick_nor_an_answer() -> None:
    """From its first frame on, beside the autopilot that speaks."""
    with rig() as r, another(r) as thief:
        for number in range(100, 120):
            r.step([1500] * 8, number)
            for replayed in range(21):
                thief.send([1900] * 8, replayed)
            r.turns_away(21)
            assert thief.receive(0.001) is None
        assert r.count("strangers") == 20 * 21
        assert (r.count("frames"), r.count("restarts"), r.stats.peers) == (20, 0, 1)


def test_garbage_at_random_moves_nothing_and_the_autopilot_goes_on() -> None:
    dice = np.random.default_rng(14)
    frame = servo_packet(0, [1900] * 8)
    with rig() as r, another(r) as stranger:
        r.step([1500] * 8, 7)
        sent = 0
        for number in range(8, 28):
            for _ in range(50):
                data = bytearray(frame)
                for _ in range(dice.integers(1, 4)):
                    data[dice.integers(len(data))] = dice.integers(256)
                stranger.send_raw(bytes(data[: dice.choice((len(data), len(data), dice.integers(len(data)), 2))]))
                sent += 1
            r.turns_away(50)
            r.step([1500] * 8, number)
        counted = sum(r.count(name) for name in ("strangers", "bad_magic", "bad_length"))
        assert counted == sent
        assert stranger.receive(0.001) is None
        assert (r.count("frames"), r.count("restarts"), r.count("lost")) == (21, 0, 0)


def test_a_stray_frame_with_number_0_takes_nothing_over(caplog: pytest.LogCaptureFixture) -> None:
    """A second ArduSub that is started on the same port; the first goes on, and somebody is told."""
    with rig() as r, another(r) as second:
        for number in range(700, 710):
            r.step([1500] * 8, number)
            second.send([1900] * 8, 0)
            r.turns_away()
        assert second.receive(0.05) is None
        assert (r.count("frames"), r.count("strangers"), r.count("restarts")) == (10, 10, 0)
        assert "two autopilots send here" in r.stats.last_error
        assert "port of its own" in r.stats.last_error
        assert [line.count("second autopilot") for line in caplog.messages if "refused" in line] == [1]  # not ten times
        assert r.conflicts == [r.stats.last_error]


def test_a_pause_of_the_world_is_no_silence_of_its_autopilot() -> None:
    with rig() as r, another(r) as second:
        r.step([1500] * 8, 700)
        r.now += 60.0  # nobody asked the driver
        r.peer.send([1500] * 8, 701)
        second.send([1900] * 8, 0)
        r.tick()
        order = r.order()
        assert order is not None
        r.driver.answer(r.t_ns)
        assert r.peer.receive(60.0) is not None
        assert second.receive(0.05) is None


def test_who_takes_over_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with rig() as r, another(r) as second:
        r.step([1500] * 8, 700)
        r.listen(1.2)
        second.send([1500] * 8, 0)
        assert r.order() is not None
        assert any("takes over the vehicle" in line for line in caplog.messages)


def test_a_simulator_that_restarts_takes_any_number() -> None:
    with rig() as r:
        r.step([1500] * 8, 123_456)
        assert (r.count("lost"), r.count("restarts")) == (0, 0)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "bad_length"),
        (b"\x00" * 40, "bad_magic"),
        (servo_packet(0, [1900] * 8)[:-2], "bad_length"),
        (servo_packet(0, [1900] * 8) + b"\0\0", "bad_length"),
        (servo_packet(0, [1900] * 8, channels=32, magic=18458), "bad_length"),
        (servo_packet(0, [1900] * 8, magic=29569), "bad_length"),
        (b"\x1a\x48" * 700, "bad_length"),
        (b"GET / HTTP/1.1\r\n\r\n", "bad_magic"),
    ],
)
def test_what_is_no_frame_is_counted_and_changes_nothing(data: bytes, reason: str) -> None:
    with rig() as r:
        r.step([1500] * 8, 0)
        r.peer.send_raw(data)
        r.turns_away()
        assert r.peer.receive(0.02) is None
        assert (r.count(reason), r.stats.errors) == (1, 1)
        r.step([1500] * 8, 1)
        assert (r.count("restarts"), r.count("lost")) == (0, 0)


def test_garbage_before_a_frame_does_not_hide_it() -> None:
    with rig() as r:
        for _ in range(50):
            r.peer.send_raw(b"junk")
        r.step([1500] * 8)
        assert r.count("bad_magic") == 50


def test_what_was_repeated_during_a_pause_is_answered_once() -> None:
    """Else the autopilot would take a repeated answer for that to its next frame, and stay a frame behind for ever."""
    with rig() as r:
        r.step([1500] * 8, 0)
        for _ in range(4):
            r.peer.send([1500] * 8, 1)
        r.now += 5.0  # nobody looked meanwhile
        assert r.order() is not None
        assert r.count("duplicates") == 3
        r.tick()
        r.driver.answer(r.t_ns)
        assert r.peer.receive(60.0) is not None
        r.nothing()
        assert r.peer.receive(0.05) is None


def test_what_was_repeated_while_the_tick_waited_is_answered_with_it() -> None:
    with rig() as r:
        r.peer.send([1500] * 8, 1)
        assert r.order() is not None
        for _ in range(3):
            r.peer.send([1500] * 8, 1)
        r.now += 5.0  # world/pause between the order and its tick
        r.tick()
        r.driver.answer(r.t_ns)
        assert r.peer.receive(60.0) is not None
        r.nothing()
        assert r.peer.receive(0.05) is None
        assert r.count("duplicates") == 3


def test_an_answer_never_holds_what_is_no_number() -> None:
    with rig(rangefinders=("altimeter",)) as r:
        good = r.step([1500] * 8, 0)
        nan, inf = math.nan, math.inf
        bad = r.step(
            [1500] * 8, 1, truth_pose=((nan, 0.0, 0.0), EAST), truth_velocity=((inf, 0.0, 0.0), (0.0, 0.0, nan)),
            imu=((nan, nan, nan), (None, None, None), 1.0), altimeter=(nan, 1.0), battery=(None, None),
        )  # fmt: skip
        for key in ("position", "quaternion", "velocity", "imu/gyro", "imu/accel_body"):
            assert bad[key] == good[key]
        assert bad["rng_1"] == (NO_ECHO_M,)
        assert "battery/voltage" not in bad


def test_rangefinder_and_battery() -> None:
    with rig(rangefinders=("altimeter",)) as r:
        assert r.step([1500] * 8, 0)["rng_1"] == (NO_ECHO_M,)
        state = r.step([1500] * 8, 1, altimeter=(2.5, 1.0), battery=(15.5, 8.25))
        assert (state["rng_1"], state["battery/voltage"], state["battery/current"]) == ((2.5,), (15.5,), (8.25,))
        assert state["no_time_sync"] == (1.0,)
        assert r.step([1500] * 8, 2)["rng_1"] == (2.5,), "the last echo holds until the next ping"


def test_before_the_imu_has_spoken_the_vehicle_is_at_rest() -> None:
    with rig() as r:
        state = r.step([1500] * 8, 0, imu=((None,) * 3, (None,) * 3, None))
        assert state["imu/accel_body"] == pytest.approx((0.0, 0.0, -9.80665))
        assert state["imu/gyro"] == (0.0, 0.0, 0.1)


def test_another_frame_rate_is_told_and_never_followed(caplog: pytest.LogCaptureFixture) -> None:
    with rig(rate_hz=400) as r:
        for number in range(RATE_FRAMES + 5):
            r.step([1500] * 8, number)
        assert r.count("frame_rate_hz") == 400
        assert "--rate 1200" in r.stats.last_error
        assert caplog.text.count("requests 400") == 1
        assert r.t_ns == (RATE_FRAMES + 5) * 1_000_000


def test_a_wish_that_walks_to_its_goal_is_not_told() -> None:
    """After a start with `--rate` the field goes from 1200 to that rate by 1 Hz a frame."""
    with rig(rate_hz=1200 + 2 * RATE_FRAMES) as r:
        for number in range(2 * RATE_FRAMES + 5):
            r.step([1500] * 8, number)
            r.peer.rate_hz = max(1200, r.peer.rate_hz - 1)
        assert r.count("frame_rate_hz") == 1200
        assert r.stats.last_error == ""


def test_silence() -> None:
    with rig() as r:
        r.step([1500] * 8)
        r.listen(2.0)
        assert r.stats.peers == 1
        r.listen(2.0)
        assert r.stats.peers == 0
        r.step([1500] * 8, 1)
        assert r.stats.peers == 1


def test_a_refusal_is_counted() -> None:
    with rig() as r:
        r.driver.refuse(Fault("denied", "it is deactivated"))
        assert (r.stats.errors, r.stats.last_error) == (1, "it is deactivated")


# -- tables -----------------------------------------------------------------------------------------------------------------------------


def test_outputs_of_any_actuator() -> None:
    tables = {
        "rudder": OutputTable(port="rudder", field="angle_rad", channels=(9,), full_deg=-10.0),
        "thrusters": OutputTable(channels=(8, 7, 6, 5, 4, 3, 2, 1), full=(1.0,) * 7 + (-0.5,)),
    }
    commands = dict(Outputs(tables, PORTS, "rov").commands([0.125 * n for n in range(1, 9)] + [0.5]))
    assert commands["rov/rudder"]["angle_rad"] == pytest.approx(math.radians(-5.0))
    assert commands["rov/thrusters"]["u"] == [1.0, 0.875, 0.75, 0.625, 0.5, 0.375, 0.25, -0.0625]


@pytest.mark.parametrize(
    ("table", "phrase"),
    [
        (OutputTable(port="fins"), 'no actuator "rov/fins"; there are: rov/rudder, rov/thrusters'),
        (OutputTable(port="imu"), 'no actuator "rov/imu"'),
        (OutputTable(field="force"), 'no field "force", it has: u'),
        (OutputTable(channels=(1, 2)), "channels has 2 numbers"),
        (OutputTable(full=(1.0,)), "full has 1 numbers"),
        (OutputTable(full_deg=10.0), "is in 1: full_deg is for radians"),
        (OutputTable(port="rudder", field="angle_rad", full=1.0, full_deg=1.0), "not together with full"),
    ],
)
def test_outputs_that_do_not_fit(table: OutputTable, phrase: str) -> None:
    with pytest.raises(CannotServe, match=phrase):
        Outputs({"x": table}, PORTS, "rov")


def test_readings_that_do_not_fit() -> None:
    readings = Readings(PORTS, "rov")
    with pytest.raises(CannotServe, match='imu: no sensor "rov/gyro"'):
        readings.subscribe("imu", "gyro", [("w_S",)])
    with pytest.raises(CannotServe, match="needed is p_NB and q_NB or p_NS"):
        readings.subscribe("pose", "imu", [("p_NB", "q_NB"), ("p_NS",)])


# -- a real one, recorded by tests/integration/record_ardusub.py ----------------------------------------------------------------------


def recordings() -> dict[str, list[tuple[bytes, bytes]]]:
    """Frames of an ArduSub and what we answered, by recording."""
    file = Path(__file__).parent / "recorded" / "ardusub.jsonl.gz"
    about, *lines = map(json.loads, gzip.decompress(file.read_bytes()).splitlines())
    assert about.startswith("ArduSub V")
    found: dict[str, list[tuple[bytes, bytes]]] = {}
    frame = b""
    for line in lines:
        if isinstance(line, dict):
            pairs = found[line["recording"]] = []
        elif line[0] == ">":
            frame = bytes.fromhex(line[1])
        else:
            pairs.append((frame, line[1].encode()))
    return found


RECORDINGS = recordings()


def level(pwm: int) -> float:
    return (pwm - 1500) / 400 if pwm else 0.0


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_real_ardusub(name: str) -> None:
    """Each of its frames is one tick, whatever rate it asks for; one that it repeats is answered and is none; all answers are read."""
    size = 32 if name == "32 channels" else 16
    last, repeated, reply = -1, 0, None
    with rig(size) as r:
        for data, ours in RECORDINGS[name]:
            said = read(ours)
            _, rate_hz, number, *pwm = struct.unpack(f"<HHI{size}H", data)
            r.peer.send_raw(data)
            if number == last:
                repeated += 1
                r.turns_away()
                assert r.peer.receive(60.0) == reply, "the same again"
                continue
            order = r.order()
            assert r.count("frame_rate_hz") == rate_hz
            assert order == Order(1, [("rov/thrusters", {"u": [level(width) for width in pwm[:8]]})])
            q_NB = said["quaternion"]
            (stamp,) = said["timestamp"]
            r.t_ns = round(stamp * 1e9) - 1_000_000
            r.tick(
                truth_pose=(said["position"], q_NB),
                truth_velocity=(rotate(conjugate(q_NB), said["velocity"]), said["imu/gyro"]),
                imu=(said["imu/accel_body"], said["imu/gyro"], 15.0),
            )
            r.driver.answer(r.t_ns)
            reply = r.peer.receive(60.0)
            assert reply is not None
            again = read(reply)
            for key in again:
                assert again[key] == pytest.approx(said[key], rel=1e-8, abs=1e-9), key
            last = number
        assert r.count("frames") == len(RECORDINGS[name]) - repeated
        assert r.count("duplicates") == repeated == (name == "960 ticks/s, first answer lost")
        assert [r.count(other) for other in ("lost", "restarts", "strangers", "bad_magic", "bad_length")] == [0] * 5


def test_what_the_real_ardusub_did() -> None:
    """So that the recordings are known to hold what they are for."""
    rates = {name: [int.from_bytes(data[2:4], "little") for data, _ in pairs] for name, pairs in RECORDINGS.items()}
    assert set(rates["start"]) == {1200}
    assert rates["--rate 900"][:301] == list(range(1200, 899, -1)), "it walks"
    assert set(rates["960 ticks/s, first answer lost"]) == {1200, 960, 961}, "it follows our time"
    assert len(RECORDINGS["start"]) == 300
    assert {len(data) for data, _ in RECORDINGS["32 channels"]} == {72}
    steered, _ = RECORDINGS["steered"][-1]
    assert struct.unpack_from("<4H", steered, 8) == (1200, 1400, 1800, 1600)

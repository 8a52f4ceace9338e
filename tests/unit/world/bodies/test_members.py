"""Bodies with all that belongs to them."""

from __future__ import annotations

import gc
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

from sensing_rig import FIELDS, slot_of

from uwserver.ports import Port, Service
from uwserver.world.bodies.members import Member
from uwserver.world.parts.part import Part, State
from uwserver.world.stepping.commands import ActuatorSlot


class Forces(Part):
    path = "rov/forces"
    state_type = State

    def save(self) -> State:
        return State()

    def load(self, state: Any) -> None: ...

    def before(self, tick: int, t_ns: int) -> None: ...


def member() -> Member:
    port = Port("rov/lamp", "actuator", "x", FIELDS, "")
    lamp = ActuatorSlot(port, SimpleNamespace(), Fraction(240), 0)  # type: ignore[arg-type]  # is not used
    vehicle: Any = SimpleNamespace(name="rov")
    return Member(vehicle, (slot_of(),), (lamp,), ((Service("rov/lamp/get", ""), lambda _: None),), others=(Forces(),))


def test_the_parts_of_a_member_are_all_that_comes_and_goes_with_it() -> None:
    rov = member()
    assert rov.parts == (*rov.sensors, *rov.actuators, *rov.others)
    assert set(rov.by_path.parts) == {"rov/x", "rov/lamp", "rov/forces"}


def test_what_belongs_to_it_is_known_by_path_and_what_it_offers_in_order() -> None:
    rov = member()
    assert (set(rov.by_path.sensors), set(rov.by_path.actuators)) == ({"rov/x"}, {"rov/lamp"})
    assert [service.path for service in rov.offered] == ["rov/lamp/get"]
    assert len(rov.carry) == 1
    assert (Member(rov.vehicle).offered, Member(rov.vehicle).carry) == ((), ())


def test_only_those_that_act_or_hear_are_awake() -> None:
    rov = member()
    assert rov.by_path.awake == rov.others


def test_services_are_kept_once() -> None:
    """A hundred vehicles have thousands: a pair for each were 4 kB a vehicle."""
    before = set(map(id, gc.get_objects()))
    rov = member()
    new = [o for o in gc.get_objects() if id(o) not in before and type(o) is tuple]
    pairs = [o for o in new if len(o) > 1 and type(o[0]) is Service and type(o[1]) is not Service]
    assert rov.offered
    assert pairs == []

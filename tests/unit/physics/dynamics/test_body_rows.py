"""Rows of bodies: each kind made once, behind those that are there, with ranges and numbers of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uwserver.physics.dynamics.appendage_params import (
    Appendages,
    DerivativeParams,
    FoilParams,
    ServoParams,
    WeightParams,
    appendage_rows,
)
from uwserver.physics.dynamics.body_rows import BodyRows, appended, rows_of, table_numbers
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, ForceTable, Lag, ThrusterParams, thruster_row
from uwserver.physics.kernel.layout import SHAPE_BOX, WORLD

ZERO = np.zeros((6, 6))
PLAIN = BodyParams(np.eye(6), np.eye(6), ZERO, ZERO, ZERO, 100.0, 100.0, (0.0,) * 3, (0.0,) * 3)
TABLES = [ForceTable((12.0,), (((-1.0, -f), (1.0, f)),)) for f in (10.0, 20.0, 30.0)]


def thruster(table: int, lag: float, name: str = "t") -> ThrusterParams:
    return ThrusterParams(name, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0), TABLES[table], 12.0, Lag.first_order(lag))


def finned(servos: int) -> BodyParams:
    names = [f"s{k}" for k in range(servos)]
    foil = FoilParams("", (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), 5.0, 3.0, 0.1, 0.01, 1.2, 0.3, 0.5)
    return replace(
        PLAIN,
        appendages=Appendages(
            servos=tuple(ServoParams(name, -0.5, 0.5) for name in names),
            foils=(foil, *(replace(foil, servo=name) for name in names)),
            weights=(WeightParams(names[-1], 2.0, (0.1, 0.0, 0.0)),),
            derivatives=(DerivativeParams(0, 0, 0, 1.5), DerivativeParams(1, 0, 0, 2.5, names[0], 1)),
        ),
    )


SHAPED = replace(
    PLAIN,
    shapes=(BuoyancyShape(SHAPE_BOX, (0.0, 0.0, 0.0), (0.2, 0.1, 0.1), 0.01),) * 2,
    thrusters=(thruster(0, 0.1, "a"), thruster(1, 0.2, "b")),
    wrenches=3,
)
BODIES = (SHAPED, finned(2), PLAIN, finned(3), SHAPED)
NONE = {name: np.zeros(0, WORLD[name]) for name in BodyRows._fields}


def test_together_they_are_as_one_by_one() -> None:
    together, one_by_one = appended(NONE, [rows_of(body) for body in BODIES]), NONE
    for body in BODIES:
        one_by_one = appended(one_by_one, [rows_of(body)])
    assert {name: rows.tobytes() for name, rows in together.items()} == {
        name: rows.tobytes() for name, rows in one_by_one.items()
    }


def test_each_body_has_its_ranges_and_the_servos_are_its_own() -> None:
    rows = appended(NONE, [rows_of(body) for body in BODIES])
    bodies = rows["bodies"]
    assert bodies["servo_first"].tolist() == [0, 0, 2, 2, 5]
    assert bodies["servo_count"].tolist() == [0, 2, 0, 3, 0]
    assert bodies["shape_first"].tolist() == [0, 2, 2, 2, 2]
    assert bodies["thruster_first"].tolist() == [0, 2, 2, 2, 2]
    assert bodies["wrench_first"].tolist() == [0, 3, 4, 5, 6]
    # As they were made for a body whose servos begin there; a fixed foil has none.
    assert rows["foils"]["servo"].tolist() == [-1, 0, 1, -1, 2, 3, 4]
    assert rows["weights"]["servo"].tolist() == [1, 4]
    assert rows["derivatives"]["servo"].tolist() == [-1, 0, -1, 2]
    for name, expected in appendage_rows(finned(3).appendages, 2).items():
        kind = name.removesuffix("s")
        first, count = int(bodies[f"{kind}_first"][3]), int(bodies[f"{kind}_count"][3])
        assert rows[name][first : first + count].tobytes() == expected.tobytes()


def test_who_is_there_stays_as_he_is() -> None:
    before = appended(NONE, [rows_of(SHAPED)])
    before["thrusters"]["command"] = 0.7
    kept = {name: rows.tobytes() for name, rows in before.items()}
    made = rows_of(finned(2))
    after = appended(before, [made, made])
    assert {name: rows.tobytes() for name, rows in before.items()} == kept
    for name in kept:
        assert after[name][: len(before[name])].tobytes() == kept[name]
    assert made.foils["servo"].tolist() == [-1, 0, 1], "what is shared was written to"


def test_tables_and_lags_are_numbered_as_they_are_met_and_equal_ones_once() -> None:
    tables: dict[ForceTable, int] = {}
    lags: dict[Lag, int] = {}
    other = replace(PLAIN, thrusters=(thruster(2, 0.2), thruster(0, 0.3), thruster(2, 0.1)))
    assert table_numbers((SHAPED, PLAIN, other), tables, lags).tolist() == [[0, 0], [1, 1], [2, 1], [0, 2], [2, 0]]
    assert list(tables) == TABLES
    assert table_numbers((other,), tables, lags).tolist() == [[2, 1], [0, 2], [2, 0]]
    assert table_numbers((), tables, lags).shape == (0, 2)


def test_a_thruster_has_its_row_but_for_the_numbers() -> None:
    made = rows_of(SHAPED)
    assert made.thrusters[:1].tobytes() == thruster_row(SHAPED.thrusters[0], 0, 0).tobytes()

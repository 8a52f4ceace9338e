"""What processes of a bench are told to do, and what they answer."""

from __future__ import annotations

import json

import pytest
from uwserver_bench.processes import carry_out


def test_each_task_has_its_result_and_one_that_fails_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    def double(task):  # type: ignore[no-untyped-def]
        if task["n"] < 0:
            raise ValueError("less than nothing")
        return {"doubled": 2 * task["n"]}

    lines = [json.dumps({"task": "double", "n": n}) for n in (3, -1, 4)]
    carry_out({"double": double}, "load", lines=lines)
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert answers == [{"doubled": 6}, {"failed": "load task double: less than nothing"}, {"doubled": 8}]


def test_what_is_no_failure_of_a_task_ends_the_process() -> None:
    with pytest.raises(ZeroDivisionError):
        carry_out({"divide": lambda task: {"one": 1 // task["by"]}}, "load", lines=['{"task": "divide", "by": 0}'])

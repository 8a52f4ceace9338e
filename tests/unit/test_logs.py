"""Log lines for people and for machines."""

from __future__ import annotations

import json
import logging

import pytest

from uwserver.logs import JsonFormatter, set_up_logging


@pytest.fixture
def logger():
    root, numba = logging.getLogger(), logging.getLogger("numba")
    before = (root.handlers[:], root.level, numba.level)
    yield logging.getLogger("uwserver.test")
    root.handlers[:], level, numba_level = before
    root.setLevel(level)
    numba.setLevel(numba_level)


def lines(capsys) -> list[str]:
    captured = capsys.readouterr()
    assert captured.out == ""  # standard output belongs to the verb's result
    return captured.err.splitlines()


def test_readable_lines(logger, capsys):
    set_up_logging("info", as_json=False)
    logger.info("port %d", 7600)
    (line,) = lines(capsys)
    assert line.endswith(" INFO uwserver.test: port 7600")


def test_one_json_object_a_line(logger, capsys):
    set_up_logging("info", as_json=True)
    logger.warning('two\nlines and "quotes" and Zürich')
    logger.info("more")
    first, second = (json.loads(line) for line in lines(capsys))
    assert first.pop("time") <= second.pop("time")
    assert first == {"level": "warning", "logger": "uwserver.test", "text": 'two\nlines and "quotes" and Zürich'}
    assert second == {"level": "info", "logger": "uwserver.test", "text": "more"}


def test_a_traceback_stays_in_its_line(logger, capsys):
    set_up_logging("info", as_json=True)
    try:
        raise ValueError("broken")
    except ValueError:
        logger.exception("failed")
    (line,) = lines(capsys)
    entry = json.loads(line)
    assert entry["text"] == "failed"
    assert entry["exception"].startswith("Traceback")
    assert entry["exception"].endswith("ValueError: broken")


@pytest.mark.parametrize(("level", "seen"), [("debug", 3), ("info", 2), ("warning", 1)])
def test_the_level_is_kept(logger, capsys, level, seen):
    set_up_logging(level, as_json=False)
    logger.debug("a")
    logger.info("b")
    logger.warning("c")
    assert len(lines(capsys)) == seen


def test_setting_up_twice_does_not_say_everything_twice(logger, capsys):
    set_up_logging("info", as_json=True)
    set_up_logging("info", as_json=False)
    logger.info("once")
    assert len(lines(capsys)) == 1


def test_the_compiler_is_quiet(logger, capsys):
    set_up_logging("debug", as_json=False)
    logging.getLogger("numba.core").debug("every byte-code")
    assert lines(capsys) == []


def test_an_unknown_level_is_refused(logger):
    with pytest.raises(ValueError, match="LOUD"):
        set_up_logging("loud", as_json=False)


def test_the_formatter_needs_no_arguments():
    record = logging.LogRecord("x", logging.ERROR, "", 0, "%s and %s", ("a", "b"), None)
    assert json.loads(JsonFormatter().format(record))["text"] == "a and b"

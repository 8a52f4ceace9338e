"""Log lines for people and for machines."""

from __future__ import annotations

import io
import json
import logging
import sys

import pytest

from uwserver import logs
from uwserver.logs import CAUSES, TOLD_S, VARIED, JsonFormatter, SparingLog, set_up_logging


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


FORGED = "\x1b[2J\x07\x9b31m\u202e\r\n2026-01-01 00:00:00,000 INFO uwserver.server: all is well\u2028\x7f"
"""What a stranger may send: commands of a terminal, and a line that looks like one of ours."""


@pytest.mark.parametrize("terminal", [True, False])
def test_no_text_forges_a_line_or_commands_a_terminal(logger, capsys, monkeypatch, terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    monkeypatch.setenv("NO_COLOR", "1")
    set_up_logging("info", as_json=False)
    logger.warning("unknown operation %s", FORGED)
    try:
        raise ValueError(FORGED)
    except ValueError:
        logger.exception("failed at %s", FORGED)
    written = capsys.readouterr().err
    assert not [c for c in written if c != "\n" and not c.isprintable()]
    first, second, *traceback = written.splitlines()
    assert "\\x1b[2J\\x07\\x9b31m\\u202e\\r\\n2026" in first
    assert first.endswith("all is well\\u2028\\x7f")
    assert second.endswith("all is well\\u2028\\x7f")
    assert [line for line in traceback if "all is well" in line]
    assert all(line.startswith("  ") for line in traceback), "each line that is no record is indented"


def test_json_stays_one_line_and_says_what_was_sent(logger, capsys):
    set_up_logging("info", as_json=True)
    logger.warning("unknown operation %s", FORGED)
    written = capsys.readouterr().err
    assert not [c for c in written if c != "\n" and not c.isprintable()]
    assert json.loads(written)["text"] == f"unknown operation {FORGED}"


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


# -- floods -------------------------------------------------------------------------------------------------------------------------


class Page:
    """A handler and what it wrote; records with a time of the test's own."""

    def __init__(self) -> None:
        self.stream = io.StringIO()
        self.handler = SparingLog(self.stream)
        self.now = logging.makeLogRecord({}).created

    def say(
        self, text: str, *args: object, level: int = logging.WARNING, name: str = "asyncio", exc: object = None
    ) -> None:
        record = logging.LogRecord(name, level, "", 0, text, args, exc)
        record.created = self.now
        self.handler.handle(record)

    def lines(self) -> list[str]:
        return self.stream.getvalue().splitlines()


def test_a_cause_is_written_once_a_minute_with_its_count():
    page = Page()
    for _ in range(130_000):
        page.say("socket.send() raised exception.")
    page.say("another")
    assert page.lines() == ["socket.send() raised exception.", "another"]
    page.now += TOLD_S
    page.say("socket.send() raised exception.")
    assert page.lines()[2:] == [
        "socket.send() raised exception. (129999 more of these since the line before)",
        "socket.send() raised exception.",
    ]


def test_the_count_comes_without_a_further_line_and_at_the_end(monkeypatch: pytest.MonkeyPatch):
    page = Page()
    page.now -= TOLD_S / 2
    page.say("a")
    page.say("a")
    page.now += TOLD_S / 2
    page.say("b")
    page.say("b")
    page.handler.flush()
    assert page.lines() == ["a", "b"]
    monkeypatch.setattr(logs, "TOLD_S", TOLD_S / 3)
    page.handler.flush()
    assert page.lines()[2:] == ["a (1 more of these since the line before)"]
    page.handler.close()
    assert page.lines()[3:] == ["b (1 more of these since the line before)"]


def test_lines_that_differ_in_what_they_name_are_written_some_times():
    page = Page()
    for number in range(100):
        page.say("%s failed", number)
    assert page.lines() == [f"{number} failed" for number in range(VARIED)]
    page.handler.close()
    assert page.lines()[-1] == "99 failed (90 more of these since the line before)"


def test_tracebacks_of_one_cause_are_written_once():
    page = Page()
    for number in range(1000):
        try:
            raise OSError(24, "Too many open files")
        except OSError:
            page.say(f"socket.accept() out of system resource\nsocket: <fd={number}>", exc=sys.exc_info())
    assert page.stream.getvalue().count("Traceback") == 1
    page.say("socket.accept() out of system resource\nsocket: <fd=1>")
    assert page.stream.getvalue().count("socket.accept()") == 2, "without a traceback it is another cause"


def test_what_is_remembered_is_bounded_and_debugging_is_not_cut():
    page = Page()
    for number in range(10 * CAUSES):
        page.say(f"text {number}")
        page.say("so", level=logging.DEBUG)
    assert len(page.lines()) == 20 * CAUSES
    assert len(page.handler._causes) == CAUSES


def test_the_server_s_log_is_spared(logger, capsys):
    set_up_logging("info", as_json=False)
    for _ in range(1000):
        logging.getLogger("asyncio").warning("socket.send() raised exception.")
    assert len(lines(capsys)) == 1

"""The browser that draws pictures: how it is found, and what is told when it is not there, does not start or does not answer."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest
from chromium_rig import chromium_or_skip

from uwserver.cli.browser import chromium as driver
from uwserver.cli.browser.chromium import NAMES, Browser, ChromiumFailed, NoChromium, browsing, chromium


def program(folder: Path, name: str, script: str = "exit 0") -> Path:
    file = folder / name
    file.write_text(f"#!/bin/sh\n{script}\n")
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    return file


@pytest.mark.parametrize("name", NAMES)
def test_it_is_found_by_any_of_its_names(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    file = program(tmp_path, name)
    assert chromium() == str(file)


def test_a_program_that_is_named_is_taken_before_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    program(tmp_path, "chromium")
    other = program(tmp_path, "other")
    assert chromium("other") == chromium(str(other)) == str(other)
    with pytest.raises(NoChromium, match='no program "third"'):
        chromium("third")


def test_without_one_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NoChromium, match="apt install chromium"):
        chromium()


def test_one_that_ends_at_once_is_told_by_its_last_words(tmp_path: Path) -> None:
    folder = tmp_path / "profile"
    folder.mkdir()
    broken = program(tmp_path, "chromium", "echo 'no such display' >&2; exit 7")
    with pytest.raises(ChromiumFailed, match="status 7: no such display"), browsing(str(broken), folder):
        pass


class Socket:
    """Answers as told; an exception is raised."""

    def __init__(self, *answers: object) -> None:
        self.answers = list(answers)
        self.sent: list[dict[str, object]] = []

    def send(self, text: str) -> None:
        self.sent.append(json.loads(text))

    def recv(self, timeout: float) -> str:
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return json.dumps(answer)


def test_a_command_waits_for_its_own_answer() -> None:
    browser = Browser(Socket({"method": "Target.x", "params": {}}, {"id": 1, "result": {"a": 2}}), "")  # type: ignore[arg-type]
    assert browser.say("Something", value=3) == {"a": 2}


@pytest.mark.parametrize("answer", [{"id": 1, "error": {"message": "no"}}, TimeoutError()])
def test_a_refusal_and_silence_are_told_with_the_command(answer: object) -> None:
    with pytest.raises(ChromiumFailed, match="Something"):
        Browser(Socket(answer), "").say("Something")  # type: ignore[arg-type]


class Answering(driver.Page):
    """A page whose answers are known."""

    def __init__(self, *answers: object) -> None:
        super().__init__(None, "", "")  # type: ignore[arg-type]
        self.answers = list(answers)

    def ask(self, expression: str) -> object:
        return self.answers.pop(0)


class Clock:
    """Wall time that a wait lets pass."""

    def __init__(self) -> None:
        self.now = 0

    def now_ns(self) -> int:
        return self.now

    def wait(self, seconds: float, wake: object) -> None:
        self.now += int(100 * 1e9)


def test_patience_begins_anew_while_something_proceeds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "_TIME", Clock())
    Answering([False, 1], [False, 2], [False, 3], [False, 4], [True, 5]).wait("it")
    with pytest.raises(ChromiumFailed, match="why not"):
        Answering([False, 1], [False, 1], [False, 1], "said").wait("it", "why not")


def test_files_under_way_are_counted() -> None:
    page = Answering()
    for event, number in (("requestWillBeSent", "1"), ("requestWillBeSent", "2"), ("loadingFinished", "1")):
        page.hear({"method": f"Network.{event}", "params": {"requestId": number}})
    assert page.loading == {"2"}
    page.hear({"method": "Network.loadingFailed", "params": {"requestId": "2"}})
    assert page.loading == set()


def test_a_script_that_throws_is_told(tmp_path_factory: pytest.TempPathFactory) -> None:
    with browsing(chromium_or_skip(), tmp_path_factory.mktemp("t"), "globalThis.mark = 7") as browser:
        page = browser.open("data:text/html,<p>x", size=(400, 320))
        assert page.ask("mark") == 7
        with pytest.raises(ChromiumFailed, match="nothing_of_that_name"):
            page.ask("nothing_of_that_name")

"""The adapter of docs/how-to/write-an-adapter.md runs as printed, and with one fault each it does not pass the checks of calls.

Also of uwserver.testing.call_checks.
"""

from __future__ import annotations

import asyncio
import importlib.util
import json
import re
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from uwserver.ports import Fault
from uwserver.testing import FakeContext, Requests, TcpPeer
from uwserver.testing.adapter_kit import AdapterKit
from uwserver.testing.adapters import CHECKS

PAGE = Path(__file__).parents[3] / "docs/how-to/write-an-adapter.md"
ADAPTER, TEST = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.S | re.M)
CALL = b'call world/run_until {"t_s":9}\n'
REQUESTS = Requests(CALL, cancel=b"cancel\n", brief=CALL, many=CALL, misspelt=b"call world/run_untill {}\n")


def module(name: str, source: str, folder: Path) -> ModuleType:
    """A file of this source, imported."""
    file = folder / f"{name}.py"
    file.write_text(source)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    sys.modules[name] = made
    spec.loader.exec_module(made)
    return made


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    yield
    sys.modules.pop("words", None)


def test_it_is_short():
    assert ADAPTER.count("\n") <= 120


def test_it_passes_all_checks_by_the_test_of_the_page(tmp_path: Path):
    module("words", ADAPTER, tmp_path)
    module("words_test", TEST, tmp_path).test_words()


class Talk:
    """A peer of the page's adapter that reads lines."""

    def __init__(self, context: FakeContext, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.context, self.reader, self.writer = context, reader, writer

    async def ask(self, line: str) -> str:
        self.writer.write(line.encode() + b"\n")
        return await self.hear()

    async def hear(self) -> str:
        return (await asyncio.wait_for(self.reader.readline(), 10)).decode().rstrip("\n")


@asynccontextmanager
async def talking(folder: Path) -> AsyncIterator[Talk]:
    words = module("words", ADAPTER, folder)
    context, ready = FakeContext(), asyncio.Event()
    task = asyncio.create_task(words.WordsAdapter(words.WordsConfig(port=0), context).run(ready))
    await asyncio.wait_for(ready.wait(), 10)
    host, _, port = context.stats.address.rpartition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    try:
        yield Talk(context, reader, writer)
    finally:
        writer.close()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def test_it_speaks_as_the_page_says(tmp_path: Path):
    async def scene() -> None:
        async with talking(tmp_path) as talk:
            context = talk.context
            assert await talk.ask("hear rov/*") == "ok"
            context.emit("rov/depth")
            name, seq, value = (await talk.hear()).split(" ", 2)
            assert (name, seq, json.loads(value)) == ("rov/depth", "0", {"depth": 0.0})
            assert await talk.ask('set rov/thrusters {"u":[0,0,0,0,0,0,0,0.2]}') == "ok 1"
            assert context.commands[0].value == ((0, 0, 0, 0, 0, 0, 0, 0.2),)
            text = await talk.ask("call world/paus")
            assert text.startswith('error unknown_service no service "world/paus" (did you mean "world/pause"?)')
            assert (await talk.ask("cal world/pause")).startswith(
                'error unknown_method no verb "cal" (did you mean "call"?)'
            )
            assert (await talk.ask("set rov/thrusters {")).startswith("error parse_error ")
            assert (await talk.ask("set rov/thrusters 5")).startswith("error bad_argument ")
            assert await talk.ask("cancel") == "error invalid_request no call is under way"

    asyncio.run(scene())


def test_who_sends_nothing_more_still_gets_its_answer(tmp_path: Path):
    async def scene() -> None:
        async with talking(tmp_path) as talk:
            talk.writer.write(b"call world/pause\n")
            talk.writer.write_eof()
            assert await asyncio.wait_for(talk.reader.read(), 10) == b"ok 0\n"

    asyncio.run(scene())


# One fault each: what it replaces in the adapter of the page, and which check of the suite must say what.
FAULTS = {
    "leaves its calls": ("self.conversation.close()", "pass", "leaves_in_the_middle_of_a_call", "call of a peer that has left goes on"),
    "does not cancel": ("self.conversation.cancel(", "self.conversation.is_running(", "cancel", "a cancelled call goes on"),
    "has no time-out": ("timeout_s=self.adapter.config.call_timeout_s", "timeout_s=None", "time_out", "goes on after its time-out"),
    "tells no time-out": ("self.refuse(reply.fault) if reply.fault", "None if reply.fault", "time_out", "the peer is not told"),
    "keeps all that is asked": (
        'Conversation(adapter.context, "")',
        'Conversation(adapter.context, "", __import__("uwserver.adapter").adapter.InFlightLimit(10**9))',
        "flood",
        "calls of one peer wait",
    ),
    "ends in a flood": ("self.stats.errors += 1", "self.stats.errors += 1; self.end(fault)", "flood", "ended after a flood"),
    "does not name the right one": (" {fault.text}", "", "did_you_mean", "did you mean"),
}  # fmt: skip


def end_with_overload(connection: Any, fault: Fault) -> None:
    """The fault of an adapter that a peer who asks too much brings down."""
    if fault.code == "overload":
        (running,) = (task for task in asyncio.all_tasks() if "WordsAdapter.run" in repr(task))
        running.cancel()


@pytest.mark.parametrize("fault", FAULTS)
def test_the_suite_sees_a_fault(fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    right, wrong, check, phrase = FAULTS[fault]
    # A flood is over when all of it was taken, and nothing more is for a while, in which this process has been given its turn; of the others
    # the whole time passes before the fault is seen.
    monkeypatch.setattr("uwserver.testing.adapter_kit.SETTLE_S", 30.0 if check == "flood" else 2.0)
    monkeypatch.setattr("uwserver.testing.call_checks._QUIET_S", 2.0)
    assert ADAPTER.count(right) == 1
    words = module("words", ADAPTER.replace(right, wrong), tmp_path)
    words.WordsConnection.end = end_with_overload
    # With the time-out of the page's test a call that is left, or not cancelled, would end all the same.
    config = words.WordsConfig(port=0, call_timeout_s=0.3 if check == "time_out" else 30.0)
    kit = AdapterKit(words.WordsAdapter, config, TcpPeer.connect, b"hear **\n", requests=REQUESTS)
    with pytest.raises(AssertionError, match=phrase):
        asyncio.run(CHECKS[f"check_{check}"](kit))

"""The options that continue a recording in further files; numbers of options are numbers."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from uwserver.cli.options import rotated
from uwserver.recording.parts import ONE_FILE, Rotation

GOT: list[Rotation] = []


@click.command()
@click.option("--record")
@rotated
def command(record: str | None, rotation: Rotation) -> None:
    GOT.append(rotation)


@pytest.mark.parametrize(
    ("args", "rotation"),
    [
        (("--record", "x"), ONE_FILE),
        ((), ONE_FILE),
        (("--record", "x", "--record-rotate-mb", "1.5"), Rotation(1_500_000)),
        (("--record", "x", "--record-rotate-s", "60"), Rotation(0, 60.0)),
    ],
)
def test_a_recording_goes_on_when_it_is_told(args: tuple[str, ...], rotation: Rotation):
    GOT.clear()
    assert CliRunner().invoke(command, args).exit_code == 0
    assert [rotation] == GOT


def test_without_a_recording_there_is_nothing_to_rotate():
    done = CliRunner().invoke(command, ["--record-rotate-s", "60"])
    assert (done.exit_code, "need --record FILE" in done.output) == (2, True)


@pytest.mark.parametrize(("size", "seconds", "due"), [(99, 9.9, False), (100, 0.0, True), (0, 10.0, True)])
def test_whatever_comes_first_ends_a_part(size: int, seconds: float, due: bool):
    assert Rotation(100, 10.0).is_due(size, seconds) == due
    assert not ONE_FILE.is_due(10**12, 1e9)
    assert not ONE_FILE

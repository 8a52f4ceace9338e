"""The files round the code that other programs read: citation, issue forms, development container, compose file."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import click
import pytest
from sources import ROOT

import uwserver
from uwserver.cli import main

COMPOSE = ROOT / "examples/compose/compose.yaml"


def yaml(path: Path) -> Any:
    """What a file of YAML says; rosbags brings the reader."""
    module = pytest.importorskip("ruamel.yaml", reason="pip install 'uwserver[ros]'")
    return module.YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def test_the_citation_is_of_this_version() -> None:
    citation = yaml(ROOT / "CITATION.cff")
    assert str(citation["version"]) == uwserver.__version__
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()


@pytest.mark.parametrize("form", ["accuracy", "bug", "wish"])
def test_an_issue_form_asks_something(form: str) -> None:
    read = yaml(ROOT / f".github/ISSUE_TEMPLATE/{form}.yml")
    assert read["name"]
    assert read["description"]
    ids = [each["id"] for each in read["body"]]
    assert len(ids) == len(set(ids)) > 0


def test_the_development_container_makes_what_there_is() -> None:
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    target = container["postCreateCommand"].removeprefix("make ")
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M)


def test_the_compose_file_starts_a_server_and_its_client() -> None:
    services = yaml(COMPOSE)["services"]
    words = shlex.split(services["server"]["command"])
    command = main.get_command(click.Context(main), words[0])
    assert command is not None
    options, arguments, _ = command.make_parser(click.Context(command)).parse_args(words[1:])
    mounts = dict(each.split(":")[1::-1] for each in services["server"]["volumes"])
    folder, _, name = str(arguments[0] if arguments else options["scenario"]).rpartition("/")
    world = uwserver.load(COMPOSE.parent / mounts[folder] / name)
    program, *_ = services["client"]["command"].split()
    client = {each.split(":")[1]: each.split(":")[0] for each in services["client"]["volumes"]}
    folder, _, name = program.rpartition("/")
    text = (COMPOSE.parent / client[folder] / name).read_text()
    names = re.findall(r"for name in \((.*?)\)", text)[0]
    asked = {f"bluerov2/{name}" for name in [*re.findall(r'"(\w+)"', names), "thrusters"]}
    assert len(asked) == 4
    assert asked <= set(world.ports)

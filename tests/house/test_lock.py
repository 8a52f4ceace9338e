"""requirements.lock, from which the container image is built: it names all that an image of this commit needs, and nothing that is not pinned."""

from __future__ import annotations

import importlib.metadata
import re
import runpy
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from sources import ROOT

TOOL: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "lock.py"))
IMAGE = {
    "python_version": "3.11", "python_full_version": "3.11.9", "sys_platform": "linux", "platform_system": "Linux", "os_name": "posix",
    "platform_machine": "x86_64", "implementation_name": "cpython", "platform_python_implementation": "CPython", "extra": "",
}  # fmt: skip


def locked(machine: str = "x86_64") -> dict[str, Version]:
    """Version by name, of the lines that hold for the image on a machine."""
    versions, environment = {}, {**IMAGE, "platform_machine": machine}
    for entry in (ROOT / "requirements.lock").read_text().replace("\\\n", "").splitlines():
        if entry.strip() and not entry.lstrip().startswith("#"):
            requirement = Requirement(entry.partition("--hash")[0])
            assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), f"{requirement} has no hash: make lock"
            if requirement.marker is None or requirement.marker.evaluate(environment):
                (pin,) = requirement.specifier
                assert pin.operator == "=="
                versions[TOOL["name_of"](requirement.name)] = Version(pin.version)
    return versions


def needed_by(requirement: Requirement) -> list[Requirement]:
    """What the installed distribution of that name wants itself."""
    wanted = [Requirement(line) for line in importlib.metadata.requires(requirement.name) or ()]
    extras = ["", *requirement.extras]
    return [
        each
        for each in wanted
        if each.marker is None or any(each.marker.evaluate({**IMAGE, "extra": x}) for x in extras)
    ]


def test_holds_all_that_the_image_needs_in_versions_that_fit() -> None:
    versions, todo, seen = locked(), [Requirement(line) for line in TOOL["requirements"]()], set[str]()
    assert len(todo) > 15
    while todo:
        requirement = todo.pop()
        if requirement.marker is not None and not requirement.marker.evaluate(IMAGE):
            continue
        name = TOOL["name_of"](requirement.name)
        assert name in versions, f"{requirement} is not in requirements.lock: make lock"
        assert requirement.specifier.contains(versions[name], prereleases=True), f"{requirement}: make lock"
        key = f"{name} {sorted(requirement.extras)}"
        if key not in seen:
            seen.add(key)
            try:
                todo += needed_by(requirement)
            except importlib.metadata.PackageNotFoundError:
                continue  # of an extra that is not installed here; its own line was looked at
    assert len(seen) > 25


def test_leaves_out_on_arm_what_has_no_wheel_there() -> None:
    assert locked().keys() - locked("aarch64").keys() == {*TOOL["ONLY"], "pybullet"}
    assert "coal" in locked("aarch64"), "which takes the place of pybullet"
    assert "coal" not in locked(), "one engine is enough, and it is large"


@pytest.mark.parametrize(("requirement", "name"), [("Msg_Pack[a]>=1", "msg-pack"), ("h5py>=3.8", "h5py")])
def test_names_are_compared_as_the_index_does(requirement: str, name: str) -> None:
    assert TOOL["name_of"](requirement) == name


def test_the_image_is_built_from_it() -> None:
    recipe = (ROOT / "Dockerfile").read_text()
    assert "pip install --require-hashes -r /requirements.lock" in recipe
    installs = re.findall(r"pip install [^&]*", recipe)
    assert all("--require-hashes" in each or "--no-deps --no-build-isolation" in each for each in installs)

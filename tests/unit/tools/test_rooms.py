from __future__ import annotations

from pathlib import Path

import pytest
import rooms


@pytest.mark.parametrize(
    ("path", "tests"),
    [
        ("uwserver/world/faults/timeline.py", ("tests/unit/world/faults/test_timeline.py", "tests/unit/world/faults")),
        ("uwserver/simulation/thread.py", ("tests/unit/simulation/test_thread.py", "tests/unit/simulation")),
        ("uwserver/frames.py", ("tests/unit/test_frames.py",)),
        ("uwserver/__main__.py", ("tests/unit/test_main.py",)),
        ("uwserver/units.py", ()),
        ("uwserver/physics/rays/hits.py", ("tests/unit/physics/rays/test_hits.py", "tests/unit/physics/rays")),
        (
            "uwserver/physics/dynamics/appendage_forces.py",
            ("tests/unit/physics/dynamics/test_appendage_forces.py", "tests/unit/physics/dynamics", "tests/physics"),
        ),
        ("adapters/uwserver_adapters/mavlink/wire/codec.py", ("tests/unit/adapters/mavlink/wire",)),
        ("adapters/uwserver_adapters/__init__.py", ()),
        ("bench/uwserver_bench/against/intervals.py", ("tests/unit/bench/against/test_intervals.py", "tests/unit/bench/against")),
        ("clients/python/uwclient/cli_verbs.py", ("tests/unit/client",)),
        ("clients/web/main.js", ("tests/unit/adapters/web",)),
        ("clients/c/client.c", ()),
        ("scenarios/uwserver_scenarios/vehicles/remus100.toml", ("tests/unit/scenario",)),
        ("tests/unit/tools/test_rooms.py", ("tests/unit/tools/test_rooms.py",)),
        ("tests/unit/test_gone.py", ()),
        ("tests/unit/sensors/conftest.py", ("tests/unit/sensors",)),
        ("tests/physics/data/table.csv", ("tests/physics",)),
        ("docs/scenarios.md", ()),
        ("Makefile", ()),
    ],
)  # fmt: skip
def test_a_file_has_the_tests_of_its_room(path: str, tests: tuple[str, ...]):
    assert rooms.tests_of(path) == tests


def test_contact_has_the_proofs_of_contact_alone():
    found = rooms.tests_of("uwserver/physics/contact/step.py")
    assert found[:2] == ("tests/unit/physics/contact/test_step.py", "tests/unit/physics/contact")
    assert found[2:] == ("tests/physics/test_contact.py", "tests/physics/test_contact_momentum.py")


def test_a_script_or_a_rig_has_the_tests_that_name_it(tmp_path: Path):
    (tmp_path / "tests" / "deep").mkdir(parents=True)
    texts = {
        "tests/deep/test_lock.py": 'TOOL = ROOT / "tools" / "lock.py"',
        "tests/test_import.py": "# tools\nimport lock\nfrom page_rig import page",
        "tests/test_other.py": "from threading import Lock  # tools/locked.py",
    }
    for path, text in texts.items():
        (tmp_path / path).write_text(text)
    assert rooms.tests_of("tools/lock.py", tmp_path) == ("tests/deep/test_lock.py", "tests/test_import.py")
    assert rooms.tests_of("tests/page_rig.py", tmp_path) == ("tests/test_import.py",)
    assert rooms.tests_of("tools/no_such_script.py", tmp_path) == ()

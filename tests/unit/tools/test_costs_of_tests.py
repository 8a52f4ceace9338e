from __future__ import annotations

from pathlib import Path

import costs_of_tests as tool
import pytest

RESULTS = """<testsuites><testsuite>
<testcase classname="tests.unit.world.test_x" name="test_all_go_on[a]" time="2.0"><properties>
<property name="processor_s" value="1.5"/></properties></testcase>
<testcase classname="tests.unit.world.test_x" name="test_all_go_on[b]" time="2.0"><properties>
<property name="processor_s" value="2.0"/></properties></testcase>
<testcase classname="tests.physics.test_y" name="test_it_falls" time="9.0"><properties>
<property name="processor_s" value="2.25"/></properties></testcase>
<testcase classname="tests.test_z" name="test_skipped" time="0.0"/>
</testsuite></testsuites>"""
SOURCE = '''def test_it_falls():
    """Weight less buoyancy: over
    the mass. More words."""
'''


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "results.xml").write_text(RESULTS)
    (tmp_path / "tests" / "physics").mkdir(parents=True)
    (tmp_path / "tests" / "physics" / "test_y.py").write_text(SOURCE)
    return tmp_path


def test_cases_are_added_and_the_dearest_comes_first(root: Path) -> None:
    first, second, _ = tool.costs(root / "results.xml")
    assert first == tool.Cost("tests/unit/world/test_x.py", "test_all_go_on", 2, 4.0, 3.5)
    assert (second.name, second.cpu_s) == ("test_it_falls", 2.25)


def test_what_a_test_proves_is_the_first_sentence_of_its_docstring_or_its_name(root: Path) -> None:
    first, second, _ = tool.costs(root / "results.xml")
    assert tool.proves(first, root) == "all go on"
    assert tool.proves(second, root) == "Weight less buoyancy"


def test_tables_stand_between_their_marks(root: Path) -> None:
    tables = tool.markdown([{"part": "lint", "wall_s": 2.6, "cpu_s": 3.4}], tool.costs(root / "results.xml"), root)
    assert "| `lint` | 3 | 3 |" in tables
    assert "| tests/unit/world | 2 | 4 |" in tables
    assert "tests/test_z" not in tables.partition("what it proves")[0]  # it took nothing
    document = f"before\n{tool.BEGIN}old\n{tool.END}after\n"
    assert tool.with_tables(document, tables) == f"before\n{tool.BEGIN}{tables}{tool.END}after\n"
    with pytest.raises(SystemExit, match="marks"):
        tool.with_tables("without", tables)

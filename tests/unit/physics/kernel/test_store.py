"""Files of kernels: what is sound and safe is read, all else is as none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from uwserver.physics.kernel import store

BODY = b"a pickle"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "kernels-0123"
    made.mkdir(mode=0o700)
    store.write(made, "a.kernel", BODY)
    return made


def test_what_was_written_is_read_and_nobody_else_may(folder: Path) -> None:
    assert store.fault_of(folder) == ""
    assert store.read(folder, "a.kernel") == BODY
    assert store.read(folder, "b.kernel") is None
    assert [path.name for path in folder.iterdir()] == ["a.kernel"]
    assert (folder / "a.kernel").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("keep", [0, 1, 12, 20, 44, 45, -1])
def test_a_file_that_is_cut_off_is_as_none(folder: Path, keep: int) -> None:
    path = folder / "a.kernel"
    path.write_bytes(path.read_bytes()[:keep])
    assert store.read(folder, "a.kernel") is None


@pytest.mark.parametrize("place", [0, 13, 14, 45, -1])
def test_a_damaged_file_is_as_none(folder: Path, place: int) -> None:
    path = folder / "a.kernel"
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    assert store.read(folder, "a.kernel") is None


def test_a_file_of_another_folder_is_as_none(folder: Path) -> None:
    other = folder.rename(folder.with_name("kernels-4567"))
    assert store.read(other, "a.kernel") is None


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_can_write_is_not_read(folder: Path, mode: int) -> None:
    (folder / "a.kernel").chmod(mode)
    assert store.read(folder, "a.kernel") is None
    assert store.read(folder, "a.kernel", packaged=True) == BODY


def test_a_link_to_a_file_is_not_read(folder: Path) -> None:
    (folder / "b.kernel").symlink_to(folder / "a.kernel")
    assert store.read(folder, "b.kernel") is None


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_a_folder_that_others_can_write_is_a_fault(folder: Path, mode: int) -> None:
    folder.chmod(mode)
    assert "chmod 700" in store.fault_of(folder)


def test_a_link_to_a_folder_is_a_fault(folder: Path) -> None:
    link = folder.with_name("link")
    link.symlink_to(folder)
    assert "link" in store.fault_of(link)


def test_what_somebody_else_owns_is_not_read_and_what_root_owns_is(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    owned_by_root = user == 0
    assert (store.fault_of(folder) == "") is owned_by_root
    assert (store.read(folder, "a.kernel") == BODY) is owned_by_root
    if owned_by_root:
        os.chown(folder, 4321, -1)
        os.chown(folder / "a.kernel", 4321, -1)
        assert "somebody else" in store.fault_of(folder)
        assert store.read(folder, "a.kernel") is None


def test_a_folder_that_is_gone_keeps_nothing(tmp_path: Path) -> None:
    store.write(tmp_path / "gone", "a.kernel", BODY)
    assert not list(tmp_path.iterdir())

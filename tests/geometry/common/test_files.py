"""Files are written whole or not at all."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from geometry.common.errors import InputError
from geometry.common.files import check_writable, check_writable_file, write_text, write_together, write_whole


def test_replaces_the_old_file_only_when_the_new_one_is_whole(tmp_path: Path) -> None:
    path = write_text(tmp_path / "folder" / "a.txt", "old")

    def interrupted() -> None:
        with write_whole(path) as draft:
            draft.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new"
    assert [entry.name for entry in path.parent.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_is_written_once_stays_that_of_the_first(
    links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsupported(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    if not links:
        monkeypatch.setattr("os.link", unsupported)
    path = tmp_path / "a.txt"
    with write_whole(path, once=True) as slow:
        slow.write_text("second")
        with write_whole(path, once=True) as quick:
            quick.write_text("first")
        assert path.read_text() == "first"
    assert path.read_text() == "first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("name", ["file", "file/folder", "file/folder/deeper"])
def test_a_file_in_a_folder_s_place_is_named_with_the_remedy(name: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match=f"/{name}'.*: allowed: .*/file is a file; give another folder, or move it away$"):
        check_writable(tmp_path / name)
    assert (tmp_path / "file").read_text() == "in the way"


@pytest.mark.parametrize(
    ("name", "reason"), [("link", "link is a link to nothing"), ("n" * 300, "File name too long"), ("/proc/new", "/proc")]
)
def test_other_folders_that_cannot_be_are_refused(name: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nothing" / "there")
    with pytest.raises(InputError, match=rf"^there = .*: allowed: a folder that files can be written to: .*{reason}"):
        check_writable(tmp_path / name, "there")


def test_a_folder_without_the_right_to_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the system refuses it; root, as whom tests may run, has every right."""

    def denied(dir: Path) -> None:
        raise PermissionError(13, "Permission denied", str(dir))

    monkeypatch.setattr("tempfile.TemporaryFile", denied)
    with pytest.raises(InputError, match=r"Permission denied in .*; give another folder, or the right to write there$"):
        check_writable(tmp_path)


def test_a_full_disk_is_no_fault_of_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(dir: Path) -> None:
        raise OSError(28, "No space left on device", str(dir))

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    with pytest.raises(OSError, match="No space left"):
        check_writable(tmp_path)


def test_a_folder_in_a_file_s_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^plot = .*: allowed: the name of a file: this is a folder$"):
        check_writable_file(tmp_path, "plot")
    check_writable_file(tmp_path / "new" / "a.png", "plot")
    assert not (tmp_path / "new").exists()  # who looks leaves nothing


def test_work_that_fails_leaves_no_empty_folders(tmp_path: Path) -> None:
    def interrupted() -> None:
        with write_whole(tmp_path / "there" / "new" / "newer" / "a.txt"):
            raise KeyboardInterrupt

    (tmp_path / "there").mkdir()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_files_that_belong_together_are_all_new_or_all_old(tmp_path: Path) -> None:
    names = ["record", "one", "two"]

    def write(text: str, last: str) -> None:
        with write_together(tmp_path, names) as new:
            for name in ("one", "two"):
                (new / name).write_text(text)
            assert not last or (new / "record").write_text(last)

    write("first", "first")
    for missing in range(3):
        with pytest.raises(FileNotFoundError):
            write(f"other {missing}", "")
        assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(names, "first")
    write("second", "second")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(names, "second")


def test_a_folder_in_the_place_of_one_of_them_changes_none(tmp_path: Path) -> None:
    (tmp_path / "two").mkdir()

    def write() -> None:
        with write_together(tmp_path, ["one", "two"]) as new:
            for name in ("one", "two"):
                (new / name).write_text("new")

    with pytest.raises(IsADirectoryError, match="two"):
        write()
    assert [path.name for path in tmp_path.iterdir()] == ["two"]


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX systems")
def test_a_signal_between_two_moves_comes_after_the_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = os.replace

    def interrupted(source: Path, place: Path) -> None:
        moved(source, place)
        signal.raise_signal(signal.SIGINT)

    def write() -> None:
        with write_together(tmp_path, ["one", "two"]) as new:
            for name in ("one", "two"):
                (new / name).write_text("new")

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "two"]

"""Files are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry.common.files import check_writable, write_text, written_whole


def test_replaces_the_old_file_only_when_the_new_one_is_whole(tmp_path: Path) -> None:
    path = write_text(tmp_path / "folder" / "a.txt", "old")

    def interrupted() -> None:
        with written_whole(path) as draft:
            draft.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new"
    assert [entry.name for entry in path.parent.iterdir()] == ["a.txt"]


def test_unwritable_folder_is_an_os_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="file"):
        check_writable(tmp_path / "file" / "folder")

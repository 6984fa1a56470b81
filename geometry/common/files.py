"""Write files whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from geometry.common.errors import InputError
from geometry.common.interrupts import defer_signals

# what another name for the output helps against; a full disk is no fault of the name
_NAME_ERRORS = {errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS,
                errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL}  # fmt: skip


@contextmanager
def write_whole(path: Path, once: bool = False) -> Iterator[Path]:
    """Yield a temporary file name next to ``path`` that replaces it, flushed to disk, if the block succeeds.

    Parameters
    ----------
    path
        Of the file.
    once
        Whether a file that is there by then stays, whoever wrote it; of several processes the first one wins.

    Examples
    --------
    >>> with write_whole(Path("table.txt")) as draft:  # doctest: +SKIP
    ...     draft.write_text("whole")
    """
    with write_together(path.parent, [path.name], once) as folder:
        yield folder / path.name  # keeps the suffix, from which some writers choose the format


@contextmanager
def write_together(folder: Path, names: Sequence[str], once: bool = False) -> Iterator[Path]:
    """Yield a temporary folder; if the block succeeds, its files of these names move to ``folder``, all or none.

    They are flushed to disk before, and a signal that ends the program waits until they are moved. A kill in between, which
    nothing can put off, leaves the first ones new and the last ones old. With ``once`` files that are there by then stay.

    Raises
    ------
    OSError
        A file cannot be written, is missing, or a folder is in its place.
    """
    with _make_folder(folder):
        drafts = Path(tempfile.mkdtemp(prefix=f".{names[0][:50]}.", dir=folder))
        yield from _move_together(drafts, folder, names, once)


@contextmanager
def _make_folder(folder: Path) -> Iterator[None]:
    """Make a folder, with those above it, for the block; if the block fails, remove those of them that are empty."""
    new = [new_folder for new_folder in (folder, *folder.parents) if not os.path.lexists(new_folder)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        with defer_signals(), suppress(OSError):  # the first that is not empty ends it
            for new_folder in new:
                new_folder.rmdir()
        raise


def _move_together(drafts: Path, folder: Path, names: Sequence[str], once: bool) -> Iterator[Path]:
    """Yield the folder of drafts, and move the drafts to their places afterwards; remove what is left."""
    try:
        yield drafts
        for name in names:
            flush_to_disk(drafts / name)
            if os.path.isdir(folder / name):
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(folder / name))
        with defer_signals():
            for name in names:
                (_place_once if once else os.replace)(drafts / name, folder / name)
            flush_to_disk(folder)
    finally:
        with defer_signals():
            shutil.rmtree(drafts)


def _place_once(draft: Path, path: Path) -> None:
    """Give a finished draft its final name, ``path``, unless there is a file of that name already."""
    with suppress(FileExistsError):
        try:
            os.link(draft, path)
        except FileExistsError:
            raise
        except OSError:  # a file system without links, where who reads meanwhile may see half a file
            with path.open("xb") as file:
                file.write(draft.read_bytes())
            flush_to_disk(path)


def check_writable(folder: Path, key: str = "output") -> None:
    """Check that files can be written into ``folder``, without making it; ``key`` names it in messages.

    Raises
    ------
    InputError
        It cannot be a folder to write to: a file is in the way, the user has no right to, or the like.
    OSError
        It could be, but for a full disk or another failure.
    """
    try:
        with tempfile.TemporaryFile(dir=_find_existing_folder(folder)):
            pass
    except OSError as fault:
        if fault.errno not in _NAME_ERRORS:
            raise
        raise InputError(
            key, str(folder), f"a folder that files can be written to: {_describe_obstacle(folder, fault)}"
        ) from None


def _find_existing_folder(folder: Path) -> Path:
    """Return ``folder``, or the nearest existing one above it. Raises ``OSError`` if the path there is no folder."""
    for place in (folder, *folder.parents):
        with suppress(FileNotFoundError):
            os.lstat(place)
            break
    os.scandir(place).close()  # a file, or a link to nothing, holds no folders
    return place


def check_writable_file(path: Path, key: str = "output") -> None:
    """Check that a file of that name can be written; see ``check_writable``."""
    if os.path.isdir(path):
        raise InputError(key, str(path), "the name of a file: this is a folder")
    check_writable(path.parent, key)
    try:
        os.lstat(path)
    except FileNotFoundError:
        return
    except OSError as fault:  # too long a name, say
        raise InputError(key, str(path), f"the name of a file that can be written: {fault.strerror}") from None


def _describe_obstacle(folder: Path, fault: OSError) -> str:
    """Return what prevents writing, and the remedy."""
    for place in (folder, *folder.parents):
        if os.path.lexists(place):
            break
    if os.path.isdir(place):
        return f"{fault.strerror} in {place}; give another folder, or the right to write there"
    return f"{place} is {'a file' if os.path.exists(place) else 'a link to nothing'}; give another folder, or move it away"


def write_text(path: Path, text: str) -> Path:
    """Write UTF-8 text whole; returns ``path``."""
    with write_whole(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path


def flush_to_disk(path: Path) -> None:
    """Flush a file, or a folder with the names in it, to the disk, so that it survives a power loss."""
    if path.is_dir() and os.name == "nt":  # Windows opens no folders
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

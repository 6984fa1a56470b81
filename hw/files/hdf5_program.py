"""Read an HDF5 file for `hdf5_file` in a child process: a crash of the HDF5 library ends only this process.

Run as ``python hdf5_program.py FILE MEMORY SECONDS``. It inspects links and creation properties before it reads any data, and
refuses files with data elsewhere: external links, external storage, virtual datasets. It writes pickles to standard output: the
description of the file, and then the columns of each list of columns that it is sent; a text is the reason of a refusal.
"""

from __future__ import annotations

import math
import os
import pickle
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray


STORED_ELSEWHERE = "is not stored in this file: allowed: datasets within it (h5copy or h5repack writes such a file)"
MAX_DATASETS = 1000  # a file with more datasets is not a recording


class Refused(Exception):  # noqa: N818 - becomes the text of an InvalidSource in the parent
    """The file is refused; the text states the reason."""


def main(path: str, memory: int, seconds: int) -> None:
    """Describe the file, then serve requests until standard input ends; limits in bytes and s."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # keeps prints of libraries out of the replies
    limit_process(memory, seconds)
    for reply in iterate_replies(path, memory):
        pickle.dump(reply, replies)
        replies.flush()


def iterate_replies(path: str, memory: int) -> Iterator[object]:
    """Yield the description of the file, and then the columns of each request; at a fault, yield the reason as a text, then end.

    ``memory`` is the limit in bytes, for messages and for the size of chunks.
    """
    try:
        import h5py

        try:
            file = h5py.File(path, "r")
        except (OSError, RuntimeError, ValueError):
            raise Refused("is no HDF5 file that can be read: is it whole, is it HDF5?") from None
        check_links(file)
        yield describe(file, memory)
        while True:
            yield [read_column(file, *column) for column in pickle.load(sys.stdin.buffer)]
    except EOFError:  # no more requests
        return
    except Refused as refusal:
        yield str(refusal)
    except MemoryError:
        yield f"needs more than the {memory / 1e9:g} GB allowed to read it: --memory raises the limit"
    except Exception:  # a damaged file makes the library raise anything
        yield "is damaged: parts of it are missing or cannot be read"


def limit_process(memory: int, seconds: int) -> None:
    """Limit this process's memory (bytes) and processor time (s), and forbid it to write files and core dumps.

    Limits that the operating system does not have are left out: Linux has all of them, macOS some, Windows none.
    """
    with suppress(ImportError):
        import resource

        limits = {"RLIMIT_DATA": memory, "RLIMIT_CPU": seconds, "RLIMIT_FSIZE": 0, "RLIMIT_CORE": 0}
        for name, value in limits.items():
            with suppress(AttributeError, OSError, ValueError):
                resource.setrlimit(getattr(resource, name), (value, value))


def check_links(file: h5py.File) -> None:
    """Refuse a file that refers to data outside itself. Later steps follow only hard and soft links."""
    import h5py

    def find_elsewhere(name: str, link: object) -> str | None:  # a return value other than None ends the visit
        """Return the reason of a refusal if a link or its dataset has data outside the file, else None."""
        if isinstance(link, h5py.ExternalLink):
            return f"is refused: {name!r} {STORED_ELSEWHERE}"
        node = file[name] if isinstance(link, h5py.HardLink) else None
        if isinstance(node, h5py.Dataset) and (node.is_virtual or node.external):
            return f"is refused: the data of {name!r} {STORED_ELSEWHERE}"
        return None

    if reason := file.visititems_links(find_elsewhere):
        raise Refused(reason)


def describe(file: h5py.File, memory: int) -> dict[str, object]:
    """Return the file's attributes, and descriptions of its numeric datasets of one or two dimensions, without their data."""
    datasets: list[dict[str, object]] = []

    def add_dataset(path: str, node: h5py.Group | h5py.Dataset) -> str | None:  # a return value other than None ends the visit
        """Add the description of a numeric dataset; return the reason of a refusal if there is one."""
        if not getattr(node, "shape", None) or len(node.shape) > 2 or node.dtype.kind not in "iuf":
            return None
        chunk = math.prod(node.chunks or (0,)) * node.dtype.itemsize
        if 2 * chunk > memory:  # HDF5 holds a whole chunk, compressed and uncompressed, for any of its values
            return f"is refused: {path!r} is stored in chunks of {chunk / 1e9:.3g} GB: --memory raises the limit"
        units = [decode_text(node.attrs[key]) for key in ("units", "unit", "Units", "Unit") if key in node.attrs]
        datasets.append(
            {
                "path": path,
                "shape": node.shape,
                "unit": units[0] if units else "",
                "is_written": node.id.get_storage_size() > 0,
            }
        )
        if len(datasets) > MAX_DATASETS:
            return f"is refused: more than {MAX_DATASETS} datasets of numbers: allowed: the recording's columns alone"
        return None

    if reason := file.visititems(add_dataset):
        raise Refused(reason)
    attributes = {key: value for key in file.attrs if (value := convert_attribute(file.attrs[key])) is not None}
    return {"attributes": attributes, "datasets": datasets}


def read_column(file: h5py.File, path: str, column: int | None) -> NDArray[np.generic]:
    """Return a dataset, or one column of a matrix if ``column`` is not None.

    Floats are returned as doubles, and so are unsigned 64-bit integers, which may exceed the range of signed ones.
    """
    check_filters(path, file[path])
    values: NDArray[np.generic] = file[path][:] if column is None else file[path][:, column]
    if values.dtype.kind != "f" and values.dtype != np.uint64:
        return values
    with np.errstate(over="ignore"):  # long doubles beyond the range of doubles become infinite; the reader refuses them
        return values.astype(float, copy=False)


def check_filters(path: str, dataset: h5py.Dataset) -> None:
    """Refuse a dataset that is compressed by a filter which this HDF5 library does not have."""
    from h5py import h5z

    properties = dataset.id.get_create_plist()
    for number, _, _, name in (properties.get_filter(k) for k in range(properties.get_nfilters())):
        if not h5z.filter_avail(number):
            filter_name = f"{number} ({decode_text(name)})" if name else str(number)
            allowed = "gzip, szip, lzf, shuffle, fletcher32 (h5repack -f GZIP=4 writes such a file)"
            raise Refused(f"is refused: {path!r} is packed by filter {filter_name}, which is not installed: allowed: {allowed}")


def convert_attribute(value: object) -> object:
    """Convert an attribute to a text, a number, or the first number of an array; None for anything else."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, bytes | str):
        return decode_text(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, np.ndarray) and value.size and value.dtype.kind in "iuf":
        return convert_attribute(value.reshape(-1)[0])
    return value if isinstance(value, int | float) else None


def decode_text(value: object) -> str:
    """Decode a text, with invalid UTF-8 replaced."""
    decoded = value if isinstance(value, bytes) else str(value).encode("utf-8", "replace")
    return decoded.decode("utf-8", "replace")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))

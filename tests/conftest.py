"""What all tests share: seeded examples, threads and a cache of their own, one sweep to compare others with."""

import gc
import os
import signal
from collections.abc import Iterator
from itertools import compress
from pathlib import Path

import pytest
from hypothesis import settings

# A test that fails for one fails for all: Hypothesis draws the same examples every time.
settings.register_profile("seeded", derandomize=True, deadline=None, database=None)
settings.load_profile("seeded")
LONG_SECONDS = 600  # of a limit; that of all tests is 300
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def pytest_configure(config: pytest.Config) -> None:
    """Before workers start: one thread for each worker's linear algebra, and Ctrl-C as a terminal's programs know it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's way with what it runs in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.update(dict.fromkeys(THREADS, "1"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run first what has minutes as its limit of time: what one worker starts last, the other waits for."""
    limits = [item.get_closest_marker("timeout") for item in items]
    is_long = [limit is not None and limit.args[0] >= LONG_SECONDS for limit in limits]
    items[:] = [*compress(items, is_long), *compress(items, (not long for long in is_long))]


def pytest_collection_finish() -> None:
    """Leave modules and tests, which stay to the end, out of the searches for garbage, and search less often."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def mesh_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """One for all workers and nobody else's; pytest removes it with its other folders, however a session ended."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    os.environ["PROBE_DESIGN_CACHE"] = str(shared / "meshes")


@pytest.fixture(scope="session")
def working_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of the worker: making one for each test among those of all others takes longer than many a test."""
    return tmp_path_factory.mktemp("working-directory")


@pytest.fixture(autouse=True)
def empty_working_directory(working_directory: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run each test in an empty folder, and fail one that leaves a file there: results must not depend on where tests start."""
    monkeypatch.chdir(working_directory)
    yield
    left = [path.rename(path.parent.parent / f"left-by-a-test-{path.stat().st_ino}") for path in working_directory.iterdir()]
    assert not left, "a test left files in the working directory"


@pytest.fixture(autouse=True)
def unhurried() -> Iterator[None]:
    """Time for every result, however busy the machine is."""
    from geometry.common.resources import Limits, use_limits

    with use_limits(Limits(seconds=3600.0)):
        yield


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted sweep of 300 designs on one worker."""
    from probe_design import sweep
    from tests.support.sweeps import toml

    folder = tmp_path_factory.mktemp("whole")
    sweep(toml(folder), folder / "out", workers=1)
    return folder / "out"

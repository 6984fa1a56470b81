"""What all tests share: seeded examples, a cache and threads of their own, one sweep to compare others with."""

import os
import shutil
import signal
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# A test that fails for one fails for all: Hypothesis draws the same examples every time.
settings.register_profile("seeded", derandomize=True, deadline=None, database=None)
settings.load_profile("seeded")
CACHE = pytest.StashKey[str]()
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def pytest_configure(config: pytest.Config) -> None:
    """Before workers start: a mesh cache that is nobody's, and one thread for each worker's linear algebra."""
    if (
        signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    ):  # a shell's way with what it runs in the background, programs' under test too
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config, "workerinput"):
        return  # a worker inherits both
    os.environ.update(dict.fromkeys(THREADS, "1"))
    os.environ["PROBE_DESIGN_CACHE"] = config.stash[CACHE] = tempfile.mkdtemp(prefix="probe-design-tests-")


def pytest_unconfigure(config: pytest.Config) -> None:
    if CACHE in config.stash:
        shutil.rmtree(config.stash[CACHE], ignore_errors=True)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted sweep of 300 designs on one worker."""
    from probe_design import sweep
    from tests.support.sweeps import toml

    folder = tmp_path_factory.mktemp("whole")
    sweep(toml(folder), folder / "out", workers=1)
    return folder / "out"

"""Hypothesis draws the same examples every time: a test that fails for one fails for all. One sweep to compare others with."""

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("seeded", derandomize=True, deadline=None, database=None)
settings.load_profile("seeded")


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted sweep of 300 designs on one worker."""
    from probe_design import sweep
    from tests.support.sweeps import toml

    folder = tmp_path_factory.mktemp("whole")
    sweep(toml(folder), folder / "out", workers=1)
    return folder / "out"

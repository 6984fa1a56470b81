"""One package for all tests of this folder: the paper's probe with round edges and a flange."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry.workshop.package import build_writers
from tests.support.workshop import BUDGET, EDGE, probe


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("package")
    for name, write in build_writers(probe(), EDGE, BUDGET).items():
        write(folder / name)
    return folder

"""What comes out of sweeps: tables, files, effects, the command line."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from geometry.common.errors import MissingLibrary
from probe_design import sweep
from probe_design.sweeps.results import dataframe, dataset, escape_formula, write_csv, write_parquet
from probe_design.sweeps.summary_page import compute_main_effect
from tests.support.paths import SCENE
from tests.support.sweeps import grid, run


class TestResults:
    def test_frame_and_dataset_agree_and_have_units(self, tmp_path: Path) -> None:
        sweep(grid(3, 2) | {"constraints": ["probe.gap < '0.19 mm' or inclusion.depth < '10 mm'"]}, tmp_path, workers=1)
        frame, cube = dataframe(tmp_path), dataset(tmp_path)
        assert cube["ratio"].dims == ("probe.gap", "inclusion.depth")
        assert cube["probe.gap"].attrs == {"units": "m"}
        assert cube["stress_inner"].attrs == {"units": "Pa"}
        assert bool(cube["ratio"].isnull().sel({"probe.gap": 2e-4, "inclusion.depth": 0.012}))  # left out by the constraint
        assert len(frame) == 5
        for _, row in frame.iterrows():
            variables = {"probe.gap": row["probe.gap"], "inclusion.depth": row["inclusion.depth"]}
            assert float(cube["ratio"].sel(variables)) == row["ratio"]

    def test_files_read_back_the_same(self, whole: Path, tmp_path: Path) -> None:
        import pandas as pd

        frame = dataframe(whole)
        pd.testing.assert_frame_equal(pd.read_parquet(write_parquet(whole, tmp_path / "a.parquet")), frame)
        with write_csv(whole, tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
            table = list(csv.DictReader(file))
        assert [float(row["probe.gap, m"]) for row in table] == frame["probe.gap"].tolist()
        assert [float(row["ratio"] or "nan") for row in table] == pytest.approx(
            frame["ratio"].tolist(), rel=0, abs=0, nan_ok=True
        )
        assert dataset(whole)["ratio"].dims == ("design",)

    def test_no_text_is_a_spreadsheet_s_formula(self) -> None:
        """The signs that OWASP's page on CSV injection names."""
        for sign in ("=", "+", "-", "@", "\t", "\r"):
            assert escape_formula(f"{sign}cmd|' /C calc'!A0") == f"'{sign}cmd|' /C calc'!A0"
        assert [escape_formula(cell) for cell in ("ok", "a=b", -1.5, None, True, "")] == ["ok", "a=b", -1.5, None, True, ""]

    def test_a_value_in_a_table_is_no_formula(self, tmp_path: Path) -> None:
        swept = grid(2, 1) | {"scene": SCENE}
        swept["variables"] = {"contact.interface": ["=1+1", "bonded"]}
        sweep(swept, tmp_path / "out", workers=1)
        with write_csv(tmp_path / "out", tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
            assert [row["contact.interface"] for row in csv.DictReader(file)] == ["'=1+1", "bonded"]

    def test_a_missing_library_is_one_line(self, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(MissingLibrary, match=r"pip install '\.\[sweep\]'"):
            dataframe(whole)

    def test_main_effect_is_the_variance_of_the_means(self) -> None:
        x, noise = np.tile([0.0, 1.0], 50), np.repeat([-1.0, 1.0], 50)
        assert compute_main_effect(list(x), 2 * x + noise) == pytest.approx(0.5)  # variances 1 and 1
        assert compute_main_effect(list(range(4)), np.array([1.0, 2.0, 3.0, 4.0])) is None


@pytest.mark.slow
def test_command_line(tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(
        f'scene = {json.dumps(str(SCENE))}\nevaluator = "closed-form"\n[sample]\n'
        'kind = "saltelli"\nn = 8\n[variables."probe.gap"]\n'
        'from = "0.05 mm"\nto = "0.2 mm"\n[variables."inclusion.depth"]\nfrom = "6 mm"\nto = "12 mm"\n'
    )
    ended = run(path, "-o", tmp_path / "out", "--json")
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    assert (output["designs"], output["ok"], output["refused"], output["failed"], output["answered"]) == (32, 32, 0, 0, 32)
    assert {Path(file).name for file in output["files"]} == {"results.csv", "results.parquet", "summary.html"}
    assert "32 of 32 done" in ended.stderr
    assert "32 of 32 done" in (tmp_path / "out" / "sweep.log").read_text()
    page = (tmp_path / "out" / "summary.html").read_text()
    assert "Sobol indices, 95 % intervals" in page
    assert "image/png" in page

"""Sweeps of films and bonds: rows have the charges, and the page shows what the designs read."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry import read_scene
from geometry.scenes.film import Film
from probe_design import sweep
from probe_design.sweeps.results import dataset, iterate_rows
from probe_design.sweeps.summary_page import write_page
from solver import evaluate
from tests.support.paths import SCENE

BOND = "probe.film.bond_to_base.name"


@pytest.mark.parametrize("observable", ["charge", "stress"])
def test_rows_and_page_have_what_is_read(tmp_path: Path, observable: str) -> None:
    taped = Film.model_validate({"bond_to_base": "tape-50um"})
    scene = read_scene(SCENE)
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": taped})})
    scene = scene.replace({"reading.observable": observable})
    names = ["tape-25um", "epoxy-20um"]
    specification = {"scene": scene, "evaluator": "axisymmetric", "variables": {BOND: {"values": names}}}
    assert sweep(specification, tmp_path, workers=1).ok == 2
    rows = list(iterate_rows(tmp_path))
    for row, name in zip(rows, names, strict=True):
        film = Film.model_validate({"bond_to_base": name})
        alone = evaluate(scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": film})}), "axisymmetric")
        assert row["observable"] == observable
        for key in ("charge_inner", "charge_per_force_outer", "charge_ratio", "charge_log_sensitivity", "charge_ratio_error"):
            assert row[key] == pytest.approx(getattr(alone, key), rel=1e-9)
    assert rows[0]["charge_ratio"] > 1.3 * rows[1]["charge_ratio"]  # tape against glue
    assert dataset(tmp_path)["charge_per_force_inner"].attrs["units"] == "C/N"
    page = write_page(tmp_path, tmp_path / "page.html").read_text(encoding="utf-8")
    assert ("<h2>charge_ratio" in page) == (observable == "charge")
    assert ("<h2>ratio" in page) == (observable == "stress")

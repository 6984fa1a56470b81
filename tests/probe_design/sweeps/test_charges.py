"""Sweeps of films and bonds: rows have the charges, and the page shows what the designs read."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from geometry import read_scene
from geometry.scenes.film import Film
from probe_design import sweep
from probe_design.reporting.page import Picture
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
    assert ("<h2>charge ratio" in page) == (observable == "charge")
    assert ("<h2>ratio" in page) == (observable == "stress")


@pytest.mark.slow
def test_pictures_of_a_sweep_have_units_of_people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Moduli in kPa and charges in pC/N, with the numbers of the rows."""
    figures = list[Figure]()
    keep = Picture.from_figure

    def from_figure(figure: Figure, alt: str) -> Picture:
        figures.append(figure)
        return keep(figure, alt)

    monkeypatch.setattr(Picture, "from_figure", from_figure)
    scene = read_scene(SCENE)
    taped = Film.model_validate({"bond_to_base": "tape-50um"})
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": taped})})
    values = ["60 kPa", "80 kPa"]
    specification = {"scene": scene, "evaluator": "axisymmetric", "variables": {"probe.outer.youngs_modulus": {"values": values}}}
    assert sweep(specification, tmp_path, workers=1).ok == 2
    write_page(tmp_path, tmp_path / "page.html")
    axes = next(figure.axes[0] for figure in figures if figure.axes[0].get_ylabel() == "charge per force inner, pC/N")
    assert axes.get_xlabel() == "probe.outer.youngs_modulus, kPa"
    x, y = axes.lines[0].get_data()
    assert list(x) == [60.0, 80.0]
    assert list(y) == pytest.approx([1e12 * row["charge_per_force_inner"] for row in iterate_rows(tmp_path)])

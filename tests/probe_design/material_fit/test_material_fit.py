"""Laws fitted to curves: known laws come back, real curves give the published moduli, and what is no curve is refused."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import curve_fit

from geometry.common.errors import InputError
from geometry.scenes.scene_file import scene_from_dict
from probe_design import fit_material
from tests.support.paths import EXAMPLES
from tests.support.program import refused, run

C1, C2, C3 = 1000.0, 400.0, 60.0  # Pa
CURVES = EXAMPLES / "curves"


def slope(x: np.ndarray) -> np.ndarray:
    """dW/dI1 of Yeoh's law (Yeoh 1993)."""
    return np.asarray(C1 + 2 * C2 * x + 3 * C3 * x**2)


# nominal stresses of incompressible bodies, as Yeoh's paper and textbooks have them
NOMINAL: dict[str, tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]] = {
    "tension": (np.linspace(1.05, 1.9, 30), lambda s: 2 * (s - s**-2) * slope(s**2 + 2 / s - 3)),
    "compression": (np.linspace(0.98, 0.5, 30), lambda s: 2 * (s - s**-2) * slope(s**2 + 2 / s - 3)),
    "uniaxial": (np.linspace(0.6, 1.6, 30), lambda s: 2 * (s - s**-2) * slope(s**2 + 2 / s - 3)),
    "equibiaxial": (np.linspace(1.05, 1.5, 30), lambda s: 2 * (s - s**-5) * slope(2 * s**2 + s**-4 - 3)),
    "shear": (np.linspace(0.05, 1.2, 30), lambda k: 2 * k * slope(k**2)),
}


def write(folder: Path, text: str) -> Path:
    path = folder / "curve.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("test", NOMINAL)
@pytest.mark.parametrize("kind", ["nominal", "true"])
def test_a_known_law_comes_back_from_each_test(test: str, kind: str) -> None:
    s, stress = NOMINAL[test]
    values = stress(s) * (s if kind == "true" and test != "shear" else 1.0)
    fit = fit_material(np.column_stack([s, values]), test=test, stress=kind, poisson_ratio=0.49)
    np.testing.assert_allclose(fit.chosen.values, [C1, C2, C3], rtol=1e-6)
    assert fit.youngs_modulus == pytest.approx(2 * 1.49 * 2 * C1, rel=1e-6)
    x = {"equibiaxial": 2 * s**2 + s**-4 - 3, "shear": s**2}.get(test, s**2 + 2 / s - 3).max()
    assert (1 + fit.law_strain) ** 2 + 2 / (1 + fit.law_strain) - 3 == pytest.approx(x, rel=1e-4)


def test_constants_are_those_of_another_least_squares_program() -> None:
    strain, stress = np.loadtxt(CURVES / "dragon-skin-30.csv", delimiter=",", skiprows=1).T

    def predict(s: np.ndarray, c1: float, c2: float, c3: float) -> np.ndarray:
        x = s**2 + 2 / s - 3
        return np.asarray(2 * (s - s**-2) * (c1 + 2 * c2 * x + 3 * c3 * x**2))

    expected, _ = curve_fit(predict, 1 + strain, 1e6 * stress, p0=(1e5, 1e4, 1e3))
    fit = fit_material(CURVES / "dragon-skin-30.csv", test="tension")
    np.testing.assert_allclose(fit.laws[2].values, expected, rtol=1e-5)


def test_errors_of_constants_are_the_scatter_of_noisy_curves() -> None:
    s, stress = NOMINAL["tension"]
    rng = np.random.default_rng(4)
    curves = [np.column_stack([s, stress(s) + 40 * rng.standard_normal(30)]) for _ in range(150)]
    fits = [fit_material(curve, test="tension", stress="nominal", law="yeoh") for curve in curves]
    values = np.array([fit.laws[2].values for fit in fits])
    reported = np.mean([np.sqrt(np.diag(fit.laws[2].covariance)) for fit in fits], axis=0)
    np.testing.assert_allclose(reported, values.std(axis=0), rtol=0.25)
    np.testing.assert_allclose(values.mean(axis=0), [C1, C2, C3], atol=4 * values.std(axis=0).max() / np.sqrt(150))


@pytest.mark.parametrize(
    ("name", "kpa"), [("ecoflex-00-30", 48), ("ecoflex-00-50", 67), ("dragon-skin-10", 169), ("dragon-skin-30", 668)]
)
def test_neo_hookean_moduli_of_real_curves_are_those_of_the_catalogue(name: str, kpa: float) -> None:
    """materials-odbl.toml: E = 3 mu over 2-100 %; its fits weigh small strains a little differently."""
    fit = fit_material(CURVES / f"{name}.csv", test="tension", max_strain=1.0, law="neo-hookean")
    assert 6 * fit.chosen.values[0] == pytest.approx(1e3 * kpa, rel=0.025)
    assert fit_material(CURVES / f"{name}.csv", test="tension", max_strain=1.0).chosen.misfit < fit.chosen.misfit


def test_an_unstable_curve_gives_a_law_whose_stress_rises_over_its_range() -> None:
    s = np.linspace(1.02, 1.5, 25)
    softening = 2 * (s - s**-2) * (1000 - 2 * 300 * (s**2 + 2 / s - 3))
    fit = fit_material(np.column_stack([s, softening]), test="tension", stress="nominal", law="yeoh")
    assert fit.chosen.is_limited
    assert "unstable" in fit.warnings[-1]
    largest, (c1, c2, c3) = fit.curve.distortion.max(), fit.chosen.values
    for invariant, factor in (
        (lambda s: s**2 + 2 / s, lambda s: s - s**-2),
        (lambda s: 2 * s**2 + s**-4, lambda s: s - s**-5),
        (lambda s: s**2 + s**-2 + 1, lambda s: s - s**-3),
    ):
        for stretches in (np.linspace(1, 1.5, 3001), np.linspace(1, 0.6, 3001)):
            x = invariant(stretches) - 3
            nominal = np.abs(factor(stretches) * (c1 + 2 * c2 * x + 3 * c3 * x**2))[x <= 0.999 * largest]
            assert (np.diff(nominal) > 0).all()


ROWS = [(1 + 0.1 * k, 0.5 * k) for k in range(1, 8)]
COMMAS = "".join(f"{a:.1f};{b:.2f}\n".replace(".", ",") for a, b in ROWS)
PER_CENT = "".join(f"{k},{100 * (a - 1):g},{b:g}\n" for k, (a, b) in enumerate(ROWS))
TEXTS = {
    "decimal commas and a byte order mark": "\ufeffstretch;nominal stress (kPa)\n" + COMMAS,
    "per cent and other columns": "time (s),strain (%),nominal stress [kPa]\n" + PER_CENT,
    "both kinds": "true strain,true stress (MPa),engineering strain,engineering stress (MPa)\n"
    + "".join(f"{np.log(a)},{1e-3 * a * b},{a - 1},{1e-3 * b}\n" for a, b in ROWS),
    "a unit at the end": "Stretch\tNominal Stress kPa\n" + "".join(f"{a}\t{b}\n" for a, b in ROWS),
}  # fmt: skip


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_files_of_many_programs_hold_the_same_curve(text: str, tmp_path: Path) -> None:
    expected = fit_material([(a, 1e3 * b) for a, b in ROWS], test="tension", stress="nominal")
    fit = fit_material(write(tmp_path, text), test="tension", stress="nominal")
    np.testing.assert_allclose(fit.laws[2].values, expected.laws[2].values, rtol=1e-6)


def test_a_shortening_and_a_pressure_are_compression(tmp_path: Path) -> None:
    s, stress = NOMINAL["compression"]
    text = "strain,nominal stress (Pa)\n" + "".join(f"{1 - a:.12g},{-b:.12g}\n" for a, b in zip(s, stress(s), strict=True))
    np.testing.assert_allclose(fit_material(write(tmp_path, text), test="compression").chosen.values, [C1, C2, C3], rtol=1e-6)


HEAD = "stretch,nominal stress (kPa)\n"
TWICE = "".join(f"{a},{b},{b}\n" for a, b in ROWS)
LARGE = "".join(f"{10 * k},{k}\n" for k in range(1, 8))
GOOD = "".join(f"{a:g},{b:g}\n" for a, b in ROWS)
BAD = {
    "stress without unit": ("stretch,nominal stress\n" + GOOD, "its unit"),
    "two units": ("stretch,nominal stress (kPa),nominal stress (MPa)\n" + TWICE, "2 columns"),
    "force": ("stretch,force (N)\n" + GOOD, "force over the sample's area"),
    "stress in newtons": ("stretch,nominal stress (N)\n" + GOOD, "divide forces"),
    "neither nominal nor true": ("stretch,stress (kPa)\n" + GOOD, "--stress"),
    "stretch in per cent": ("stretch (%),nominal stress (kPa)\n" + GOOD, "without unit"),
    "strain that must be per cent": ("strain,nominal stress (kPa)\n" + LARGE, "needs the unit %"),
    "stretch of 0": (HEAD + "0,-5\n" + GOOD, "above 0"),
    "compression called tension": (HEAD + "".join(f"{1 - 0.05 * k:g},{-k}\n" for k in range(1, 8)), "--test compression"),
    "too few points": (HEAD + "1.1,0.5\n1.2,1\n1.3,1.5\n", "at least 5"),
    "not a number": (HEAD + GOOD + "1.8,nan\n", "finite numbers"),
    "unloading": (HEAD + GOOD + "".join(f"{a:g},{b:g}\n" for a, b in ROWS[-2::-1]), "loading branch"),
    "falling stress": (HEAD + "".join(f"{a},{-b}\n" for a, b in ROWS), "rises with the strain"),
    "no names": (GOOD, "row of names"),
    "words": (HEAD + GOOD + "1.8,stiff\n", "a number"),
    "nothing": ("", "columns"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "remedy"), BAD.values(), ids=BAD)
def test_what_is_no_curve_is_refused_in_one_sentence(text: str, remedy: str, tmp_path: Path) -> None:
    message = refused("material", "fit", write(tmp_path, text), "--test", "tension")
    assert remedy in message


def test_a_bonded_sample_and_an_odd_array_are_refused() -> None:
    for curve, test, said in (([(1, 2)], "bonded-compression", "lubricated"), ([1, 2, 3], "tension", r"shape \(n, 2\)")):
        with pytest.raises(InputError, match=said):
            fit_material(curve, test=test, stress="nominal")


def test_the_command_prints_a_table_that_a_scene_takes(tmp_path: Path) -> None:
    words = ("material", "fit", CURVES / "dragon-skin-10.csv", "--test", "tension", "--max-strain", "100 %")
    text = run(*words, "--plot", tmp_path / "fit.png").stdout
    output = json.loads(run(*words, "--json").stdout)
    assert output["toml"] == text
    assert (tmp_path / "fit.png").stat().st_size > 10_000
    table = tomllib.loads(text)["tissue"]
    scene = tomllib.loads((EXAMPLES / "scene.toml").read_text(encoding="utf-8"))
    tissue = scene_from_dict(scene | {"tissue": scene["tissue"] | table}).tissue
    assert (tissue.law, tissue.law_strain) == ("yeoh", 1.0)
    assert tissue.c2_over_c1 == pytest.approx(output["c2_over_c1"], rel=1e-3)
    assert tissue.youngs_modulus == pytest.approx(output["youngs_modulus"], rel=1e-3)
    assert output["stable_strain"] is None
    assert output["misfit"] < 0.02

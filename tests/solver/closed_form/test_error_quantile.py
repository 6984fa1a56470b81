"""The stated errors: 95 % quantiles that cover what they state, on stored and on fresh scenes, and state their source."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.closed_form.error import ErrorRow, build_row, select_errors
from benchmarks.closed_form.random_scenes import SOFT_SKIN
from benchmarks.closed_form.scenes import draw_solved, read_solved
from geometry import read_scene
from solver import evaluate, plan
from solver.closed_form.contact import Tissue, solve_contact
from solver.closed_form.error_quantile import QUANTITIES, SCENE_CLASSES, TABLES, SceneClass
from solver.closed_form.evaluator import ClosedForm
from solver.closed_form.tractions import ElasticBlocks
from tests.support.named import runs
from tests.support.paths import REFERENCE, ROOT, SCENE

STORED = {name: REFERENCE / "closed-form-errors" / f"{name}.jsonl" for name in ("scenes", "more-scenes", "soft-skins")}
# of ``benchmarks.closed_form.scenes``; scenes of the second that no search selects are stored, too
STORED_SEED, FRESH_SEED, SOFT_SKIN_SEED = 4, 2027, 9
SEARCHED_SCENES = 12  # of each class, which depend on the closed form; the page of evidence has 53 to 115
OFF_AXIS_SCENES = {"drawn": 16, "searched": 6}  # ten seconds each
PROMISED_COVERAGE = 0.93, 0.97  # of each class and quantity
MIN_SHARPNESS_COUNT = 50  # errors from which their median is sharp enough to compare: that of 20 scatters by a factor of two
MAX_SHARPNESS = 10.0  # median stated over median true error
RARE = 0.002  # probability on each side that a count fails if the coverage is at a limit of the promised: 4 % that one of 20 does


@pytest.mark.parametrize("file_name", sorted(set(TABLES.values())))
def test_a_table_has_an_origin_and_other_scenes_than_those_of_the_tests(file_name: str) -> None:
    table = json.loads((ROOT / "solver" / "closed_form" / file_name).read_text(encoding="utf-8"))
    origin, kinds = table["origin"], {kind for kind in SCENE_CLASSES if TABLES[kind] == file_name}
    assert runs(origin["script"].split()[2])
    assert not {STORED_SEED, FRESH_SEED, SOFT_SKIN_SEED} & set(origin["seeds"])
    assert all(origin["scenes"][kind] >= 400 for kind in kinds)
    assert min(origin["searched"].values()) >= 60
    assert table["weights"].keys() == set(QUANTITIES)
    assert table["constants"].keys() == kinds


def check_coverage(rows: list[ErrorRow], kind: SceneClass, origin: str) -> None:
    """Check by a binomial test that the coverage is 93 to 97 %, and that the median stated error is below 10 true ones.

    A count that is improbable (``RARE``) under every coverage in that range fails. So 200 scenes hold the coverage within 87 and
    100 %, and 1000 within 90 and 98 %; ``docs/explanation/closed-form.md`` states what many scenes measured.
    """
    for place, quantity in enumerate(QUANTITIES):
        true, stated = select_errors(rows, kind, place)
        covered = int((true <= stated).sum())
        sharpness = float(np.median(stated) / np.median(true))
        worst = np.max(true / stated)
        print(f"{kind}, {origin}, {quantity}: {covered} of {len(true)}, stated/true {sharpness:.1f}, worst {worst:.2g}")
        lowest, highest = binom.ppf(RARE, len(true), PROMISED_COVERAGE[0]), binom.ppf(1 - RARE, len(true), PROMISED_COVERAGE[1])
        if origin == "searched":  # may be covered more often, but not less
            highest = len(true)
        assert lowest <= covered <= highest, (kind, quantity)
        if origin == "drawn" and len(true) >= MIN_SHARPNESS_COUNT:
            assert sharpness < MAX_SHARPNESS, (kind, quantity)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *(("scenes", kind) for kind in SCENE_CLASSES),
        *(("more-scenes", kind) for kind in SCENE_CLASSES if kind != "off axis"),
        ("soft-skins", SOFT_SKIN),
    ],
)
def test_stored_scenes_are_covered_as_stated(name: str, kind: str) -> None:
    rows = [row for solved in read_solved(STORED[name]) if solved.kind == kind and (row := build_row(solved)) is not None]
    assert len(rows) >= 24
    check_coverage(rows, rows[0].kind, "drawn")


def test_on_soft_skins_no_true_error_is_twice_the_stated() -> None:
    """Of 60 scenes; without the squeeze among the features it was up to 2.5 times."""
    rows = [row for solved in read_solved(STORED["soft-skins"]) if (row := build_row(solved)) is not None]
    shares = np.array([row.true / row.stated for row in rows])
    assert len(shares) >= 55
    assert np.nanmax(shares) < 2


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(("kind", "origin"), [("off axis", "drawn"), *((kind, "searched") for kind in SCENE_CLASSES)])
def test_fresh_scenes_are_covered_as_stated(kind: SceneClass, origin: str) -> None:
    """Scenes drawn afresh, and those that a search picks: of 100 probes, the one with the largest log-sensitivity."""
    count = OFF_AXIS_SCENES[origin] if kind == "off axis" else SEARCHED_SCENES
    generators = [np.random.default_rng([FRESH_SEED, SCENE_CLASSES.index(kind), number]) for number in range(count)]
    solved = [draw_solved(rng, kind, searched=origin == "searched") for rng in generators]
    check_coverage([row for item in solved if (row := build_row(item)) is not None], kind, origin)


def test_it_answers_when_named_and_warns_but_auto_never_chooses_it() -> None:
    scene = read_scene(SCENE)
    result = evaluate(scene, "closed-form", accuracy=1e-3)
    assert result.error_kind == "95 %"
    assert any(note.kind == "accuracy" for note in result.warnings)
    stated = max(result.error_estimate or 0.0, result.stiffness_error or 0.0)
    assert plan(scene, accuracy=min(2 * stated, 0.9)).evaluator != "closed-form"
    chosen = evaluate(scene, accuracy=min(2 * stated, 0.9))
    assert chosen.evaluator != "closed-form"
    assert chosen.error_kind == "bound"


def test_stated_errors_are_those_of_the_result() -> None:
    scene = read_scene(SCENE)
    scene = scene.model_copy(update={"load": scene.load.model_copy(update={"force": None, "indentation": 1e-5})})
    (solution,) = ClosedForm().compute_films([scene])
    result = ClosedForm().evaluate(scene)
    errors = solution.errors  # type: ignore[union-attr]
    too_large = [result.stress_inner_error, result.stress_outer_error, result.stiffness_error]
    assert np.log1p(result.error_estimate) == pytest.approx(errors.log_ratio)
    assert -np.log1p(np.negative(too_large)) == pytest.approx([*errors.log_totals, errors.log_stiffness])


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_few_functions_meet_the_punch_of_boussinesq(share: float) -> None:
    """Stiff blocks without friction and next to no gap: 4 G a / (1 - nu), here 4 / 0.7."""
    ones = np.ones(1)
    inner = ElasticBlocks(None, share * ones, ones, 1e9 * ones, 0 * ones)
    outer = ElasticBlocks((share + 1e-6) * ones, ones, ones, 1e9 * ones, 0 * ones)
    solution = solve_contact((inner, outer), Tissue(None, 2.6 * ones, 0.3 * ones), [], target=None, bonded=False, nodes=16)
    assert float(solution.forces.sum()) * 0.7 / 4 == pytest.approx(1, abs=2e-3)

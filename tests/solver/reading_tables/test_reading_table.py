"""Tables of readings against ``equivalent-inclusion`` with reflections, at tumours and places that the table has not seen."""

import os

import numpy as np
import pytest

from geometry import InputError, Refusal
from geometry.common.cached_arrays import CACHE_VARIABLE
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Load
from probe_design import predict_readings
from solver import evaluate
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.effect_samplers import LinearEffects, LoadedEffects, choose_sampler
from solver.reading_tables.tumour_ranges import TumourRanges

SCENE = Scene.from_tables(
    {
        "probe": {
            "inner_radius": "6.26 mm",
            "outer_radius": "8.37 mm",
            "gap": "0.5 mm",
            "height": "1.25 mm",
            "inner": {"youngs_modulus": "1 MPa", "poisson_ratio": 0.48},
            "outer": {"youngs_modulus": "1 MPa", "poisson_ratio": 0.48},
            "base": {"rigid": True},
        },
        "tissue": {"shape": "cylinder", "radius": "60 mm", "depth": "60 mm", "youngs_modulus": "5.3 kPa", "poisson_ratio": 0.4},
        "inclusion": [{"diameter": "8 mm", "depth": "10 mm", "youngs_modulus": "25 kPa", "poisson_ratio": 0.45}],
        "contact": {"interface": "bonded"},
        "load": {"force": "10 mN"},
    }
)
RANGES = TumourRanges((9e-3, 12e-3), (7e-3, 9e-3), (20e3, 28e3), min_cover=3e-3)
CANDIDATES = np.array([[3e-3, -2e-3, 10.2e-3, 8.1e-3, 26e3], [-9e-3, 4e-3, 11e-3, 7.3e-3, 21e3]])[:, None]
POSITIONS = np.array([[3e-3, -2e-3], [0.0, 0.0], [8e-3, -8e-3], [-16e-3, 0.0], [16e-3, 16e-3]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder, old = tmp_path_factory.mktemp("cache"), os.environ.get(CACHE_VARIABLE)
    os.environ[CACHE_VARIABLE] = str(folder)
    yield folder
    if old is None:
        del os.environ[CACHE_VARIABLE]
    else:
        os.environ[CACHE_VARIABLE] = old


@pytest.fixture(scope="module")
def table(folder):
    return read_or_build_table(SCENE, RANGES)


def compute_truth(tumours, positions=POSITIONS, scene=SCENE):
    """Return the signals of one set of tumours by ``equivalent-inclusion``, all reflections and exchange counted, (k, 2)."""
    base = EquivalentInclusion().prepare(scene, 0.003)
    x, y, depth, diameter, modulus = np.asarray(tumours).T
    sets = Tumours(x - positions[:, :1], y - positions[:, 1:], depth, diameter, modulus, 0.45)
    readings, films = compute_readings(base, sets, reflect=True), base.films
    ratio = np.log(readings.totals[:, 0] / readings.totals[:, 1] / (films.totals[0] / films.totals[1]))
    return np.stack([ratio, np.log(readings.stiffness / films.totals.sum())], axis=-1)


def test_one_tumour_is_predicted_within_the_stated_error(table):
    truth = np.stack([compute_truth(tumours) for tumours in CANDIDATES])
    deviations = np.abs(table.predict(CANDIDATES, POSITIONS) - truth)
    assert np.all(table.error < 5e-3)
    assert np.all(deviations.max(axis=(0, 1)) < 3 * table.error * np.abs(truth).max(axis=(0, 1)))


def test_two_tumours_add(table):
    pair = CANDIDATES[:, 0][None]
    truth, predicted = compute_truth(pair[0]), table.predict(pair, POSITIONS)[0]
    assert np.all(np.abs(predicted - truth) < 0.02 * np.abs(truth).max(axis=0))


def test_slopes_are_the_derivatives_of_the_truth(table):
    step = 1e-4
    truth = [
        (compute_truth(CANDIDATES[0], POSITIONS + step * axis) - compute_truth(CANDIDATES[0], POSITIONS - step * axis))
        / (2 * step)
        for axis in np.eye(2)
    ]
    slopes = table.slopes(CANDIDATES[:1], POSITIONS)[0]
    np.testing.assert_allclose(slopes, np.stack(truth, axis=-1), atol=0.02 * float(np.abs(truth).max()))


def test_slope_vanishes_over_the_tumour_and_effects_vanish_far_away(table):
    """Trap 7 of the trial: an offset table needs zero slope at 0 and must vanish at its end."""
    along = np.array([[1.0, 0.0]])
    above = CANDIDATES[0, :, :2]
    (layer,) = table.layers
    far = above + 2 * layer.end * along
    peak = np.abs(table.predict(CANDIDATES[:1], above)).max()
    near = np.abs(table.slopes(CANDIDATES[:1], above + 1e-6 * along)).max() * layer.scale
    assert near < 1e-2 * peak
    np.testing.assert_allclose(table.predict(CANDIDATES[:1], far), 0.0, atol=1e-9)
    end = above + layer.end * along
    assert np.abs(table.predict(CANDIDATES[:1], end)).max() < 0.02 * peak
    step = 1e-6 * along
    jump = table.predict(CANDIDATES[:1], end + step) - table.predict(CANDIDATES[:1], end - step)
    assert np.abs(jump).max() < 1e-5 * peak


def test_allowed_are_covered_tumours_inside_and_apart(table):
    good, shallow, weak, outside = CANDIDATES[0].copy(), *(CANDIDATES[0].copy() for _ in range(3))
    shallow[0, 2], weak[0, 4], outside[0, 0] = 7e-3, 5e3, 58e-3
    np.testing.assert_array_equal(table.is_allowed(np.stack([good, shallow, weak, outside])), [True, False, False, False])
    twins = [good.copy() for _ in range(2)]
    twins[0][0, 0] += 8.2e-3  # 0.1 mm between the surfaces
    twins[1][0, 0] += 9.2e-3
    np.testing.assert_array_equal(table.is_allowed(np.stack([np.vstack([good, twin]) for twin in twins])), [False, True])


@pytest.mark.parametrize(("column", "value"), [(0, np.nan), (3, 0.0), (4, 0.0), (2, 30e-3), (4, 40e3)])
def test_tumours_outside_the_table_are_refused(table, column, value):
    tumours = CANDIDATES[:1].copy()
    tumours[0, 0, column] = value
    with pytest.raises(InputError, match="allowed"):
        table.predict(tumours, POSITIONS)


def test_narrow_tissue_and_deep_tumours_are_refused(folder):
    narrow = SCENE.replace({"tissue.radius": "16 mm"})
    with pytest.raises(Refusal, match="decays"):
        read_or_build_table(narrow, TumourRanges((10e-3, 10e-3), (8e-3, 8e-3), (25e3, 25e3)))
    with pytest.raises(Refusal, match=r"population\.depth"):
        read_or_build_table(SCENE, TumourRanges((10e-3, 58e-3), (8e-3, 8e-3), (25e3, 25e3)))


IN_FAT = SCENE.replace({"tissue.youngs_modulus": "6 kPa"}).model_copy(update={"inclusion": ()})
IN_FAT = Scene.from_tables(
    IN_FAT.model_dump(exclude_none=True)
    | {"tissue": IN_FAT.tissue.model_dump() | {"layer": [{"thickness": 12e-3, "youngs_modulus": 3e3, "poisson_ratio": 0.45}]}}
)


@pytest.fixture(scope="module")
def fat_table(folder):
    return read_or_build_table(IN_FAT, TumourRanges((5e-3, 20e-3), (7e-3, 7e-3), (25e3, 25e3), min_cover=2e-3))


@pytest.mark.slow
def test_tumours_of_two_layers_add(fat_table):
    pair = np.array([[3e-3, -2e-3, 6.5e-3, 7e-3, 25e3], [-4e-3, 4e-3, 17e-3, 7e-3, 25e3]])
    truth, predicted = compute_truth(pair, scene=IN_FAT), fat_table.predict(pair[None], POSITIONS)[0]
    assert np.all(np.abs(predicted - truth) < 0.02 * np.abs(truth).max(axis=0))
    np.testing.assert_allclose(fat_table.slopes(pair[None], POSITIONS), fat_table.slopes(pair[None, ::-1], POSITIONS))


@pytest.mark.slow
@pytest.mark.parametrize("depth", [6.5e-3, 17e-3])
def test_effects_in_either_layer_are_those_of_a_meshed_tumour(fat_table, depth):
    """On the axis ``axisymmetric`` meshes tumour and interface."""
    body = Inclusion(depth=depth, diameter=7e-3, youngs_modulus=25e3, poisson_ratio=0.45)
    scenes = (IN_FAT.model_copy(update={"inclusion": bodies}) for bodies in ((), (body,)))
    bare, loaded = (evaluate(scene, "axisymmetric", accuracy=1e-3) for scene in scenes)
    truth = np.log([loaded.ratio / bare.ratio, loaded.stiffness / bare.stiffness])
    predicted = fat_table.predict(np.array([[[0.0, 0.0, depth, 7e-3, 25e3]]]), np.zeros((1, 2)))[0, 0]
    np.testing.assert_allclose(predicted, truth, rtol=0.01)


@pytest.mark.slow
def test_depths_and_diameters_of_two_layers(folder):
    """Beside the surface, at either side of the interface, and of the largest diameter that fits above it."""
    table = read_or_build_table(IN_FAT, TumourRanges((5e-3, 20e-3), (6e-3, 12e-3), (25e3, 25e3), min_cover=2e-3))
    bodies = ((5.1e-3, 6.1e-3), (8.2e-3, 6.2e-3), (6.51e-3, 9e-3), (16.9e-3, 8.1e-3), (19.3e-3, 12e-3))
    candidates = np.array([[[1e-3, -2e-3, depth, diameter, 25e3]] for depth, diameter in bodies])
    truth = np.stack([compute_truth(tumours, scene=IN_FAT) for tumours in candidates])
    deviations = np.abs(table.predict(candidates, POSITIONS) - truth)
    assert np.all(table.error < 6e-3)
    assert np.all(deviations.max(axis=1) < 3 * table.error * np.abs(truth).max(axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("depth", [6.5e-3, 17e-3])
def test_effects_under_load_in_either_layer(folder, depth):
    """``contact`` meshes the tumour at finite strain; at 90 mN linear elasticity is off by 4 %."""
    scene = IN_FAT.model_copy(update={"load": Load(force=0.09)})
    body = Inclusion(depth=depth, diameter=7e-3, youngs_modulus=25e3, poisson_ratio=0.45)
    scenes = (scene.model_copy(update={"inclusion": bodies}) for bodies in ((), (body,)))
    bare, loaded = (evaluate(part, "contact", accuracy=3e-3) for part in scenes)
    table = read_or_build_table(scene, TumourRanges((5e-3, 20e-3), (7e-3, 7e-3), (25e3, 25e3), min_cover=2e-3))
    predicted = table.predict(np.array([[[0.0, 0.0, depth, 7e-3, 25e3]]]), np.zeros((1, 2)))[0, 0, 0]
    assert predicted == pytest.approx(np.log(loaded.ratio / bare.ratio), rel=0.015)


@pytest.mark.slow
def test_a_tumour_across_an_interface_is_refused(fat_table):
    with pytest.raises(InputError, match="interfaces of layers"):
        fat_table.predict(np.array([[[0.0, 0.0, 12e-3, 7e-3, 25e3]]]), POSITIONS)


def test_ranges_that_all_reach_across_an_interface_are_refused(folder):
    with pytest.raises(Refusal, match=r"population\.depth = 10 mm to 14 mm"):
        read_or_build_table(IN_FAT, TumourRanges((10e-3, 14e-3), (7e-3, 9e-3), (25e3, 25e3)))


@pytest.mark.slow
def test_a_damaged_file_is_built_again(folder):
    ranges = TumourRanges((10e-3, 10e-3), (8e-3, 8e-3), (25e3, 25e3))
    before = set(folder.iterdir())
    (first,) = read_or_build_table(SCENE, ranges).layers
    (path,) = set(folder.iterdir()) - before
    whole = path.read_bytes()
    np.testing.assert_array_equal(read_or_build_table(SCENE, ranges).layers[0].coefficients, first.coefficients)
    path.write_bytes(whole[:-100])
    np.testing.assert_allclose(read_or_build_table(SCENE, ranges).layers[0].coefficients, first.coefficients, rtol=1e-9)
    assert path.read_bytes() == whole
    other = SCENE.replace({"probe.gap": "0.6 mm"})
    assert not np.array_equal(read_or_build_table(other, ranges).layers[0].coefficients, first.coefficients)


@pytest.mark.slow
def test_public_prediction_needs_no_ranges(folder):
    predicted = predict_readings(SCENE, CANDIDATES[:1], POSITIONS)
    truth = compute_truth(CANDIDATES[0])
    np.testing.assert_allclose(predicted.log_ratio[0], truth[:, 0], atol=2e-3 * float(np.abs(truth[:, 0]).max()))
    np.testing.assert_allclose(predicted.log_stiffness[0], truth[:, 1], atol=2e-3 * float(np.abs(truth[:, 1]).max()))
    with pytest.raises(InputError, match="finite"):
        predict_readings(SCENE, [[[0, 0, 10e-3, 8e-3, np.nan]]], POSITIONS)


def test_effects_are_those_under_the_load_where_it_matters():
    """The rule is that of `evaluate`; a light load gives the linear effects, a heavy one refuses an indentation in its place."""
    assert isinstance(choose_sampler(SCENE), LinearEffects)
    assert isinstance(choose_sampler(SCENE.replace({"load.force": "0.3 N"})), LoadedEffects)
    heavy = choose_sampler(SCENE.model_copy(update={"load": Load(indentation=3e-3)}))
    with pytest.raises(Refusal, match="force"):
        assert heavy.films

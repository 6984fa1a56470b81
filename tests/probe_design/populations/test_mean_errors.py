"""Sampling and model error of a population's means: stated separately, not larger with more tumours, never below the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from probe_design.populations import inclusion_scan, tissue_scan
from probe_design.populations.design_file import read_builtin_design
from probe_design.populations.examination import Examination, examine
from probe_design.populations.noise import build_difference_noise
from probe_design.populations.scan_errors import ERROR_CAUSES, GROOVE_SAFETY_FACTOR, bound_groove_change
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from tests.support.designs import SUPERFICIAL, THREE, example_design, verify

NOISE = {"white": 0.02, "charge": "0 pC"}


@pytest.mark.slow
def test_more_tumours_make_no_error_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where fewer tumours get reflections than are drawn, bounds on what the others lack once grew with their number."""
    monkeypatch.setattr(inclusion_scan, "MAX_REFLECTED_READINGS", 24)
    monkeypatch.setattr(tissue_scan, "MIN_REFLECTED", 8)
    design = example_design(population=SUPERFICIAL, protocol=THREE, noise=NOISE)
    few_tumours, many_tumours = (verify(design.scene, design, samples=samples) for samples in (8, 64))
    for kind, error in many_tumours.errors.items():
        assert error.model <= 1.05 * few_tumours.errors[kind].model, kind
        assert error.total <= few_tumours.errors[kind].total, kind
    assert few_tumours.errors["detection"].model > 0
    assert few_tumours.errors["detection"].corrected == 0 < many_tumours.errors["detection"].corrected
    assert sum(many_tumours.causes.values()) == pytest.approx(1.0)
    assert set(many_tumours.causes) == set(ERROR_CAUSES)


def test_tumours_without_reflections_count_with_the_others_mean_correction() -> None:
    """Eq. PO.13: over repeated choices of those with reflections the mean is that of all, the error its standard deviation."""
    rng, n, r = np.random.default_rng(0), 60, 12
    first = rng.uniform(size=n)
    best = first + 0.1 * first + 0.05 * rng.standard_normal(n)
    means, stated = [], []
    for _ in range(4000):
        chosen = np.sort(rng.choice(n, r, replace=False))
        known = np.where(np.isin(np.arange(n), chosen), best, first)
        scan = Examination.__new__(Examination)
        object.__setattr__(scan, "draw", range(n))
        object.__setattr__(scan, "reflected", chosen)
        values, errors = scan._correct_first_order({"detection": known}, {"detection": first})
        means.append(values["detection"].mean())
        stated.append(errors["detection"])
    assert np.mean(means) == pytest.approx(best.mean(), abs=4 * np.std(means) / np.sqrt(4000))
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(np.std(means), rel=0.05)


def test_three_lines_are_those_of_a_known_tumour_in_closed_form() -> None:
    """One tumour, white noise: P = Phi(d' - z), d'^2 = (sum s^2 - (sum s)^2 / (p + 1)) / w^2 for each channel."""
    noise = {"white": 0.05, "stiffness_white": 0.01, "charge": "0 pC"}
    design = example_design(protocol={**THREE, "stiffness": False}, noise=noise)
    scan = examine(design.scene, design, unseen=True)
    performances = scan.evaluate_all_channels(design)
    signal, p, squares = scan.readings.signal[0], 3, {}
    for name, part, white in (("ratio", signal[:p], 0.05), ("stiffness", signal[p:], 0.01)):
        squares[name] = ((part**2).sum() - part.sum() ** 2 / (p + 1)) / white**2
    squares["both"] = sum(squares.values())
    for name, performance in performances.by_channels.items():
        assert performance is not None
        assert performance.means["detection"] == pytest.approx(ndtr(np.sqrt(squares[name]) - ndtri(0.95)), rel=1e-6)
    assert performances.means["detection"] == performances.by_channels["ratio"].means["detection"]  # type: ignore[union-attr]
    assert performances.as_dict()["by_channels"]["both"]["detection"] > performances.means["detection"]


def test_a_channel_without_noise_that_is_not_read_is_left_out_and_not_refused() -> None:
    design = example_design(protocol={**THREE, "stiffness": False}, noise={"stiffness_white": 0.0})
    performance = verify(design.scene, design)
    assert performance.by_channels["stiffness"] is performance.by_channels["both"] is None
    assert performance.as_dict()["by_channels"]["both"] is None


def test_noise_of_one_channel_is_that_part_of_both() -> None:
    design = example_design(protocol=THREE)
    blank = np.array([3.0, 1.0])
    whole = build_difference_noise(design.noise, design.protocol, design.scene, blank).covariance
    for channel_set, part in (("ratio", slice(0, 3)), ("stiffness", slice(3, 6))):
        noise = build_difference_noise(design.noise, design.protocol, design.scene, blank, channel_set=channel_set)  # type: ignore[arg-type]
        assert np.array_equal(noise.covariance, whole[part, part])


def test_what_the_groove_is_bounded_by_is_above_what_solid_finds() -> None:
    """A probe with the paper's groove by `solid`: 0.37639 with it, 0.37478 without; +x and -x tumours: 0.0060, 0.0010."""
    radii = {"probe.inner_radius": 6.26e-3, "probe.outer_radius": 8.37e-3}
    blocks = {f"probe.{name}.youngs_modulus": 1e6 for name in ("inner", "outer")}
    scene = read_builtin_design().scene
    probe = scene.probe.model_copy(update={"area_ratio": None, "outer_radius": 8.37e-3})
    sizes = {**radii, **blocks, "probe.height": 1.25e-3, "probe.gap": 5e-4}
    sizes |= {"probe.groove.width": 2e-3, "probe.groove.depth": 1e-3}
    tissue = scene.tissue.model_copy(update={"layer": ()})
    scene = scene.model_copy(update={"inclusion": (), "probe": probe, "tissue": tissue}).replace(sizes)
    share = bound_groove_change(scene, EquivalentInclusion().solve_alone(scene, 0.01).films.forces).max()
    change = np.log(0.37639 / 0.37478)
    assert change < share < 8 * change
    bound = (
        GROOVE_SAFETY_FACTOR * share * (0.136 + 0.054)
    )  # of what a tumour of 12 mm under the groove changes of both films' forces
    assert bound > 0.0060

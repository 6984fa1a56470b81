"""Posterior standard deviations: known cases, simulated estimates, and what a prior does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.scenes.scene_tables import Load
from probe_design.design_search.tumour_objective import Noise, compute_standard_deviation
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.examination import examine
from probe_design.populations.inclusion_scan import compute_inclusion_readings
from probe_design.populations.noise import build_full_noise
from probe_design.populations.population import ScenePopulation
from probe_design.populations.resolved import (
    Unknowns,
    compute_contrast_sd,
    compute_fraction_error,
    compute_informations,
    compute_place_errors,
    is_resolved,
    is_undecided,
)
from probe_design.populations.scan_readings import compute_closed_form_readings
from probe_design.populations.tables import NoiseModel, Protocol
from solver import evaluate
from tests.support.designs import SUPERFICIAL, THREE, example_design

NOISE = 0.05


def unknowns(q: int, host: int, n: int) -> Unknowns:
    names = ("object", "tissue", *(f"number {k}" for k in range(q - 2)))
    return Unknowns(names, np.linspace(0.3, 0.9, q), np.full(n, host))


def problem(n: int = 5, m: int = 6, q: int = 4, size: float = 1.0) -> tuple[Floats, LinearGaussian]:
    rng = np.random.default_rng(0)
    mixing = rng.standard_normal((m, m))
    return rng.standard_normal((n, m, q)), LinearGaussian.from_shared_errors(np.sqrt(size) * mixing, np.full(m, size))


def test_one_reading_of_one_known_tumour_is_today_s_objective() -> None:
    """The standard deviation of ln E_object that ``optimize`` of a bare scene counts with, eq. DS.6."""
    protocol = {"positions": ["0 mm"], "stiffness": False, "blank": False}
    design = example_design(protocol=protocol, noise={"white": NOISE, "gain": 0.0})
    scored_design = examine(design.scene, design).evaluate(design)
    result = evaluate(design.scene, "closed-form")
    assert result.ratio is not None
    assert result.log_sensitivity is not None
    share = result.ratio * design.scene.probe.inner_area
    share /= share + design.scene.probe.outer_area
    expected = compute_standard_deviation(
        Noise.from_scene(design.scene, NOISE).compute_information(result.log_sensitivity, share, 0.01)
    )
    assert scored_design.contrast_sd[0] == pytest.approx(expected, rel=1e-6)


def test_deviations_are_those_of_the_whole_fisher_matrix() -> None:
    J, noise = problem()
    for host in (-1, 1):
        known = unknowns(4, host, len(J))
        c = np.zeros(4)
        c[0] = 1
        if host > 0:
            c[host] = -1
        prior = np.diag([0.0, *known.deviations[1:] ** -2])
        fisher = J.transpose(0, 2, 1) @ np.linalg.solve(noise.covariance, J) + prior
        contrast_sd = compute_contrast_sd(known, J, noise)
        assert contrast_sd == pytest.approx(np.sqrt([c @ np.linalg.solve(matrix, c) for matrix in fisher]))


def test_information_is_what_the_prior_loses() -> None:
    J, noise = problem()
    known = unknowns(4, 1, len(J))
    c, prior = np.array([1.0, -1.0, 0.0, 0.0]), np.diag(known.deviations**-2)
    fisher = J.transpose(0, 2, 1) @ np.linalg.solve(noise.covariance, J) + prior
    information, prior_information = (
        np.array([c @ np.linalg.solve(matrix, c) for matrix in fisher]),
        c @ np.linalg.solve(prior, c),
    )
    assert compute_informations(known, J, noise) == pytest.approx(np.log(prior_information / information) / 2)


def test_the_place_and_all_of_a_tumour_follow_from_the_whole_covariance() -> None:
    """By explicit inverses and determinants: the tissue's modulus is a nuisance, the tumour's own four numbers are not."""
    J, noise = problem(q=5)
    known = Unknowns(("object", "depth", "x", "y", "layer_0_thickness"), np.linspace(0.3, 0.9, 5), np.full(len(J), -1))
    prior = np.diag(known.deviations**-2)
    posterior = np.linalg.inv(J.transpose(0, 2, 1) @ np.linalg.solve(noise.covariance, J) + prior)
    assert compute_place_errors(known, J, noise) == pytest.approx(np.sqrt(posterior[:, 2, 2] + posterior[:, 3, 3]))
    tissue = noise.covariance + known.deviations[4] ** 2 * np.einsum("nm,nk->nmk", J[..., 4], J[..., 4])
    everything = noise.covariance + J @ np.diag(known.deviations**2) @ J.transpose(0, 2, 1)
    expected = (np.linalg.slogdet(everything)[1] - np.linalg.slogdet(tissue)[1]) / 2
    assert compute_informations(known, J, noise) == pytest.approx(expected)


def test_readings_that_tell_nothing_tell_nothing() -> None:
    J, noise = np.zeros((3, 6, 4)), LinearGaussian.from_shared_errors(np.zeros((6, 0)), np.ones(6))
    known = unknowns(4, 1, 3)
    assert np.all(np.isinf(compute_contrast_sd(known, J, noise)))
    assert np.all(is_resolved(compute_contrast_sd(known, J, noise)) == 0)
    assert compute_informations(known, J, noise) == pytest.approx(0.0, abs=1e-15)


def test_hardly_any_noise_leaves_finite_numbers() -> None:
    for size in (1e-12, 1e12):
        J, noise = problem(size=size)
        known = unknowns(4, 1, len(J))
        assert np.all(np.isfinite(compute_informations(known, J, noise)))
        assert np.all(compute_contrast_sd(known, J, noise) > 0)


@pytest.mark.slow
def test_intervals_cover_the_truth() -> None:
    """Estimates from simulated readings of tumours whose numbers are off as the priors say: 1.96 deviations hold 95 %."""
    design = example_design(population={**SUPERFICIAL, "tissue": ["4 kPa", "9 kPa"]}, protocol=THREE)
    population = ScenePopulation.from_scene(design.scene, design.population)
    draw = population.draw_tumours(8)
    known = Unknowns.from_draw(population, draw)
    readings = compute_closed_form_readings(draw, design.protocol, known.names)
    noise = build_full_noise(design.noise, design.protocol, design.scene, readings.blank[0], readings.mean_forces)
    C = noise.covariance
    rng = np.random.default_rng(0)
    J = known.build_derivatives(readings, design.protocol.blank)
    stated, tissue = compute_contrast_sd(known, J, noise), known.names.index("tissue")
    covered = []
    for k, row in enumerate(J):
        errors = known.deviations * rng.standard_normal((2000, len(known.names)))
        readings_off = errors @ row.T + rng.multivariate_normal(np.zeros(len(C)), C, 2000)
        # least squares with the priors as rows: what is off besides the object's modulus was found to be none
        rows = np.vstack([row, np.diag(1 / known.deviations)[1:]])
        weight = np.zeros((len(rows), len(rows)))
        weight[: len(C), : len(C)], weight[len(C) :, len(C) :] = np.linalg.inv(C), np.eye(len(known.names) - 1)
        data = np.hstack([readings_off, np.zeros((2000, len(known.names) - 1))])
        estimate = data @ weight @ rows @ np.linalg.inv(rows.T @ weight @ rows)
        error = (estimate - errors)[:, 0] - (estimate - errors)[:, tissue]
        covered.append((np.abs(error) < 1.96 * stated[k]).mean())
    assert 0.93 < np.mean(covered) < 0.97


@pytest.mark.slow
def test_tumours_of_the_physics_page_are_told_as_it_says() -> None:
    """PHYSICS section 2, of ln E_object: 50 % on depth, diameter and tissue, 1 % noise, nine positions; a trial."""
    lengths = {"probe.inner_radius": 2.51e-3, "probe.gap": 0.22e-3, "probe.height": 2.47e-3}
    moduli = {"probe.inner.youngs_modulus": 1.13e6, "probe.outer.youngs_modulus": 0.785e6}
    scene = example_design().scene.replace({"probe.area_ratio": 0.117, **lengths, **moduli})
    scene = scene.model_copy(update={"load": Load(force=1e-3)})
    noise = NoiseModel(white=0.01, stiffness_white=0.01, gain=0.0, stiffness_gain=0.0, charge=0.0)
    depth, diameter, contrast = np.array([[9, 8, 10], [9, 8, 3], [6, 10, 10], [6, 10, 3], [9, 15, 5]]).T
    tumours = ScenePopulation.from_scene(scene, example_design().population).draw_tumours()
    objects = contrast * scene.tissue.youngs_modulus
    draw = replace(
        tumours,
        depth=depth * 1e-3,
        diameter=diameter * 1e-3,
        youngs_modulus=objects,
        x=np.zeros(5),
        y=np.zeros(5),
        tissue=np.zeros(5, int),
    )
    known = Unknowns(("object", "depth", "diameter", "tissue"), np.array([1.0, 0.5, 0.5, 0.5]), np.full(5, -1))  # of ln E_object
    line = tuple(np.linspace(-16e-3, 16e-3, 9).tolist())
    values_stated = {((0.0,), False): [8.5, 2.4, 4.1, 1.1, 1.9], (line, False): [6.4, 1.9, 0.61, 0.52, 0.68],
            (line, True): [6.2, 1.8, 0.28, 0.14, 0.10]}  # fmt: skip
    for (positions, stiffness), expected in values_stated.items():
        protocol = Protocol(positions=positions, stiffness=stiffness, blank=False)
        readings = compute_inclusion_readings(draw, protocol, known.names, noise=noise).best
        scan_noise = build_full_noise(noise, protocol, scene, readings.blank[0], readings.mean_forces)
        deviations = compute_contrast_sd(known, known.build_derivatives(readings, False), scan_noise)
        assert deviations[:2] == pytest.approx(expected[:2], rel=0.1)
        assert np.abs(np.log(deviations / expected)).max() < np.log(1.7)


def test_a_blank_never_tells_less() -> None:
    sds = []
    for blank in (False, True):
        design = example_design(population={**SUPERFICIAL, "tissue": ["4 kPa", "9 kPa"]}, protocol={**THREE, "blank": blank})
        sds.append(examine(design.scene, design, samples=8).evaluate(design).contrast_sd)
    assert np.all(sds[1] <= sds[0] * (1 + 1e-9))


def test_what_the_level_is_unsure_of_moves_tumours_over_the_bound_and_no_others() -> None:
    deviations, share = np.array([0.6, 0.6, 0.4, 0.4, 40.0, np.inf, 1e-3]), np.array([0.1, 0.3, 0.1, 0.3, 1.0, 1.0, 0.9])
    assert is_undecided(deviations, share).tolist() == [0, 1, 0, 1, 0, 0, 0]


@pytest.mark.parametrize("true", [0.0, 0.02, 0.3, 0.97, 1.0])
def test_errors_of_shares_are_not_below_those_of_repeated_samples(true: float) -> None:
    """None resolved of 40 is no proof that none is."""
    samples = (np.random.default_rng(7).random((2000, 40)) < true).astype(float)
    error = np.sqrt(np.mean((samples.mean(axis=1) - true) ** 2))
    stated = np.sqrt(np.mean([compute_fraction_error(row) ** 2 for row in samples]))
    assert error <= stated * 1.03  # 2000 samples know it to 1.6 %
    assert stated <= max(1.5 * error, 1 / 40)

"""The inference of `locate` on a forward model in closed form: truths, and the traps of the trial."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import logistic, multivariate_normal, multivariate_t

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from probe_design.estimation.measurements import Reading
from probe_design.locating import inference, run
from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.inference import Posterior, infer
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.location import Location
from probe_design.locating.mixtures import FREEDOM, PRIOR_SHARE, ExtendedProposal, SetProposal, StudentMixture
from probe_design.locating.next_position import compute_information
from probe_design.locating.posterior import compute_quantiles
from probe_design.locating.prior import TumourPrior
from probe_design.locating.report import build_tables, list_lines
from probe_design.locating.sampling import draw_posterior
from probe_design.locating.scan_data import ScanConditions, ScanData
from probe_design.locating.scan_loads import ScanLoads, TumourFree
from probe_design.populations.design_file import Design, design_from_dict
from solver.reading_tables.tumour_ranges import TumourRanges, build_cubes
from tests.support.paths import ROOT
from tests.support.stand_in_model import StandInModel

WHITE, GAIN = np.array([0.01, 0.03]), np.array([0.07, 0.05])
LINE = np.linspace(-16e-3, 16e-3, 5)
PLACES = np.array([(30e-3, 0.0), *((x, y) for y in LINE for x in LINE)])  # the baseline reading first
CLEAR = np.array([[[3.1e-3, -5.4e-3, 9.0e-3, 10e-3, 26e3]]])
APART = np.array([[[-9.2e-3, -6.1e-3, 8.5e-3, 9e-3, 30e3], [8.3e-3, 7.2e-3, 10e-3, 11e-3, 30e3]]])
NONE = np.zeros((1, 0, 5))
GAINS = CommonErrors.from_channels("ln_gain", GAIN)


def design(**population: object) -> Design:
    sizes = {"depth": [8e-3, 20e-3], "diameter": [5e-3, 12e-3], "least_cover": 2e-3}
    ranges = sizes | {"object": [16e3, 32e3], "x": [-16e-3, 16e-3]}
    return design_from_dict({"scene": str(ROOT / "examples" / "scene.toml"), "population": ranges | population})


def scan(tumours: Floats, stiffness: bool = False, seed: int = 1, pose: float = 0.0) -> ScanData:
    rng, n = np.random.default_rng(seed), len(PLACES)
    moved = PLACES + pose * rng.standard_normal(PLACES.shape)
    values, variance = np.zeros((n, 2)), np.tile(WHITE**2, (n, 1))
    values[1:] = StandInModel().predict(tumours, moved[1:])[0] if tumours.shape[1] else 0.0
    values += GAIN * rng.standard_normal(2) + WHITE * rng.standard_normal((n, 2))
    if not stiffness:
        values[:, 1], variance[:, 1] = 0.0, np.inf
    return ScanData(PLACES, values, variance, np.full((n, 2), pose), np.arange(n) == 0, GAINS)


def likelihood(data: ScanData, rate: float = 0.0, **population: object) -> Likelihood:
    return Likelihood(data, (StandInModel(),), TumourPrior.from_design(design(**population), PLACES[1:]), rate)


def result(data: ScanData, rate: float = 0.0, **population: object) -> Location:
    return infer(likelihood(data, rate, **population), CONDITIONS, 0, advise=True)


CONDITIONS = ScanConditions(ScanLoads((TumourFree(design().scene, np.ones(2), np.zeros(2)),)), GAINS, {"tissue": 5.3e3})


def unknown_scale(data: ScanData, scale: float) -> ScanData:
    return replace(data, errors=GAINS.join(CommonErrors.from_channels("tissue_signal", np.zeros(2), np.full(2, scale))))


@cache
def clear() -> Location:
    return result(scan(CLEAR), tumours=1)


@pytest.mark.parametrize(("pose", "scale"), [(0.0, 0.0), (0.5e-3, 0.0), (0.0, 0.2)])
def test_likelihood_is_that_of_the_whole_covariance(pose: float, scale: float) -> None:
    """Against scipy's multivariate normal density: one gain for scan and baseline reading, one scale of all signals."""
    data = unknown_scale(scan(CLEAR, stiffness=True, pose=pose), scale)
    tumours = CLEAR + np.array([[[0.0] * 5], [[1e-3, 0, 1e-3, 0, 0]]])
    values, expected = likelihood(data).evaluate_tumours(tumours), []
    for bodies in tumours:
        signal, slopes = np.zeros((26, 2)), np.zeros((26, 2, 2))
        signal[1:], slopes[1:] = StandInModel().predict(bodies[None], PLACES[1:]), StandInModel().slopes(bodies[None], PLACES[1:])
        parts = []
        for channel in range(2):
            white = WHITE[channel] ** 2 + pose**2 * (slopes[:, channel] ** 2).sum(axis=-1)
            covariance = np.diag(white) + GAIN[channel] ** 2 + scale**2 * np.outer(signal[:, channel], signal[:, channel])
            parts.append(multivariate_normal.logpdf(data.values[:, channel] - signal[:, channel], cov=covariance))
        expected.append(sum(parts))
    assert values[1] - values[0] == pytest.approx(expected[1] - expected[0], abs=1e-6)


def test_wild_readings_are_integrated_over_the_gain() -> None:
    """Against the integral over the gain by quadrature."""
    data = scan(CLEAR)
    data.values[7, 0] += 0.3
    subject = likelihood(data, rate=0.05)
    tumours = CLEAR + np.array([[[0.0] * 5], [[2e-3, 0, 0, 0, 0]]])
    computed, expected = subject.evaluate_tumours(tumours), []
    for bodies in tumours:
        residuals = data.values[:, 0].copy()
        residuals[1:] -= StandInModel().predict(bodies[None], PLACES[1:])[0, :, 0]

        def density(gain: float, residuals: Floats = residuals) -> float:
            good, wide = (np.exp(-((residuals - gain) ** 2) / v / 2) / np.sqrt(v) for v in (1e-4, 1e-4 + 0.25))
            return float(np.prod(0.95 * good + 0.05 * wide) * 1e-40 * np.exp(-(gain**2) / GAIN[0] ** 2 / 2))

        middle = float(np.median(residuals))
        expected.append(np.log(quad(density, middle - 0.02, middle + 0.02, epsabs=0, points=[middle])[0]))
    assert computed[1] - computed[0] == pytest.approx(expected[1] - expected[0], abs=0.05)


def test_clear_tumour_is_located_and_its_contrast_is_not_learnt() -> None:
    quantities = clear().tumours[0].quantities
    assert clear().probability[0] < 1e-3
    assert clear().explained
    assert abs(quantities["x"].median - CLEAR[0, 0, 0]) < 1e-3
    assert abs(quantities["y"].median - CLEAR[0, 0, 1]) < 1e-3
    for name, truth in zip(("x", "y", "depth", "diameter"), CLEAR[0, 0], strict=False):
        assert quantities[name].is_learnt
        assert quantities[name].interval_90[0] < truth < quantities[name].interval_90[1], name
    assert not quantities["ln_contrast"].is_learnt
    assert quantities["ln_contrast"].sd_relative == pytest.approx(1, abs=0.1)
    assert "Not learnt: Young's modulus, ln contrast: as before the scan." in list(list_lines(clear()))
    assert clear().effective_sample_size > 100
    assert 1e-6 < clear().tumours[0].place_region_90 < 30e-6


def test_evidence_of_one_tumour_is_the_mean_likelihood_of_the_prior() -> None:
    """Against plain Monte Carlo over the prior, by other random numbers."""
    subject = likelihood(scan(CLEAR + np.array([0, 0, 5e-3, -1e-3, 0]), seed=3))  # weak, so that plain Monte Carlo converges
    sample = draw_posterior(subject, 1, 0)
    tumours = subject.prior.transform(np.random.default_rng(8).random((200_000, 1, 5)))
    values = np.concatenate([subject.evaluate_tumours(part) for part in np.array_split(tumours, 50)])
    plain = values.max() + np.log(np.mean(np.exp(values - values.max())))
    assert sample.log_evidence == pytest.approx(plain, abs=0.15)


@pytest.mark.slow
def test_evidence_of_two_tumours_is_the_mean_likelihood_of_the_prior() -> None:
    """Against plain Monte Carlo over the prior, by other random numbers, in a scan weak enough for it."""
    subject = likelihood(scan(CLEAR + np.array([0, 0, 6e-3, -2e-3, 0]), seed=3))
    sample = draw_posterior(subject, 2, 0)
    points = np.random.default_rng(8).random((60_000, 2, 5))
    values = np.concatenate([subject.evaluate(part) for part in np.array_split(points, 15)])
    allowed = values[np.isfinite(values)]
    plain = allowed.max() + np.log(np.mean(np.exp(allowed - allowed.max())))
    assert sample.is_converged
    assert sample.log_evidence == pytest.approx(plain, abs=0.15)


def test_evidence_that_repeats_do_not_confirm_is_withheld(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other probabilities are those with at most two tumours, and a warning says so."""
    whole = Posterior.from_likelihood(likelihood(scan(NONE, seed=4)), 0)
    doubtful = (*whole.samples[:2], replace(whole.samples[2], repeat_difference=0.8))
    monkeypatch.setattr(inference, "draw_posteriors", lambda *_: doubtful)
    located = result(scan(NONE, seed=4))
    assert located.withheld == (3,)
    assert located.probability == pytest.approx(whole.probability[:3] / whole.probability[:3].sum())
    assert located.as_dict()["probability"][3] is None
    assert any("at most 2" in line and "withheld" in line for line in located.warnings)
    assert build_tables(located)[0].rows[-1][2] == "withheld"


def test_a_small_effective_sample_is_called_not_converged() -> None:
    """Its intervals would be too narrow."""
    subject = likelihood(scan(CLEAR), tumours=1)
    whole = Posterior.from_likelihood(subject, 0)
    small = replace(whole, samples=(replace(whole.samples[0], size=60.0),))
    located = infer(subject, CONDITIONS, 0, advise=False, posterior=small)
    assert any("not converged" in line for line in located.warnings)
    assert build_tables(located)[0].rows[1][-1] == "60, not converged"
    assert not any("not converged" in line for line in clear().warnings)


def test_density_of_proposals_is_that_of_student_mixtures() -> None:
    """Against scipy's multivariate t; sets of two tumours count in both orders."""
    rng = np.random.default_rng(1)
    z = rng.standard_normal((400, 4))
    proposal = SetProposal.fit(z, np.full(400, 1 / 400), 2, rng, number=2)

    def density(mixture: StudentMixture, points: Floats) -> Floats:
        parts = zip(mixture.shares, mixture.means, mixture.factors, strict=True)
        kernels = sum(share * multivariate_t.pdf(points, mean, factor @ factor.T, FREEDOM) for share, mean, factor in parts)
        return PRIOR_SHARE * logistic.pdf(points).prod(axis=1) + (1 - PRIOR_SHARE) * kernels

    first, second = proposal.single
    swapped = z[:, [2, 3, 0, 1]]
    joint = density(proposal.joint, z) + density(proposal.joint, swapped)
    single = density(first, z[:, :2]) * density(second, z[:, 2:]) + density(first, z[:, 2:]) * density(second, z[:, :2])
    assert proposal.compute_log_density(z) == pytest.approx(np.log((joint + single) / 4), abs=1e-9)
    triples = rng.standard_normal((50, 6))
    pairs = [np.exp(proposal.compute_log_density(np.delete(triples, [2 * k, 2 * k + 1], axis=1))) for k in range(3)]
    extended = sum(pair * density(first, triples[:, 2 * k : 2 * k + 2]) for k, pair in enumerate(pairs)) / 3
    assert ExtendedProposal(proposal, first).compute_log_density(triples) == pytest.approx(np.log(extended), abs=1e-9)


@pytest.mark.slow
def test_the_evidence_of_three_repeats_beside_two_clear_tumours() -> None:
    """The third may lie anywhere where the readings do not show it."""
    subject = likelihood(scan(APART, stiffness=True))
    stated = [posterior for seed in range(4) if len((posterior := Posterior.from_likelihood(subject, seed)).samples) == 3]
    assert len(stated) >= 3
    differences = [part.log_evidence[3] - part.log_evidence[2] for part in stated]
    assert np.ptp(differences) < 0.5


def test_the_same_seed_gives_the_same_result() -> None:
    again = result(scan(CLEAR), tumours=1)
    assert again.probability == clear().probability
    assert again.tumours == clear().tumours


def test_without_tumour_none_is_more_probable_than_before_but_not_certain() -> None:
    empty = result(scan(NONE, seed=4), tumours=1)
    assert 0.5 < empty.probability[0] < 0.99
    assert empty.explained


def test_two_tumours_apart_are_two_and_are_not_mixed() -> None:
    """Labels: each tumour's interval is about one of the truths, not about both."""
    both = result(scan(APART, stiffness=True), tumours=2)
    assert both.probability[0] + both.probability[1] < 1e-3
    places = sorted((part.quantities["x"].median, part.quantities["y"].median) for part in both.tumours)
    assert np.abs(np.array(places) - APART[0, :, :2]).max() < 1.5e-3


def test_second_tumour_that_cannot_be_read_stays_possible() -> None:
    """The count alone misleads: P(two) is what the prior of invisible tumours leaves, and the map shows one place."""
    posterior = Posterior.from_likelihood(likelihood(scan(CLEAR), tumours=2), 0)
    assert 0.05 < posterior.probability[2] < 0.6
    assert posterior.probability[0] < 1e-3


def test_a_tumour_outside_the_scan_lies_where_the_margin_allows() -> None:
    outside = CLEAR + np.array([16.5e-3, 0, 0, 0, 0])  # 3.6 mm beyond the last presses
    located = result(scan(outside), tumours=1, margin=6e-3)
    assert located.probability[0] < 1e-2
    for name, truth in zip("xy", outside[0, 0], strict=False):
        low, high = located.tumours[0].quantities[name].interval_90
        assert low < truth < high, name


def test_gain_is_common_to_scan_and_baseline_reading() -> None:
    """All readings and the baseline reading together higher by a tenth: no other tumours."""
    data = scan(CLEAR)
    subject, shifted = likelihood(data), likelihood(replace(data, values=data.values + np.array([0.1, 0.0])))
    tumours = CLEAR + np.array([[[0.0] * 5], [[0, 0, 3e-3, 0, 0]]])
    first, second = (np.diff(part.evaluate_tumours(tumours)) for part in (subject, shifted))
    assert first == pytest.approx(second, abs=0.1)


def test_pose_error_widens_the_region_of_the_place() -> None:
    data = scan(CLEAR, pose=0.8e-3)
    exact = draw_posterior(likelihood(replace(data, pose_sd=0 * data.pose_sd)), 1, 0)
    hand_held = draw_posterior(likelihood(data), 1, 0)

    def width(sample: object) -> float:
        low, high = compute_quantiles(sample.points[:, 0, 0], sample.weights, (0.05, 0.95))  # type: ignore[attr-defined]
        return float(high - low)

    assert width(hand_held) > 1.1 * width(exact)


def test_baseline_reading_over_a_tumour_is_noticed() -> None:
    data = scan(CLEAR)
    data.values[0, 0] += 0.08
    found_out = result(data, tumours=1)
    assert not found_out.explained
    assert any("baseline reading 0" in line and "a tumour may lie below it" in line for line in found_out.warnings)


@pytest.mark.slow
def test_wild_reading_is_named_and_with_outliers_does_no_harm() -> None:
    data = scan(CLEAR)
    data.values[20, 0] += 0.4
    strict, robust = result(data, tumours=1), result(data, rate=0.03, tumours=1)
    assert not strict.explained
    assert any("a wild reading (--outliers, outliers=)" in line for line in strict.warnings)
    assert robust.explained
    assert robust.residuals[20].wild is not None
    assert robust.residuals[20].wild > 0.9
    assert abs(robust.tumours[0].quantities["x"].median - CLEAR[0, 0, 0]) < 1.5e-3


def test_population_without_the_truth_does_not_explain_the_readings() -> None:
    strong = np.array([[[3e-3, -5e-3, 8e-3, 12e-3, 400e3]]])
    other = result(scan(strong), tumours=1, depth=[14e-3, 20e-3], diameter=[5e-3, 7e-3])
    assert not other.explained
    assert any("no tumour of this population explains" in line for line in other.warnings)


def test_readings_too_noisy_for_any_tumour_say_so() -> None:
    data = scan(NONE)
    noisy = result(replace(data, variance=data.variance * 100), tumours=1)
    assert any("the map is little more than the population" in line for line in noisy.warnings)


def test_a_tissue_that_is_not_known_widens_size_and_says_so() -> None:
    unknown = result(unknown_scale(scan(CLEAR), 0.4), tumours=1)
    assert any("tissue is not known" in line for line in unknown.warnings)
    known, wider = (np.ptp(part.tumours[0].quantities["diameter"].interval_90) for part in (clear(), unknown))
    assert wider > 1.15 * known


def test_errors_by_the_tissue_are_those_of_its_modulus() -> None:
    """Below much stiffer blocks the stiffness is proportional to the modulus; signals change as Eshelby's strength."""
    low, high, nu = 4e3, 7e3, 0.45
    soft = read_scene(ROOT / "examples" / "scene.toml").replace({"probe.outer.youngs_modulus": "1 MPa"})
    tables = {
        "scene": soft,
        "population": {"depth": [15e-3, 20e-3], "diameter": [4e-3, 5e-3], "object": 24e3, "tissue": [low, high]},
    }
    errors = ScanConditions.from_design(design_from_dict(tables)).errors
    number = errors.names.index("tissue")
    sd = np.log(high / low) / np.sqrt(12)
    assert errors.deviations[number] == pytest.approx(sd)
    excess, beta = 24e3 / np.sqrt(low * high) - 1, 2 * (4 - 5 * nu) / (15 * (1 - nu))
    assert errors.constant[number, 0, 1] == pytest.approx(sd, rel=0.05)
    by_host = -(1 + excess) / excess / (1 + beta * excess)  # d ln of (c - 1) / (1 + beta (c - 1)) by ln E_host
    assert errors.scale[number, 0, 1] == pytest.approx(sd * by_host, rel=0.1)


def test_touching_tumours_are_excluded_and_the_evidence_counts_it() -> None:
    prior = likelihood(scan(NONE)).prior
    touching = np.array(
        [[[0, 0, 10e-3, 8e-3, 2e4], [8e-3, 0, 10e-3, 8e-3, 2e4]], [[0, 0, 10e-3, 8e-3, 2e4], [9e-3, 0, 10e-3, 8e-3, 2e4]]]
    )
    assert prior.find_allowed(touching).tolist() == [False, True]
    assert prior.compute_allowed_fraction(1) == 1.0
    assert 0.8 < prior.compute_allowed_fraction(2) < 0.99


def test_more_tumours_than_a_short_line_holds_are_refused_with_their_number() -> None:
    line = np.array([(30e-3, 0.0), *((x, 0.0) for x in (-4e-3, 0.0, 4e-3))])  # 8 mm wide
    prior = TumourPrior.from_design(design(x=[-4e-3, 4e-3], y=[0.0], diameter=[6e-3, 12e-3]), line)
    with pytest.raises(InputError, match=r"population.tumours = 3, .* %.*: allowed: at most 2, or places over a wider range"):
        prior.compute_allowed_fraction(3)


def test_depth_begins_below_the_least_cover() -> None:
    prior = TumourPrior.from_design(design(depth=[5e-3, 25e-3], diameter=[4e-3, 16e-3]), PLACES)
    tumours = prior.transform(prior.draw(4096, 1, 0))[:, 0]
    assert (tumours[:, 2] - tumours[:, 3] / 2).min() >= 2e-3 - 1e-9
    shallowest = np.maximum(tumours[:, 3] / 2 + 2e-3, 5e-3)
    share = np.log(tumours[:, 2] / shallowest) / np.log(25e-3 / shallowest)
    assert np.mean(share) == pytest.approx(0.5, abs=0.01)
    assert np.corrcoef(share, np.log(tumours[:, 3]))[0, 1] == pytest.approx(0, abs=0.03)


def test_tumours_that_fit_below_a_skin_are_those_of_the_table() -> None:
    """The least cover counts from the surface; the interface takes a tenth of the diameter."""
    skin = {"thickness": 1e-3, "youngs_modulus": 20e3, "poisson_ratio": 0.45}
    scene = read_scene(ROOT / "examples" / "scene.toml")
    layered = Scene.from_tables(scene.model_dump(exclude_none=True) | {"tissue": scene.tissue.model_dump() | {"layer": [skin]}})
    prior = replace(TumourPrior.from_design(design(), PLACES), scene=layered)
    ranges: list[TumourRanges] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "read_or_build_table", lambda scene, given: ranges.append(given))
        run.build_models(prior, (layered,))
    (cube,) = build_cubes(ranges[0], layered.tissue)
    tumours = prior.transform(prior.draw(1024, 1, 0))
    depth, diameter = tumours[prior.find_allowed(tumours)][:, 0, 2:4].T
    assert np.all(depth >= cube.compute_shallowest(diameter) - 1e-9)


def test_margin_and_weights_of_the_population() -> None:
    prior = TumourPrior.from_design(design(margin=4e-3, weights=(0.9, 0.05, 0.03, 0.02)), PLACES)
    assert prior.ranges[0].values == pytest.approx((-20e-3, 20e-3))
    assert prior.ranges[1].values == pytest.approx((-20e-3, 20e-3))
    assert prior.numbers == pytest.approx([0.9, 0.05, 0.03, 0.02])
    with pytest.raises(InputError, match="weights"):
        design(weights=(0.5, 0.5))


def test_readings_at_a_load_beyond_linear_elasticity_are_refused() -> None:
    known = design()
    free = ScanConditions.from_design(known)
    scanned = tuple(Reading(x, 0.0, 0.4, 0.01, force=force) for x, force in ((-8e-3, 5e-3), (0.0, 5e-3), (8e-3, 0.5)))
    assert len(ScanData.from_readings(scanned[:2], known, free)) == 2
    with pytest.raises(InputError, match=r"reading\[2\].force = 500 mN: allowed: up to"):
        ScanData.from_readings(scanned, known, free)


def test_information_of_a_reading_is_that_of_two_hypotheses() -> None:
    """A tumour that is there or not, far above the noise: ln 2; where nothing is read: 0."""
    means, variances = np.array([[0.0, 0.0], [0.1, 0.0]]), np.full((2, 2), 1e-6)
    near, far = compute_information(means, variances, np.array([0.5, 0.5]))
    assert near == pytest.approx(np.log(2), abs=2e-3)
    assert far == pytest.approx(0, abs=2e-3)

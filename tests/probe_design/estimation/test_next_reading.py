"""Which reading next: what may be read, what is expected of it by simulation, and what no reading can determine."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import norm

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.scenes import fit_check as placement
from geometry.scenes.scene_file import scene_from_dict
from geometry.scenes.scene_tables import Placement
from probe_design.estimation.estimate_result import is_identifiable
from probe_design.estimation.intervals import Likelihood
from probe_design.estimation.measurements import Measurements, Reading
from probe_design.estimation.model import TargetModel
from probe_design.estimation.next_reading import NextCandidate, _Draws, choose_next_reading, list_candidates
from probe_design.estimation.nuisances import NuisanceErrors, SharedErrors, compute_nuisance_errors
from probe_design.estimation.predictions import Predictions
from probe_design.estimation.profile import Track
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.inclusion_scan import compute_inclusion_readings
from probe_design.populations.population import TumourDraw
from probe_design.populations.resolved import Unknowns, compute_contrast_sd
from probe_design.populations.tables import NoiseModel, Protocol
from tests.support.paths import EXAMPLES
from tests.support.program import run

SCENE = read_scene(EXAMPLES / "scene.toml").replace({"inclusion.youngs_modulus": 20e3})
READ = 0.551  # `probe-design evaluate --evaluator axisymmetric` says of it 0.55096
SIZE = {"inclusion.diameter": 0.2}


def model(ratio: float = READ, noise: float = 0.02, scene: Scene = SCENE) -> TargetModel:
    return TargetModel(scene, Measurements.from_readings((Reading(0.0, 0.0, ratio, noise),)), 0.01)


def test_what_may_be_read_stands_on_the_tissue_and_is_named_once() -> None:
    candidates_found = list_candidates(model(), "youngs_modulus", SIZE)
    assert len({candidate.description for candidate in candidates_found}) == len(candidates_found)
    assert {candidate.kind for candidate in candidates_found} == {
        "ratio",
        "ratio and stiffness",
        "blank",
        "blank with stiffness",
        "size from ultrasound",
    }
    for candidate in candidates_found:
        if candidate.reading is not None:
            placement.check_bodies_fit(
                SCENE.model_copy(update={"placement": Placement(x=candidate.reading.x, y=candidate.reading.y)})
            )


def test_a_blank_and_a_size_are_read_only_where_something_else_is_not_known() -> None:
    kinds = {candidate.kind for candidate in list_candidates(model(), "youngs_modulus", {})}
    assert kinds == {"ratio", "ratio and stiffness"}
    assert "size from ultrasound" not in {
        candidate.kind for candidate in list_candidates(model(), "youngs_modulus", {"inclusion.diameter": 0.03})
    }


@pytest.mark.slow
def test_the_expected_interval_is_what_simulated_readings_give() -> None:
    """Truths drawn evenly along eq. ES.2, selected where they may have given the reading that is there; fresh noise."""
    target_model, chance, noise = model(), np.random.default_rng(11), 0.02
    suggestion = choose_next_reading(target_model, "youngs_modulus", {}, already_identifiable=True)
    best = suggestion.reading
    assert best is not None
    assert best.x is not None
    assert best.y is not None
    stiff = 100.0 if "stiffness" in best.kind else None
    measurements = Measurements.from_readings((Reading(0.0, 0.0, READ, noise), Reading(best.x, best.y, 1.0, noise, stiff, noise)))
    track = Track.from_model(TargetModel(SCENE, measurements, 0.01), "youngs_modulus")
    fit, points = Likelihood(track, measurements.noise), np.concatenate(track.runs)
    truth = chance.uniform(points.min(), points.max(), 40_000)
    first = track.interpolate(truth)[0][:, 0]
    truth = truth[chance.random(len(truth)) < np.exp(-(((np.log(READ) - first) / noise) ** 2) / 2)][:300]
    y = track.interpolate(truth)[0] + measurements.noise * chance.normal(size=(len(truth), len(measurements.noise)))
    y[:, 0] = np.log(READ)
    ends = [(None, None)] * len(y)
    for k, reading in enumerate(y):
        pieces = fit.find_pieces(reading)
        if pieces:
            ends[k] = (None if pieces[0].low_open else pieces[0].low, None if pieces[-1].high_open else pieces[-1].high)
    identified = np.mean([is_identifiable(reading, "youngs_modulus") for reading in ends])
    widths = [np.inf if low is None or high is None else high / low for low, high in ends]
    print(f"expected width {best.width}, simulated {np.median(widths)}; told {best.identifiable}, simulated {identified}")
    assert best.identifiable == pytest.approx(identified, abs=0.15)  # 64 draws against 300: a standard deviation of 0.07 at most
    assert best.width is not None
    assert np.log(best.width) == pytest.approx(np.log(np.median(widths)), rel=0.1)
    assert track.compute_values(np.array([truth.min()]))[0] < 20e3


def linear(derivative: Floats, shared: Floats, noise: Floats) -> Track:
    """ln depth read along straight lines by data that share errors with standard deviation 1, without any error of the model."""
    spots = tuple(Reading(1e-3 * k, 0.0, 1.0, float(sd)) for k, sd in enumerate(noise))
    x = np.linspace(np.log(6e-3), np.log(24e-3), 9)
    predicted = Predictions.empty(len(x), len(noise))
    predicted.value[:] = (x - np.log(12e-3))[:, None] * derivative
    spread = NuisanceErrors(x[:1], SharedErrors.from_linear(shared[None])) if shared.size else None
    linear_model = TargetModel(SCENE, Measurements.from_readings(spots), 0.01)
    return Track(linear_model, "depth", x, predicted, np.tile(derivative, (len(x), 1)), spread)


@pytest.mark.parametrize(
    "shared", [np.zeros((4, 0)), pytest.param(np.array([[0.02], [0.03], [-0.01], [0.05]]), marks=pytest.mark.slow)]
)
def test_expected_widths_of_straight_lines_are_those_of_normal_theory(shared: Floats) -> None:
    """All is normal then: ln width is 2 x 1.96 (J^T C^-1 J)^(-1/2), C noise and shared errors together, whatever is read."""
    derivative, noise = np.array([0.3, 0.25, -0.2, 0.4]), np.array([0.01, 0.01, 0.006, 0.03])
    track, present = linear(derivative, shared, noise), np.array([0])
    draws = _Draws.from_track(track, present, [np.array([k]) for k in (1, 2, 3)], seed=3)
    scores = []
    for which in ([0, 1], [0, 2], [0, 3], [0, 1, 2, 3]):
        C = np.diag(noise[which] ** 2) + shared[which] @ shared[which].T
        expected = 2 * norm.ppf(0.975) * float(derivative[which] @ np.linalg.solve(C, derivative[which])) ** -0.5
        score = draws.summarise(NextCandidate("linear"), np.array(which), together=len(which) > 2)
        assert score.width is not None
        assert np.log(score.width) == pytest.approx(expected, rel=2e-3)  # straight lines between points of the parabola chi2
        assert score.score == pytest.approx(expected, rel=2e-3)
        assert score.identifiable == 1.0
        scores.append(expected)
    assert np.ptp(scores) > 0.2 * min(scores)  # they do differ


@pytest.mark.slow
def test_stiffness_needs_the_size_from_elsewhere() -> None:
    """A deep tumour of unknown size shows only its strength: ultrasound helps most, and no scan does."""
    suggestion = choose_next_reading(model(noise=0.01), "youngs_modulus", SIZE, already_identifiable=False)
    assert suggestion.reading is not None
    assert suggestion.reading.kind == "size from ultrasound"
    assert suggestion.verdict.startswith("measure this: diameter from ultrasound")
    assert all(other_candidate.score >= suggestion.reading.score for other_candidate in suggestion.others)


@pytest.mark.slow
def test_what_saturates_no_reading_tells() -> None:
    stiff = SCENE.replace({"inclusion.youngs_modulus": 30e6})
    ended = run("estimate", EXAMPLES / "scene.toml", "--ratio", "0.5967", "--noise", "0.05", "--next", "--json")
    output = json.loads(ended.stdout)
    assert stiff.inclusion[0].youngs_modulus == 30e6
    assert not output["identifiable"]
    assert output["next"]["verdict"].startswith("no reading of this probe can")
    assert output["next"]["together"]["identifiable"] < 0.5


def test_the_command_says_what_to_measure() -> None:
    words = ("estimate", EXAMPLES / "scene.toml", "--ratio", "0.551", "--noise", "0.02")
    output = json.loads(run(*words, "--next", "--json").stdout)["next"]
    assert set(output["reading"]) == {"kind", "told", "x", "y", "interval", "width", "identifiable", "score"}
    assert output["verdict"].startswith(("measure this: ", "no reading of this probe can"))
    scores = [output["reading"]["score"], *(entry["score"] for entry in output["others"])]
    assert scores == sorted(scores)


def by_population(scene: Scene, positions: Sequence[float], stiffness: bool) -> float:
    """Sd of ln E_object by eq. PO.6: other code for derivatives, which are exact there, and for what is not known."""
    deviations = {"object": 1.0, "depth": 0.5, "diameter": 0.5, "tissue": 0.5}
    body = scene.inclusion[0]
    number = (np.array([value]) for value in (body.depth, body.diameter, body.youngs_modulus, 0.0, 0.0))
    tissue = scene.model_copy(update={"inclusion": ()})
    draw = TumourDraw(scene, *number, body.poisson_ratio, np.zeros(1, dtype=int), (tissue,))
    protocol = Protocol(positions=tuple(positions), stiffness=stiffness, blank=False)
    noise = NoiseModel(white=0.01, stiffness_white=0.01, gain=0.0, stiffness_gain=0.0, charge=0.0)
    readings = compute_inclusion_readings(draw, protocol, tuple(deviations), noise=noise).best
    unknowns = Unknowns(tuple(deviations), np.array(list(deviations.values())), np.array([-1]))  # of ln E_object
    J = unknowns.build_derivatives(readings, protocol.blank)
    noise = LinearGaussian.from_shared_errors(np.zeros((J.shape[1], 0)), np.full(J.shape[1], 1e-4))
    return float(compute_contrast_sd(unknowns, J, noise)[0])


@pytest.mark.slow
@pytest.mark.parametrize("body", [("8 mm", "9 mm", 10.0), ("10 mm", "6 mm", 10.0)])
def test_what_is_identifiable_near_the_surface(body: tuple[str, str, float]) -> None:
    """Fisher's information, priors of 50 % on depth, diameter and the tissue's modulus, 1 % noise, nine places over 16 mm.

    Against eq. PO.6, whose derivatives are exact where these are differences over 2 %, but for what eq. PO.9 leaves out.
    """
    diameter, depth, contrast = body
    scene = scene_from_dict(
        {
            "probe": {
                "inner_radius": "2.51 mm",
                "area_ratio": 0.117,
                "gap": "0.22 mm",
                "height": "2.47 mm",
                "base": {"rigid": True},
            }
            | {key: {"youngs_modulus": E, "poisson_ratio": 0.48} for key, E in (("inner", "1.13 MPa"), ("outer", "0.785 MPa"))},
            "tissue": {
                "shape": "cylinder",
                "radius": "60 mm",
                "depth": "60 mm",
                "youngs_modulus": "6 kPa",
                "poisson_ratio": 0.48,
            },
            "inclusion": [{"diameter": diameter, "depth": depth, "youngs_modulus": f"{6 * contrast} kPa", "poisson_ratio": 0.48}],
            "load": {"force": "1 mN"},
        }
    )
    scan = tuple(Reading(float(x), 0.0, 1.0, 0.01, 100.0, 0.01) for x in np.linspace(-16e-3, 16e-3, 9))
    whole = TargetModel(scene, Measurements.from_readings(scan), 0.01)
    E = np.array([scene.inclusion[0].youngs_modulus])
    derivatives = whole.predict({"youngs_modulus": E}, reflect=True).by_modulus[0]
    prior, step = 0.5, 0.02
    names = ("inclusion.depth", "inclusion.diameter", "tissue.youngs_modulus")
    line = (
        compute_nuisance_errors(whole, dict.fromkeys(names, step), np.zeros(1), {"youngs_modulus": E}).errors.linear[0]
        * prior
        / step
    )
    centre, ratios = np.arange(18) == 4, np.arange(18) < 9
    rows = []
    for which in (centre, ratios, ratios | True):
        covariance = 1e-4 * np.eye(which.sum()) + line[which] @ line[which].T
        rows.append(float((derivatives[which] @ np.linalg.solve(covariance, derivatives[which])) ** -0.5))
    places = np.linspace(-16e-3, 16e-3, 9)
    computed = [by_population(scene, *item) for item in ([[0.0], False], [places, False], [places, True])]
    print(f"D {diameter} at {depth}, c = {contrast:g}: " + " / ".join(f"{item:.2g}" for item in rows), "eq. PO.6", computed)
    assert rows == pytest.approx(computed, rel=0.05)
    assert (rows[2] < 0.5) == (depth == "6 mm")  # a scan with stiffness tells what is near the surface, and nothing deep

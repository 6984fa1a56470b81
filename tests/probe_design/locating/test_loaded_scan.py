"""Scans under the load of a hand: `locate` on readings by other codes, of stresses off the axis and of charges on it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from geometry import Scene
from geometry.common.errors import InputError
from geometry.scenes.scene_tables import Inclusion, Load
from probe_design.estimation.measurements import Reading
from probe_design.locating.location import Location
from probe_design.locating.run import run_locate
from probe_design.locating.scan_loads import ScanLoads, TumourFree
from probe_design.populations.design_file import Design, design_from_dict, read_design
from solver import evaluate
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.effect_samplers import LoadedEffects, choose_sampler
from solver.reading_tables.tumour_ranges import TumourRanges
from tests.support.paths import EXAMPLES, REFERENCE

ROWS = json.loads((REFERENCE / "contact" / "off_axis.json").read_text())["rows"]
DEPTH = 0.3  # indentation of these rows, outer radii


def list_changes(depth: float = DEPTH) -> tuple[Scene, dict[float, float]]:
    """Return scene and change of ln ratio by the distance of the tumour of 30 kPa, NGSolve in three dimensions."""
    rows = [row for row in ROWS if row["indentation_over_outer_radius"] == depth]
    rows = [row for row in rows if row["scene"]["inclusion"][0]["youngs_modulus"] == "30 kPa"]
    scene = Scene.from_tables(rows[0]["scene"])
    distances = [Scene.from_tables(row["scene"]).inclusion[0].x for row in rows]
    force = float(np.mean([row["force_mN"] for row in rows])) * 1e-3
    changes = dict(zip(distances, (row["change_of_ln_ratio"]["value"] for row in rows), strict=True))
    return scene.model_copy(update={"load": Load(force=force)}), changes


def list_readings(depth: float, noise: float) -> list[Reading]:
    """Return a baseline reading and a scan by NGSolve at one load; noise counts, but is not added: what is off is the model."""
    scene, changes = list_changes(depth)
    force, blank = scene.load.force, TumourFree.from_scene(scene).logarithms[0]
    readings = [Reading(30e-3, 0.0, float(np.exp(blank)), noise, blank=True, force=force)]
    for distance, change in changes.items():
        for angle in np.arange(6) * np.pi / 3 if distance else [0.0]:
            x, y = 1e-3 + distance * np.cos(angle), -2e-3 + distance * np.sin(angle)
            readings.append(Reading(x, y, float(np.exp(blank + change)), noise, force=force))
    return readings


def build_design(scene: Scene, **protocol: object) -> Design:
    population = {"depth": [6.5e-3, 12e-3], "diameter": [7e-3, 9e-3], "object": [25e3, 36e3], "least_cover": 2e-3}
    places = {"x": [-8e-3, 8e-3], "y": [-8e-3, 8e-3], "tumours": 1}
    tables = {"scene": scene, "population": population | places, "noise": {"white": 0.003, "charge": 0.0}}
    return design_from_dict(tables | {"protocol": protocol})


@pytest.mark.slow
def test_a_scan_by_finite_strain_in_three_dimensions() -> None:
    """A tumour of 8 mm at 8 mm is located where it lies; linear elasticity would take it for a larger or shallower one."""
    scene, readings = list_changes()[0], list_readings(DEPTH, 0.003)
    result = run_locate(build_design(scene), tuple(readings), 0.0, 0, advise=False)
    assert result.evaluator == "contact"
    assert 0.02 < result.model_error < 0.08
    check_truth(result)
    with pytest.raises(InputError, match=r"loads = \[..., '50 mN'\]"):
        run_locate(build_design(scene), (*readings, Reading(0.0, 0.0, 0.6, 0.003, force=0.05)), 0.0, 0, advise=False)


def check_truth(result: Location) -> None:
    assert result.explained
    (tumour,) = result.tumours
    for name, truth in (("x", 1e-3), ("y", -2e-3), ("depth", 8e-3), ("diameter", 8e-3), ("youngs_modulus", 30e3)):
        low, high = tumour.quantities[name].interval_90
        assert low < truth < high, name


@pytest.mark.slow
def test_readings_at_three_forces_add_up_and_between_two_loads_are_interpolated() -> None:
    """48 mN and 144 mN are loads of the protocol, 97 mN lies between; NGSolve computed the readings at each."""
    scene, lightest = list_changes()[0], list_changes(0.1)[0].load.force
    design = build_design(scene, loads=[lightest, scene.load.force])
    readings = [reading for depth in (0.1, 0.2, 0.3) for reading in list_readings(depth, 0.01)]
    single, several = (run_locate(design, tuple(part), 0.0, 0, advise=False) for part in (list_readings(DEPTH, 0.01), readings))
    check_truth(several)
    # noise alone gives 1 / sqrt(3) = 0.58, of two of the three loads 0.71; errors common to the readings give 1
    for name, limit in {"x": 0.66, "y": 0.66, "depth": 0.9, "diameter": 0.9}.items():
        narrow, wide = (np.ptp(part.tumours[0].quantities[name].interval_90) for part in (several, single))
        assert 0.5 * wide < narrow < limit * wide, name
    # what lies between is known less well than what is on a load, by an eighth of what the load changes
    (weights,), (spreads,) = ScanLoads.from_scene(scene, (lightest,)).weigh([0.0966])
    assert weights == pytest.approx([0.5, 0.5], abs=0.01)
    assert spreads == pytest.approx([-0.125, 0.125], abs=0.01)


@pytest.mark.slow
def test_charges_under_load_are_those_of_a_meshed_tumour() -> None:
    """On the axis ``contact`` meshes the tumour at finite strain, and computes the charges of films on tape."""
    scene = read_design(EXAMPLES / "films.toml").scene.replace({"load.force": "0.12 N"})
    body = Inclusion(depth=7e-3, diameter=7e-3, youngs_modulus=40e3, poisson_ratio=0.45)
    scene = scene.model_copy(update={"inclusion": (body,)})
    bare, loaded = (evaluate(part, "contact") for part in (scene.model_copy(update={"inclusion": ()}), scene))
    sampler = choose_sampler(scene)
    assert isinstance(sampler, LoadedEffects)
    values = [(value, value) for value in (body.depth, body.diameter, body.youngs_modulus)]
    table = read_or_build_table(scene, TumourRanges(*values, poisson_ratio=body.poisson_ratio), sampler)
    tumour = np.array([[[0.0, 0.0, body.depth, body.diameter, body.youngs_modulus]]])
    change, stiffening = table.predict(tumour, np.zeros((1, 2)))[0, 0]
    assert scene.observable == "charge"
    assert loaded.charge_ratio is not None
    assert bare.charge_ratio is not None
    truth = np.log([loaded.charge_ratio / bare.charge_ratio, (loaded.stiffness or 0.0) / (bare.stiffness or 1.0)])
    assert np.all(np.abs([change, stiffening] - truth) < 2 * np.hypot(table.error, table.scale_error) * np.abs(truth))

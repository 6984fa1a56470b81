"""Readings over populations: against single evaluations, between the evaluators, and their derivatives."""

from __future__ import annotations

import operator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Layer, Placement
from probe_design.populations.inclusion_scan import compute_inclusion_readings
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.scan_readings import compute_closed_form_readings
from probe_design.populations.tables import NoiseModel, Protocol
from solver import evaluate
from tests.support.designs import SUPERFICIAL, THREE, example_design
from tests.support.slow import slow_unless

RANGES = {**SUPERFICIAL, "tissue": ["4 kPa", "9 kPa"], "x": ["-3 mm", "3 mm"]}
DESIGN = example_design(population=RANGES, protocol=THREE)
POPULATION = ScenePopulation.from_scene(DESIGN.scene, DESIGN.population)
FINE = NoiseModel(white=3e-4, stiffness_white=3e-4, charge=0.0)  # so that nothing that is reflected is left out
FIELDS = {"depth": "depth", "diameter": "diameter", "object": "youngs_modulus", "x": "x"}


def one_scene(draw: TumourDraw, number: int, x: float, y: float = 0.0) -> Scene:
    body = Inclusion(
        depth=draw.depth[number], diameter=draw.diameter[number], x=draw.x[number], y=draw.y[number],
        youngs_modulus=draw.youngs_modulus[number], poisson_ratio=draw.poisson_ratio,
    )  # fmt: skip
    tissue = draw.tissues[draw.tissue[number]]
    return tissue.model_copy(update={"inclusion": (body,), "placement": Placement(x=x, y=y)})


def single(draw: TumourDraw, number: int, evaluator: str, protocol: Protocol = DESIGN.protocol) -> Floats:
    """ln ratio and ln stiffness at all positions, less those without the tumour, one evaluation each."""
    rows = []
    for place in protocol.list_places(0.0).tolist():
        scene = one_scene(draw, number, *place)
        over_tumour, bare = (
            evaluate(scene_evaluated, evaluator) for scene_evaluated in (scene, scene.model_copy(update={"inclusion": ()}))
        )
        rows.append([np.log(getattr(over_tumour, key) / getattr(bare, key)) for key in ("ratio", "stiffness")])
    return np.array(rows).T.ravel()


def test_formulas_on_arrays_are_those_of_single_scenes() -> None:
    draw = POPULATION.draw_tumours(6)
    signal = compute_closed_form_readings(draw, DESIGN.protocol).signal
    for number in range(len(draw)):
        assert signal[number] == pytest.approx(
            single(draw, number, "closed-form"), rel=0.01, abs=1e-5
        )  # nodes for its farthest place


def test_a_raster_over_tumours_beside_its_lines_is_that_of_single_scenes() -> None:
    tables: dict[str, Any] = {"protocol": {"positions": ["-6 mm", "7 mm"], "raster": True, "stiffness": True}}
    design = example_design(population=SUPERFICIAL | {"x": ["-3 mm", "5 mm"]}, **tables)
    population = ScenePopulation.from_scene(design.scene, design.population)
    draw = population.draw_tumours(2)
    assert np.ptp(draw.y) > 0.5e-3  # y left out ranges as x
    readings = compute_closed_form_readings(draw, design.protocol, ("x", "y"))
    moved = compute_closed_form_readings(replace(draw, y=draw.y + 1e-5), design.protocol).signal
    for number in range(len(draw)):
        expected = single(draw, number, "closed-form", design.protocol)
        assert readings.signal[number] == pytest.approx(expected, rel=0.01, abs=1e-5)
    assert (moved - readings.signal) / 1e-5 == pytest.approx(readings.derivatives["y"], rel=0.01, abs=0.02)


@pytest.mark.slow
def test_readings_of_the_verification_are_those_of_single_scenes() -> None:
    draw = POPULATION.draw_tumours(2)
    readings = compute_inclusion_readings(draw, DESIGN.protocol, noise=FINE).best
    for number in range(len(draw)):
        error = np.abs(readings.signal[number] - single(draw, number, "equivalent-inclusion"))
        assert np.all(error <= readings.error[number])


@pytest.mark.slow
def test_evaluators_agree_and_so_do_their_derivatives() -> None:
    draw, names = POPULATION.draw_tumours(2), (*FIELDS, "tissue")
    formulas = compute_closed_form_readings(draw, DESIGN.protocol, names)
    elements = compute_inclusion_readings(draw, DESIGN.protocol, names, noise=FINE).best
    assert np.abs(formulas.signal - elements.signal).max() < 0.05 * np.abs(elements.signal).max()
    for name in names:
        assert (
            np.abs(formulas.derivatives[name] - elements.derivatives[name]).max()
            < 0.15 * np.abs(elements.derivatives[name]).max()
        ), name
    assert formulas.blank_derivatives["tissue"] == pytest.approx(elements.blank_derivatives["tissue"], rel=0.05)


@pytest.mark.parametrize("name", [*FIELDS, "tissue"])
def test_derivatives_of_the_formulas_have_taylor_s_rate(name: str) -> None:
    """What a straight line leaves of a step falls with its square: a rate of 2."""
    draw = POPULATION.draw_tumours(4)
    now = compute_closed_form_readings(draw, DESIGN.protocol, (name,))

    def left(step: float) -> float:
        if name == "tissue":
            grown = (tissue.tissue.youngs_modulus * np.exp(step) for tissue in draw.tissues)
            tissues = tuple(POPULATION.build_tissue_scene({"tissue": float(tissue)}) for tissue in grown)
            moved_draw = replace(draw, tissues=tissues)
        else:
            old = getattr(draw, FIELDS[name])
            moved_draw = replace(draw, **{FIELDS[name]: old + 1e-3 * step if name == "x" else old * np.exp(step)})
        moved = step * (1e-3 if name == "x" else 1.0)
        signal = compute_closed_form_readings(moved_draw, DESIGN.protocol).signal
        return float(np.abs(signal - now.signal - moved * now.derivatives[name]).max())

    rate = np.log2(left(0.04) / left(0.02))
    assert 1.8 < rate < 2.2


@pytest.mark.parametrize("skin", slow_unless(operator.not_, [False, True]))
def test_where_all_moduli_grow_alike_no_signal_changes(skin: bool) -> None:
    """Close to the surface the first order has a third of what the tissue's modulus does: 10 mm at 6 mm, rigid blocks."""
    scene = DESIGN.scene.replace({f"probe.{block}.youngs_modulus": 60e6 for block in ("inner", "outer")})
    layer = ({"thickness": 0.5e-3, "youngs_modulus": 6e3, "poisson_ratio": 0.45},) if skin else ()
    tissue = scene.tissue.model_copy(update={"layer": tuple(Layer(**item) for item in layer)})
    scene = scene.model_copy(update={"inclusion": (), "tissue": tissue})
    item = [np.array([value]) for value in (6e-3, 9.8e-3, 60e3, 0.0, 0.0)]
    draw = TumourDraw(scene, *item, poisson_ratio=0.45, tissue=np.zeros(1, dtype=int), tissues=(scene,))
    names = ("object", "tissue", *(["layer_0_modulus"] if skin else []))
    parts = compute_inclusion_readings(draw, DESIGN.protocol, names, noise=FINE).best.derivatives
    whole, object_part = sum(parts.values()), np.abs(parts["object"]).max()
    assert np.abs(whole).max() < 0.02 * object_part
    assert np.abs(parts["tissue"]).max() > 0.9 * object_part


def test_the_same_tumour_read_from_both_sides_is_the_same() -> None:
    design = example_design(protocol=THREE)
    draw = ScenePopulation.from_scene(design.scene, design.population).draw_tumours()
    for read in (
        compute_closed_form_readings(draw, design.protocol),
        compute_inclusion_readings(draw, design.protocol, noise=FINE).best,
    ):
        assert read.signal[0, :3] == pytest.approx(read.signal[0, 2::-1], rel=1e-12)

"""Layers of tissue in the closed form: waves against Navier's equation in many digits, laws, limits, an independent code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry import Scene, read_scene
from solver.closed_form.designs import forces, parameters
from solver.closed_form.layer import amplitudes, lowering, waves_inside
from solver.layers.stack import TissueLayer, arriving, change, echoes
from tests.support.layered_waves import states
from tests.support.paths import SCENE
from tests.support.references import expected, named

EXAMPLE = read_scene(SCENE)
OWN = (EXAMPLE.tissue.youngs_modulus, EXAMPLE.tissue.poisson_ratio)
ONE = np.ones(1)
REFERENCES = expected("tissue-layers")
ACROSS = ("sphere-across", "sphere-across-two", "three-layers")  # an interface cuts the sphere


def on(*layers: tuple[float, ...], scene: Scene = EXAMPLE) -> Scene:
    """The scene on layers, (thickness in mm, Young's modulus in Pa, Poisson's ratio of 0.45 unless it is given)."""
    names = ("thickness", "youngs_modulus", "poisson_ratio")
    tables = [dict(zip(names, (1e-3 * one[0], *one[1:], 0.45)[:3], strict=True)) for one in layers]
    data = scene.model_dump(exclude_unset=True)
    return Scene.model_validate(data | {"tissue": data["tissue"] | {"layer": tables}})


def raw(scene: Scene, *, nodes: int | None = None, merged: bool = False) -> np.ndarray:
    """Forces and slopes by the formula, every layer on its own."""
    shape, values = parameters(scene, merged=merged)
    return np.stack(forces(shape if nodes is None else replace(shape, nodes=nodes), values[:, None]))[:, 0]


def stack(*layers: tuple[float | None, float, float]) -> list[TissueLayer]:
    return [TissueLayer(None if h is None else h * ONE, E * ONE, nu * ONE) for h, E, nu in layers]


STACKS = [
    ((0.3, 1.0, 0.45), (0.5, 1e6, 0.3), (1.0, 3.0, 0.0)),
    ((0.3, 1e6, 0.45), (0.5, 1.0, 0.4999), (1.0, 1e6, 0.2)),
    ((1e-3, 1e-6, 0.4999), (0.2, 5.0, 0.3), (2.0, 1.0, 0.49)),
    ((1e-3, 1e6, 0.1), (2e-3, 1e-6, 0.45), (0.2, 5.0, 0.3), (2.0, 1.0, 0.49)),
    ((0.1, 2.0, 0.0), (0.1, 1.0, 0.4999), (0.1, 7.0, 0.3), (0.1, 0.1, 0.2), (0.1, 3.0, 0.1), (0.1, 1.0, 0.4), (3.0, 9.0, 0.45)),
]  # fmt: skip


@pytest.mark.parametrize("k", [0.03, 1.0, 40.0])
@pytest.mark.parametrize("layers", STACKS)
def test_waves_are_those_of_naviers_equation(layers: tuple[tuple[float, float, float], ...], k: float) -> None:
    tissue = stack(*layers)
    waves_of, mu = np.array([[k]]), layers[0][1] / (2 * (1 + layers[0][2]))
    below = echoes(waves_of, tissue, True)
    place, tops = len(layers) - 2, np.cumsum([0.0, *(layer[0] for layer in layers)])
    depth = tops[place] + 0.4 * layers[place][0]
    exact = states(k, layers, [0.0, depth])
    near = below[0].near
    assert near is not None
    sunk = [(own + part).item() / (2 * mu * k) for own, part in zip(tissue[0].half_space, change(tissue[0], near), strict=True)]
    expected_at_surface = exact[0][0, 1], exact[1][0, 0], exact[1][0, 1]  # w by p, u by q, w by q
    assert sunk == pytest.approx(expected_at_surface, rel=1e-6, abs=1e-9 * abs(exact[0][0, 1]))
    a, field = arriving(below, place), waves_inside(waves_of, tissue[place], below[place])
    z = (depth - tops[place]) * np.ones((1, 1))
    parts, lowered = amplitudes(field, z), lowering(field, z)
    E, nu = layers[place][1:]
    mu = E / (2 * (1 + nu))
    for column, state in zip((a[::2], a[1::2]), exact, strict=True):
        p, q = (np.asarray(part).item() for part in column)
        along, _, across = (p * parts[0][0, :, 0, 0] + q * parts[1][0, :, 0, 0]) / (2 * mu)
        w = (p * lowered[0] + q * lowered[1]).item() / (2 * mu)
        U, W, drag, _ = state[1]
        size = abs(U) + abs(W)
        assert [along / k, w] == pytest.approx([U, W], rel=1e-5, abs=1e-6 * size)
        assert 2 * mu * across == pytest.approx(drag, rel=1e-5, abs=1e-6 * mu * k * size)


def cut(scene: Scene, *parts: float) -> Scene:
    """The scene's one material as layers of itself, parts of what covers its inclusion, or of the outer radius."""
    cover = min((body.depth - (body.diameter or 0) / 2 for body in scene.inclusion), default=scene.probe.tube_radius)
    return on(*((1e3 * part * cover, scene.tissue.youngs_modulus, scene.tissue.poisson_ratio) for part in parts), scene=scene)


@pytest.mark.parametrize("parts", [(0.3,), (0.05, 0.1, 0.15)])
@pytest.mark.parametrize("name", ["bonded", "frictionless-large-shallow-inclusion"])
def test_one_material_cut_up_changes_nothing(name: str, parts: tuple[float, ...]) -> None:
    """Loads, fields and images on a half-space, spheres on and beside the axis, and loads on a floor: to rounding."""
    scene = named("half-space", name).scene
    for beside in (0.0, 0.4 * scene.probe.tube_radius):
        moved = scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update={"x": beside}),)})
        whole, found = raw(moved), raw(cut(moved, *parts))
        assert found == pytest.approx(whole, rel=1e-10, abs=1e-10 * np.abs(whole).max())
    floored = named("axisymmetric", "homogeneous").scene
    assert raw(cut(floored, *parts))[0] == pytest.approx(raw(floored)[0], rel=1e-10)


def test_layers_of_one_material_are_one() -> None:
    """Merged, they are the scene without them, bit for bit; and two halves of a layer are the layer."""
    shape, values = parameters(cut(EXAMPLE, 0.2, 0.5))
    whole_shape, whole = parameters(EXAMPLE)
    assert shape == whole_shape
    assert np.array_equal(values, whole)
    one, two = on((1.5, 56e3)), on((0.6, 56e3), (0.9, 56e3))
    assert raw(two, merged=True) == pytest.approx(raw(one), rel=1e-13)
    shape = parameters(one)[0]
    halves, values = parameters(two, merged=False)
    found = np.stack(forces(replace(halves, layer_nodes=60), values[:, None]))
    assert found == pytest.approx(np.stack(forces(replace(shape, layer_nodes=60), parameters(one)[1][:, None])), rel=1e-4)

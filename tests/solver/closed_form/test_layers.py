"""Layers of tissue in the closed form: waves against Navier's equation in many digits, laws, limits, an independent code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.closed_form.speed import compute_gradients
from geometry import Scene, read_scene
from geometry.common.errors import InputError
from geometry.scenes.units import SI_CONTEXT
from solver.closed_form.contact import Tissue, solve_contact
from solver.closed_form.designs import (
    LAYER_PARAMETERS,
    PROBE_PARAMETERS,
    SPHERE_PARAMETERS,
    TISSUE_PARAMETERS,
    build_parameters,
    compute_forces,
)
from solver.closed_form.evaluator import ClosedForm
from solver.closed_form.layer import build_waves_in_layer, compute_fields
from solver.closed_form.layered_spheres import build_sphere_in_layer
from solver.closed_form.layered_works import count_layer_nodes
from solver.closed_form.sphere_moments import ALL_MOMENTS, SphereArray
from solver.closed_form.tractions import ElasticBlocks
from solver.layers.stack import TissueLayer, compute_arriving, compute_compliance_change, compute_echoes
from solver.results.film_forces import compute_result_fields
from tests.support.layered_waves import states
from tests.support.paths import SCENE
from tests.support.references import Expected, expected, named

EXAMPLE = read_scene(SCENE)
OWN = (EXAMPLE.tissue.youngs_modulus, EXAMPLE.tissue.poisson_ratio)
ONE = np.ones(1)
REFERENCES = expected("tissue-layers")
ACROSS = ("sphere-across", "sphere-across-two", "three-layers")  # an interface cuts the sphere


def add_layers(*layers: tuple[float, ...], scene: Scene = EXAMPLE) -> Scene:
    """The scene on layers, (thickness in mm, Young's modulus in Pa, Poisson's ratio of 0.45 unless it is given)."""
    names = ("thickness", "youngs_modulus", "poisson_ratio")
    tables = [dict(zip(names, (1e-3 * layer[0], *layer[1:], 0.45)[:3], strict=True)) for layer in layers]
    data = scene.model_dump(exclude_unset=True)
    return Scene.model_validate(data | {"tissue": data["tissue"] | {"layer": tables}}, context=SI_CONTEXT)


def raw(scene: Scene, *, nodes: int | None = None, merged: bool = False) -> np.ndarray:
    """Forces and derivatives by the formula, every layer on its own."""
    shape, values = build_parameters(scene, merged=merged)
    return np.stack(compute_forces(shape if nodes is None else replace(shape, nodes=nodes), values[:, None]))[:, 0]


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
    echo_below = compute_echoes(waves_of, tissue, True)
    place, tops = len(layers) - 2, np.cumsum([0.0, *(layer[0] for layer in layers)])
    depth = tops[place] + 0.4 * layers[place][0]
    exact = states(k, layers, [0.0, depth])
    near_field = echo_below[0].near_echo
    assert near_field is not None
    sunk = [
        (half_space + part).item() / (2 * mu * k)
        for half_space, part in zip(tissue[0].half_space, compute_compliance_change(tissue[0], near_field), strict=True)
    ]
    expected_at_surface = exact[0][0, 1], exact[1][0, 0], exact[1][0, 1]  # w by p, u by q, w by q
    assert sunk == pytest.approx(expected_at_surface, rel=1e-6, abs=1e-9 * abs(exact[0][0, 1]))
    a, field = compute_arriving(echo_below, place), build_waves_in_layer(waves_of, tissue[place], echo_below[place])
    z = (depth - tops[place]) * np.ones((1, 1))
    pressed, sheared = (np.ravel(strains) for strains in compute_fields(field, z))
    E, nu = layers[place][1:]
    mu = E / (2 * (1 + nu))
    for column, state in zip((a[::2], a[1::2]), exact, strict=True):
        p, q = (np.asarray(part).item() for part in column)
        radial, _, across, w = (p * pressed + q * sheared) / (2 * mu)
        U, W, drag, _ = state[1]
        size = abs(U) + abs(W)
        assert [radial / k, w / k] == pytest.approx([U, W], rel=1e-5, abs=1e-6 * size)
        assert 2 * mu * across == pytest.approx(drag, rel=1e-5, abs=1e-6 * mu * k * size)


def cut(scene: Scene, *parts: float) -> Scene:
    """The scene's one material as layers of itself, parts of what covers its inclusion, or of the outer radius."""
    cover = min((body.depth - (body.diameter or 0) / 2 for body in scene.inclusion), default=scene.probe.tube_radius)
    return add_layers(
        *((1e3 * part * cover, scene.tissue.youngs_modulus, scene.tissue.poisson_ratio) for part in parts), scene=scene
    )


@pytest.mark.parametrize("parts", [(0.3,), (0.05, 0.1, 0.15)])
@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("half-space", "bonded"),
        ("half-space", "frictionless-large-shallow-inclusion"),
        ("axisymmetric", "homogeneous"),
        ("axisymmetric", "shallow"),
        ("extra", "inclusion-near-floor"),
        ("extra", "thin-tissue-layer"),
        ("off-axis", "frictionless-cover-0.25-offset-0.5"),
    ],
)
def test_one_material_cut_up_changes_nothing(folder: str, name: str, parts: tuple[float, ...]) -> None:
    """Loads, fields and images on half-spaces and floors, spheres on and off the axis, and all derivatives: to rounding."""
    scene = named(folder, name).scene
    for distance in (0.0, 0.4 * scene.probe.tube_radius):
        moved = scene.model_copy(update={"inclusion": tuple(body.model_copy(update={"x": distance}) for body in scene.inclusion)})
        whole, divided = raw(moved), raw(cut(moved, *parts))
        assert divided == pytest.approx(whole, rel=1e-10, abs=1e-10 * np.abs(whole).max())
        for whole_slope, divided_slope in zip(derivatives(moved), derivatives(cut(moved, *parts)), strict=True):
            assert divided_slope == pytest.approx(whole_slope, rel=1e-10, abs=1e-10 * np.abs(whole_slope).max())


def derivatives(scene: Scene) -> np.ndarray:
    """Derivatives by the probe's numbers and the inclusions' that are not 0, layers as they stand."""
    shape, values = build_parameters(scene, merged=False)
    first = len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)
    chosen = [*range(len(PROBE_PARAMETERS)), *range(first, first + len(SPHERE_PARAMETERS) * len(shape.on_axis))]
    return compute_gradients(shape, values, [which for which in chosen if values[which]])[1]


def test_layers_of_one_material_are_one() -> None:
    """Merged, they are the scene without them, bit for bit; and two halves of a layer are the layer."""
    shape, values = build_parameters(cut(EXAMPLE, 0.2, 0.5))
    whole_shape, whole = build_parameters(EXAMPLE)
    assert shape == whole_shape
    assert np.array_equal(values, whole)
    single, two = add_layers((1.5, 56e3)), add_layers((0.6, 56e3), (0.9, 56e3))
    assert raw(two, merged=True) == pytest.approx(raw(single), rel=1e-13)
    shape = build_parameters(single)[0]
    halves, values = build_parameters(two, merged=False)
    layered = np.stack(compute_forces(replace(halves, layer_nodes=60), values[:, None]))
    assert layered == pytest.approx(
        np.stack(compute_forces(replace(shape, layer_nodes=60), build_parameters(single)[1][:, None])), rel=1e-4
    )


def test_a_very_thick_layer_is_a_half_space_of_it() -> None:
    """Rock a thousand radii below; a radius over that distance is what it changes."""
    endless = EXAMPLE.tissue.model_dump(exclude_unset=True, exclude={"radius", "depth"}) | {"shape": "half-space"}
    alone = Scene.model_validate(EXAMPLE.model_dump(exclude_unset=True) | {"tissue": endless})
    rock = Scene.model_validate(EXAMPLE.model_dump(exclude_unset=True) | {"tissue": endless | {"youngs_modulus": 1e9}})
    for layered, whole in zip(raw(add_layers((5000.0, *OWN), scene=rock)), raw(alone), strict=True):
        assert layered == pytest.approx(whole, abs=3e-3 * np.abs(whole).max())


@pytest.mark.parametrize("name", ["homogeneous", "shallow"])
def test_a_stiff_layer_below_is_the_rigid_floor(name: str) -> None:
    scene = named("axisymmetric", name).scene
    tissue = scene.tissue
    assert tissue.shape == "cylinder"
    rock = tissue.model_copy(update={"depth": 1.1 * tissue.depth, "youngs_modulus": 1e6 * tissue.youngs_modulus})
    layer = (1e3 * tissue.depth, tissue.youngs_modulus, tissue.poisson_ratio)
    on_rock = raw(add_layers(layer, scene=scene.model_copy(update={"tissue": rock})), nodes=40)
    for computed, whole in zip(on_rock, raw(scene, nodes=40), strict=True):
        assert computed == pytest.approx(whole, abs=2e-4 * np.abs(whole).max())


def punch(nu: float, depth: float, share: float = 0.5) -> tuple[float, float]:
    """Force per indentation of a stiff frictionless probe of radius 1 on a layer over rock, shear modulus 1; the inner share."""
    blocks = (
        ElasticBlocks(None, share * ONE, ONE, 1e9 * ONE, 0 * ONE),
        ElasticBlocks((share + 1e-4) * ONE, ONE, ONE, 1e9 * ONE, 0 * ONE),
    )
    E = 2 * (1 + nu)
    tissue = Tissue(None, 1e6 * E * ONE, 0.3 * ONE, layers=tuple(stack((depth, E, nu))))
    solution = solve_contact(blocks, tissue, [], target=None, bonded=False, nodes=40, layer_nodes=count_layer_nodes(1.0, depth))
    films = solution.forces[0].sum(axis=1)
    return float(films.sum()), float(films[0] / films.sum())


# Fredholm equation of Lebedev and Ufliand, converged: P = 2 E a w kappa / (1 - nu^2), by a/h; the last ratio is 0.499999 here
POISSON = (0.3, 0.4, 0.45, 0.49, 0.499, 0.499999)
KAPPA = {
    0.1: (1.09544, 1.10626, 1.11455, 1.12338, 1.12572, 1.12599),
    0.6: (1.78475, 1.91783, 2.03282, 2.16942, 2.20833, 2.21289),
    1.0: (2.48352, 2.79377, 3.09141, 3.48398, 3.60438, 3.61874),
    2.0: (4.35324, 5.29855, 6.42059, 8.33700, 9.05827, 9.14945),
    4.0: (8.17889, 10.75946, 14.66383, 24.83349, 30.66601, 31.52501),
}
SHARE = {0.1: (0.13413, 0.28610, 0.56436), 1.0: (0.18548, 0.36576, 0.64031), 2.0: (0.23381, 0.44498, 0.71822)}


@pytest.mark.parametrize("ratio", KAPPA)
def test_punch_on_a_layer_over_rock(ratio: float) -> None:
    forces_found = [punch(nu, 1 / ratio)[0] * (1 - nu) / 4 for nu in POISSON]
    assert forces_found == pytest.approx(KAPPA[ratio], rel=0.006)
    if ratio in SHARE:
        shares = [punch(0.45, 1 / ratio, share)[1] for share in (0.5, 0.7, 0.9)]
        assert shares == pytest.approx(SHARE[ratio], rel=0.006)


@pytest.mark.parametrize("on_axis", [True, False])
def test_a_sphere_sees_faces_as_mirrors(on_axis: bool) -> None:
    """Nothing below is a free surface, from below; and at nu = 1/2 a face that is held gives its image with the other sign."""
    x, weight = np.polynomial.legendre.leggauss(60)
    k = 20 * (x[None] + 1)
    weights, nu = 20 * weight * k, 0.49999
    sphere = SphereArray(0.5 * ONE, ONE, 0 * ONE, ONE, 0.3 * ONE, on_axis=on_axis)
    free = build_sphere_in_layer(sphere, k, weights, stack((None, 2 * (1 + nu), nu)), False).image[0]
    far, signs = 30.0, np.array([1, 1, -1, -1, -1, -1, 1, 1, 1, 1, 1])[: len(free)]

    def field_below(E: float) -> np.ndarray:
        deep = replace(sphere, depth=(far - 1) * ONE)
        return build_sphere_in_layer(deep, k, weights, stack((far, 2 * (1 + nu), nu), (None, E, 0.0)), False).image[0]

    def field_above(E: float) -> np.ndarray:
        lowered = replace(sphere, depth=(far + 1) * ONE, layer=1)
        return build_sphere_in_layer(lowered, k, weights, stack((far, E, 0.0), (None, 2 * (1 + nu), nu)), False).image[0]

    tolerance = {"abs": 2e-3 * np.abs(free).max()}
    assert field_below(1e-9) == pytest.approx(free * np.outer(signs, signs), **tolerance)
    assert field_below(1e9) == pytest.approx(-free * np.outer(signs, signs), **tolerance)
    assert field_above(1e-9) == pytest.approx(free, **tolerance)
    assert field_above(1e9) == pytest.approx(-free, **tolerance)
    assert free.shape == ((ALL_MOMENTS, ALL_MOMENTS) if not on_axis else (5, 5))


@pytest.mark.parametrize("reference", REFERENCES, ids=lambda reference: reference.name)
def test_against_an_independent_code(reference: Expected) -> None:
    """NGSolve's results (benchmarks.references.layered_scenes): the true errors are within those that are stated."""
    answer = ClosedForm().compute_films([reference.scene])[0]
    if reference.name in ACROSS:
        assert "interface of layers" in str(answer)
        return
    assert not isinstance(answer, InputError)
    films, error, result = answer.films, answer.errors, compute_result_fields(reference.scene, answer.films)
    assert abs(result["ratio"] / reference.ratio - 1) <= films.ratio_error
    assert abs(result["stiffness"] / reference.stiffness - 1) <= np.expm1(error.largest)
    assert result["ratio"] == pytest.approx(reference.ratio, rel=0.1)
    if reference.log_sensitivity:
        assert abs(result["log_sensitivity"] - reference.log_sensitivity) <= error.sensitivity
        assert result["log_sensitivity"] == pytest.approx(reference.log_sensitivity, rel=0.2)


TRIAL = {(0.5, 12e3): 0.5417, (0.5, 56.3e3): 0.5149, (1.0, 56.3e3): 0.4121, (1.5, 56.3e3): 0.3816, (2.0, 2e5): 0.5236}


@pytest.mark.parametrize("skin", TRIAL)
def test_figures_of_the_trial(skin: tuple[float, float]) -> None:
    """DATA.md's trial of skins on the example, (mm, Pa): the ratio, to what is stated, and to a tenth."""
    (answer,) = ClosedForm().compute_films([add_layers(skin)])
    assert not isinstance(answer, InputError)
    deviation = np.log(compute_result_fields(add_layers(skin), answer.films)["ratio"] / TRIAL[skin])
    assert abs(deviation) <= min(answer.errors.log_ratio, 0.1)


SKINS = ((1.4, 56e3), (2.0, 2e3, 0.49))


@pytest.mark.parametrize("interface", ["bonded", "frictionless"])
@pytest.mark.parametrize("x", [0.0, 3e-3])
def test_laws_and_derivatives(x: float, interface: str) -> None:
    """Reciprocity, scale, stiffness that grows with every modulus; complex steps against differences by every parameter."""
    data = add_layers(*SKINS).model_dump(exclude_unset=True)
    data["inclusion"] = [EXAMPLE.inclusion[0].model_dump(exclude_unset=True) | {"x": x, "diameter": 4e-3}]
    scene = Scene.model_validate(data | {"contact": {"interface": interface}})
    shape, values = build_parameters(scene)
    assert shape.sphere_layers == (2,)
    chosen = [k for k, value in enumerate(values) if value]
    values_found, derivatives = compute_gradients(shape, values, chosen)
    assert values_found == pytest.approx(raw(scene), rel=1e-12)
    assert values_found[0, 0, 1] == pytest.approx(values_found[0, 1, 0], rel=1e-8)
    names = (*PROBE_PARAMETERS, *TISSUE_PARAMETERS, *SPHERE_PARAMETERS, *LAYER_PARAMETERS * 2)
    grows = [
        derivative[0].sum()
        for k, derivative in zip(chosen, derivatives, strict=True)
        if names[k].endswith("modulus") and names[k] != "modulus"
    ]
    assert len(grows) == 5
    assert min(grows) > 0
    lengths = [not name.endswith(("modulus", "poisson")) for name in names]
    assert np.stack(compute_forces(shape, np.where(lengths, 3 * values, values)[:, None]))[:, 0] == pytest.approx(
        3 * values_found, rel=1e-9
    )
    for k, exact in zip(chosen, derivatives, strict=True):
        moved = np.stack(
            [np.where(np.arange(len(values)) == k, values * factor, values) for factor in (1 + 1e-5, 1 - 1e-5)], axis=1
        )
        ahead, behind = np.stack(compute_forces(shape, moved), axis=1)
        by_parts = (ahead - behind) / (2e-5 * values[k])
        size = np.abs(values_found).max() / values[k]
        assert exact == pytest.approx(by_parts, rel=1e-3, abs=1e-4 * np.abs(by_parts).max() + 1e-6 * size), names[k]


def test_many_are_answered_as_each_on_its_own() -> None:
    """Bit for bit, layers on and off the axis among scenes of one material."""
    off_axis = EXAMPLE.model_copy(update={"inclusion": (EXAMPLE.inclusion[0].model_copy(update={"x": 3e-3}),)})
    scenes = [
        add_layers(*[(h, 56e3), (0.5, 2e3)][:count], scene=scene)
        for h in (0.5, 1.4)
        for count in (1, 2)
        for scene in (EXAMPLE, off_axis)
    ]
    scenes += [EXAMPLE, off_axis, add_layers((1.1, 40e3))]
    together = ClosedForm().compute_films(scenes)
    for scene, answer in zip(scenes, together, strict=True):
        (alone,) = ClosedForm().compute_films([scene])
        assert not isinstance(alone, InputError)
        assert not isinstance(answer, InputError)
        assert np.array_equal(alone.films.forces, answer.films.forces)
        assert alone.errors.log_ratio == answer.errors.log_ratio


@pytest.mark.parametrize(("thickness_mm", "modulus"), [(0.06, 300.0), (0.1, 200.0), (0.3, 300.0)])
def test_nodes_resolve_a_soft_layer_under_a_thin_wall(thickness_mm: float, modulus: float) -> None:
    """A layer that blocks squeeze makes short waves count: with fewer nodes the ratio was off by a tenth to a third."""
    probe = EXAMPLE.probe.model_copy(update={"area_ratio": 3.0})
    bare = EXAMPLE.model_copy(update={"inclusion": (), "probe": probe})
    shape, values = build_parameters(add_layers((thickness_mm, modulus, 0.49), scene=bare))
    fine, used = (
        compute_forces(replace(shape, layer_nodes=nodes), values[:, None])[0][0].sum(axis=1)
        for nodes in (4 * shape.layer_nodes, shape.layer_nodes)
    )
    assert used[0] / used[1] == pytest.approx(fine[0] / fine[1], rel=0.03)


def test_a_search_keeps_to_what_its_nodes_resolve() -> None:
    """Blocks three times as wide as those that the nodes were counted for: 1 %, where summing shorter waves was 6 % off."""
    shape, values = build_parameters(add_layers((1.5, 56e3), scene=EXAMPLE.model_copy(update={"inclusion": ()})))
    wide = np.where(
        [name in ("inner_radius", "outer_radius") for name in (*PROBE_PARAMETERS, *TISSUE_PARAMETERS, *LAYER_PARAMETERS)],
        3 * values,
        values,
    )
    fine, coarse = (
        compute_forces(replace(shape, layer_nodes=nodes), wide[:, None])[0].sum(axis=2) for nodes in (80, shape.layer_nodes)
    )
    assert shape.layer_nodes <= 20
    assert coarse == pytest.approx(fine, rel=0.01)


def test_tall_narrow_layers_are_a_column() -> None:
    """What ten radii more of a stiffer layer below give way: those of a column under uniaxial stress."""

    def gives_way(below: float) -> float:
        blocks = (
            ElasticBlocks(None, 0.5 * ONE, ONE, 1e6 * ONE, 0 * ONE),
            ElasticBlocks(0.501 * ONE, ONE, ONE, 1e6 * ONE, 0 * ONE),
        )
        tissue = Tissue((10 + below) * ONE, 3 * ONE, 0.3 * ONE, 1.2 * ONE, layers=tuple(stack((10.0, 1.0, 0.3))))
        solution = solve_contact(
            blocks, tissue, [], target=None, bonded=True, nodes=40, side_nodes=40, layer_nodes=count_layer_nodes(1.0, 10.0)
        )
        return float(1 / solution.forces.sum())

    assert gives_way(20.0) - gives_way(10.0) == pytest.approx(10 / (3 * np.pi * 1.2**2), rel=0.1)

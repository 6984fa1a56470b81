"""Differentiate first-order forces, charges, ratios and log-sensitivities exactly by every number, with tumours anywhere.

With u the base states, K the stiffness matrix and G the matrix of eq. EI.1, F = u^T K u + u^T G u. The states minimise the first
term but not the second, so that one more solve with their polarisation as load, K l = G u, takes their change into account,

    dF = u^T dK u + u^T dG u - l^T dK u - u^T dK l                                                 (EI.4)

and another one for the log-sensitivity, whose matrix G' = dG / d ln E belongs to the target alone. A charge is the same form of a
film state s and the sum U of both base states. The film's lift, which changes by ds as the film does, adds ds^T K (U - l) to its
derivative, and -ds^T K l' to that of its derivative by ln E, with K l' = G' U. The mesh moves with the
design under tumours that stay: dG is a complex step (``gradient_points.py``). Where a point passes from one element to the
next, strains, and with them the outputs, jump by the mesh's error, about 1e-6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.meridian.mesh_lines import Kind, MeridianFineness
from geometry.meridian.section import LAYERS, TISSUES, Body
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.base_states import BaseStates, MeridianModel, build_model, solve_base_states
from solver.axisymmetric.energy_derivatives import differentiate_totals, list_variables
from solver.axisymmetric.film_states import COMPLEX_STEP, differentiate_film_lift
from solver.axisymmetric.gradients import (
    Gradients,
    choose_variables,
    compute_outputs,
    differentiate_areas,
    differentiate_by_scene,
    differentiate_outputs,
    list_lift_variables,
)
from solver.axisymmetric.sections import Sections
from solver.equivalent_inclusion.gradient_points import STRAIN_METRIC, QuadraturePoints
from solver.equivalent_inclusion.probe_on_tissue import FIELD_FINENESSES, get_tied_interface
from solver.inclusions.eshelby import compute_strengths
from solver.inclusions.tumours import Strata, Tumours

Strengths = tuple[Any, Any]  # k_v and k_d of every tumour


@dataclass(frozen=True)
class FirstOrder:
    """Film forces of one scene on one mesh to first order, and what their derivatives need.

    Attributes
    ----------
    states
        Base states without tumours.
    points
        Points of the tumours' quadratures.
    tumours
        The tumours, arrays of shape (t,).
    target
        The number of the target among them, or None.
    strata
        The tissue's materials by depth.
    """

    states: BaseStates
    points: QuadraturePoints
    tumours: Tumours
    target: int | None
    strata: Strata

    def compute_share(self, body: Body) -> Any:
        """Return 1.0 for the tumours that lie in a body of the tissue (a layer, or what is below all), else 0.0, shape (t,)."""
        layers = len(self.strata.interfaces)
        number = layers if body == Body.TISSUE else LAYERS.index(body) if body in LAYERS[:layers] else -1
        return 1.0 * (self.strata.find_layer(self.tumours.depth) == number)

    def compute_form(self, strengths: Strengths, corners: Any = None, moved: Any = 0.0) -> Any:
        """Return u^T G u (eq. EI.4) of s states with the base states, shape (s, 2).

        The strengths are given; corners may be complex and points moved.
        """
        return self._integrate_forms((strengths,), corners, moved)[0]

    def _integrate_forms(self, all_strengths: Sequence[Strengths], corners: Any, moved: Any) -> Any:
        """Return the forms of ``compute_form`` for each of k strengths, shape (k, s, 2)."""
        strain, dilation = self._evaluate_at_points(
            *self.points.compute_forms(self._corners if corners is None else corners, moved)
        )
        sums, forms = strain[:, :3].sum(axis=1), []
        for strengths in all_strengths:
            volume, shear = (np.asarray(k)[self.points.tumour] * self.points.weight for k in strengths)
            form = np.einsum("q,qi,qj->ij", volume, dilation, dilation[:, :2])
            form = form - np.einsum("q,qi,qj->ij", shear / 3, sums, sums[:, :2])
            forms.append(form + np.einsum("q,a,qai,qaj->ij", shear, STRAIN_METRIC, strain, strain[..., :2]))
        return np.array(forms)

    def solve_adjoints(self) -> list[Floats]:
        """Solve K l = G u and K l' = G' u of eq. EI.4; return the values of l and l' in n elements, (n, 2 functions, s) each."""
        m, points = self.states.model, self.points
        strain_form, dilation_form = points.compute_forms(self._corners)
        strain, dilation = self._evaluate_at_points(strain_form, dilation_form)
        parts = []
        for strengths in self.compute_strengths():
            volume, shear = (np.asarray(k)[points.tumour] * points.weight for k in strengths)
            loads = np.einsum("q,qi,qcs->qcsi", volume, dilation, dilation_form)
            loads -= np.einsum("q,qi,qcs->qcsi", shear / 3, strain[:, :3].sum(axis=1), strain_form[:, :3].sum(axis=1))
            loads += np.einsum("q,a,qai,qacs->qcsi", shear, STRAIN_METRIC, strain, strain_form, optimize=True)
            parts.append(loads)
        both = np.concatenate(parts, axis=-1)
        element_loads = np.zeros((len(points.elements), *both.shape[1:]))
        np.add.at(element_loads, points.row, both)
        return np.split(_solve_loads(m, points.elements, element_loads), 2, axis=-1)

    @property
    def _corners(self) -> Floats:
        """Corners of the elements with quadrature points, in the section itself."""
        return np.asarray(self.points.compute_corners(self.states.model.section))

    def _evaluate_at_points(self, strain: Any, dilation: Any) -> tuple[Any, Any]:
        """Return strain and dilation of the s states at the points, from the forms of ``QuadraturePoints.compute_forms``."""
        element_values = self.states.values[self.points.element].reshape(len(self.points.r), 2, -1, len(self.states.products))
        return (
            np.einsum("qacs,qcsi->qai", strain, element_values, optimize=True),
            np.einsum("qcs,qcsi->qi", dilation, element_values, optimize=True),
        )

    def compute_strengths(self, **changed: Any) -> tuple[Strengths, Strengths]:
        """Return k_v and k_d of all tumours, and their derivatives by ln E of the target (0 for the others).

        Parameters
        ----------
        changed
            Perhaps complex values that take the place of modulus, nu (of the tissue about each tumour), youngs_modulus,
            poisson_ratio (of the tumours).
        """
        t, hosts = self.tumours, self.strata.find_hosts(self.tumours.depth)
        moduli: dict[str, object] = {"modulus": hosts.youngs_modulus, "nu": hosts.poisson_ratio}
        moduli |= {"youngs_modulus": t.youngs_modulus, "poisson_ratio": t.poisson_ratio}
        strengths, (volume, shear) = compute_strengths(**{**moduli, **changed})
        is_target = np.arange(len(t.x)) == self.target
        return strengths, (volume * is_target, shear * is_target)

    def compute_forms(self, corners: Any = None, moved: Any = 0.0, **changed: Any) -> Any:
        """Return u^T G u and u^T G' u (eq. EI.4), shape (2, s, 2), perhaps with complex corners, points or moduli."""
        return self._integrate_forms(self.compute_strengths(**changed), corners, moved)


def _solve_loads(model: MeridianModel, elements: Any, loads: Floats) -> Floats:
    """Solve for displacements under loads on e elements, with the base states' supports.

    ``loads`` are on 2 components of s functions, (e, 2, s, k). Returns the values in all n elements, (n, 2 s, k). Loads inside
    elements are condensed to their edges first; what these loads alone move inside is added at the end.
    """
    count, _, s, k = loads.shape
    edge = model.shapes.skeleton
    inside = loads[:, :, edge:].reshape(count, -1, k)  # the functions from ``edge`` on are 0 on the elements' edges
    on_edges = np.zeros((len(model.condensed.stiffness), 2 * edge, k))
    recovery = model.condensed.compute_recovery(elements).transpose(0, 2, 1)
    on_edges[elements] = loads[:, :, :edge].reshape(count, -1, k) + recovery @ inside
    v = model.system.solve(model.system.assemble_forces(on_edges), passes=2).v
    values = model.recover_values(model.system.compute_values(v))
    inner = model.build_blocks(elements).inside  # the elements' stiffness of the inner functions
    shaped = values.reshape(len(values), 2, s, k)
    shaped[elements, :, edge:] += np.linalg.solve(inner, inside).reshape(count, 2, s - edge, k)
    return shaped.reshape(values.shape)


def solve_first_order(
    scene: Scene, sections: Sections, fineness: MeridianFineness = FIELD_FINENESSES[0], kind: Kind | None = None
) -> FirstOrder:
    """Solve the states of sections without tumours and place the scene's spheres in them.

    Charges need the film states, and so sections with films (``add_details``).

    Raises
    ------
    SolveError
        The equations cannot be solved in double precision.
    """
    materials: dict[Body, Material] = {body: material for body, material in sections.materials.items() if body != Body.INCLUSION}
    section = replace(sections.section, sphere_radius=0.0, sphere_depth=0.0)
    interface = get_tied_interface(scene)
    states = solve_base_states(build_model(section, materials, interface, fineness, kind=kind, films=sections.films))
    tumours = Tumours.from_scene(scene).flatten()
    return FirstOrder(
        states, QuadraturePoints.from_tumours(states, tumours), tumours, scene.target, Strata.from_tissue(scene.tissue)
    )


def compute_tumour_gradients(scene: Scene, solution: FirstOrder, names: tuple[str, ...]) -> Gradients:
    """Differentiate first-order outputs at a fixed topology of the mesh, see ``solver.axisymmetric.gradients.compute_gradients``.

    Raises
    ------
    InputError
        A name is none of the scene's variables.
    """
    names = choose_variables(scene, solution.states.model, names)
    values_now = solution.compute_forms()
    values_now[0] += solution.states.products
    model = solution.states.model
    rows = [differentiate_by_scene(scene, model, name) for name in names]
    chain = np.array(rows).reshape(len(names), len(list_variables(model)))
    is_needed = np.asarray(chain.any(axis=0))  # none is for the outputs alone, or for a tumour's own quantities
    by_section = (
        _differentiate_by_section(solution, is_needed) if is_needed.any() else np.zeros((chain.shape[1], *values_now.shape[:2]))
    )
    changes = np.einsum("nv,vki->nki", chain, by_section)
    for k, name in enumerate(names):
        if name.startswith("inclusion."):
            changes[k] = _differentiate_by_tumour(solution, name.removeprefix("inclusion.")).sum(axis=2)
    return _build_outputs(scene, solution, names, now=values_now, changes=changes, chain=chain)


def _differentiate_by_section(solution: FirstOrder, is_needed: Bools) -> Floats:
    """Return derivatives with respect to the section's v variables by eq. EI.4, shape (v, 2, s); only those needed are right.

    The second index is 0 for the films' totals and 1 for their derivatives with respect to ln E of the target, the last is that
    of the film's force or charge.
    """
    model, s = solution.states.model, len(solution.states.products)
    adjoints = solution.solve_adjoints()
    basis = np.concatenate([solution.states.values, *adjoints], axis=-1)
    unit = np.eye(3 * s)
    both = [unit[k] + unit[k + 1] for k in range(0, 3 * s, s)]  # U, and the sums of both base states' adjoints
    energies, changes = [], []  # by film, of forces and then of charges
    for k in (0, *range(2, s)):
        # a state and its two adjoints, each with what is left of the sum: for the forces the other base state
        pairs = np.array([[unit[k + low], total - unit[k + low]] for low, total in zip((0, s, 2 * s), both, strict=True)])
        pairs = pairs.transpose(0, 2, 1)
        energy = differentiate_totals(model, basis, pairs[:1], pairs[1:], Body.INCLUSION)[0]
        films = slice(0, 2) if k == 0 else slice(0, 1)
        energies.append(energy.totals[0][:, films])
        changes.append(energy.changes[..., films])
    derivatives = -np.concatenate(changes, axis=-1).transpose(1, 0, 2)
    names = list_variables(model)
    for k in np.flatnonzero(is_needed).tolist():
        derivatives[k] += _differentiate_explicit(solution, names[k]).sum(axis=2)
    derivatives[:, 0] += np.concatenate(energies, axis=-1)
    if s > 2:
        derivatives[list_lift_variables(model), :, 2:] += _differentiate_lifts(solution, adjoints)
    return derivatives


def _differentiate_lifts(solution: FirstOrder, adjoints: Sequence[Floats]) -> Floats:
    """Return what the change of the films' lifts adds to derivatives of charges, see eq. EI.4, shape (lengths + 4, 2, 2).

    ``adjoints`` are the values of l and l' in all elements, shape (n, 2 functions, s) each.
    """
    model = solution.states.model
    assert model.films is not None
    skeleton = model.shapes.skeleton
    fields = [
        values[..., :2].sum(axis=-1).reshape(len(values), 2, -1)[..., :skeleton].reshape(len(values), -1)
        for values in (solution.states.values, *adjoints)
    ]
    loaded = np.stack([fields[0] - fields[1], -fields[2]], axis=-1)  # U - l and -l' on corners and edges, (n, 8 p, 2)
    lifts = differentiate_film_lift(model.section, model.mesh, skeleton, model.films)
    parts = [np.einsum("vcp,cpk->vk", changes, model.system.stiffness[chosen] @ loaded[chosen]) for chosen, changes in lifts]
    return np.stack(parts, axis=-1)


def _differentiate_explicit(solution: FirstOrder, name: str) -> Floats:
    """Return the derivatives of u^T G u and u^T G' u with respect to a variable of the section at fixed u, shape (2, s, 2)."""
    section, hosts = solution.states.model.section, solution.strata.find_hosts(solution.tumours.depth)
    for body in TISSUES:
        step = 1j * COMPLEX_STEP * solution.compute_share(body)
        if name == f"{body.name.lower()}_youngs_modulus":
            return _extract_derivative(solution.compute_forms(modulus=hosts.youngs_modulus * (1 + step)))
        if name == f"{body.name.lower()}_poisson_ratio":
            return _extract_derivative(solution.compute_forms(nu=hosts.poisson_ratio + step))
    if name not in section.lengths:
        return np.zeros((2, *solution.states.products.shape))
    moved = replace(section, **{name: getattr(section, name) * (1 + 1j * COMPLEX_STEP)})
    return _extract_derivative(solution.compute_forms(solution.points.compute_corners(moved)))


def _differentiate_by_tumour(solution: FirstOrder, quantity: str) -> Floats:
    """Return the derivatives of u^T G u and u^T G' u with respect to a quantity of the only tumour, shape (2, s, 2)."""
    points, tumours, step = solution.points, solution.tumours, 1j * COMPLEX_STEP
    if quantity == "youngs_modulus":
        by_log_modulus = _extract_derivative(solution.compute_forms(youngs_modulus=tumours.youngs_modulus * (1 + step)))
        return np.asarray(by_log_modulus / tumours.youngs_modulus[0])
    if quantity == "poisson_ratio":
        return _extract_derivative(solution.compute_forms(poisson_ratio=tumours.poisson_ratio + step))
    if quantity == "depth":
        return _extract_derivative(solution.compute_forms(moved=step * points.by_depth))
    moved = _extract_derivative(solution.compute_forms(moved=step * points.by_log_diameter))
    return np.asarray((moved + 3 * solution.compute_forms()) / tumours.diameter[0])  # the volume grows with the diameter's cube


def _extract_derivative(values: Any) -> Floats:
    """Return the derivative of a function from its ``values`` at a step of i times ``COMPLEX_STEP``."""
    return np.asarray(np.imag(values) / COMPLEX_STEP)


def _build_outputs(
    scene: Scene, solution: FirstOrder, names: tuple[str, ...], *, now: Floats, changes: Floats, chain: Floats
) -> Gradients:
    """Convert film forces and their derivatives to the outputs and the outputs' derivatives with respect to n variables.

    Parameters
    ----------
    scene
        The scene, of which load and end areas of the blocks are used.
    solution
        Film forces to first order.
    names
        Names of the variables.
    now
        Film forces and charges, and their derivatives with respect to ln E of the target, shape (2, s, 2).
    changes
        Derivatives of the totals of ``now`` with respect to the variables, shape (n, 2, s).
    chain
        Derivatives of the section's variables with respect to these, shape (n, v).
    """
    totals, derivatives_by_modulus = now.sum(axis=2)
    logs, sensitivity = changes[:, 0] / totals, derivatives_by_modulus / totals
    d_sensitivity = changes[:, 1] / totals - sensitivity * logs
    outputs = compute_outputs(scene, totals[None], (sensitivity[::2] - sensitivity[1::2])[None])
    derivatives = differentiate_outputs(
        scene,
        outputs,
        totals[None],
        logs=logs[None],
        sensitivities=(d_sensitivity[:, ::2] - d_sensitivity[:, 1::2])[None],
        log_areas=chain @ differentiate_areas(scene, solution.states.model),
    )
    return Gradients(names, outputs, derivatives)

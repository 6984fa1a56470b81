"""Correct for ellipsoids to first order: elsewhere the evaluator represents them by spheres of equal volume."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.common.limits import format_maximum_mm
from geometry.scenes.fit_check import compute_semi_axes
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from solver.equivalent_inclusion.first_order import build_whole_ball, compute_effects
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.eshelby import compute_polarisation
from solver.inclusions.tumours import Strata, Tumours
from solver.materials.linear import Isotropic
from solver.results.film_forces import FilmForces

BALL_POINTS = (4, 7, 14)  # along radius, height and the full azimuth
SHAPE_SAFETY_FACTOR = 2.0  # times the relative change from sphere to ellipsoid: how much their reflections may differ
MIN_REFLECTION_SHARE = 0.2  # of the reflections: minimum of that difference
MAX_REFLECTION_CHANGE = 0.5  # of the effect, where the longest semi-axis equals the distance to a face
SATURATION_SHARE = 0.1  # of the derivative by the modulus, which saturates differently in an ellipsoid


@dataclass(frozen=True)
class ShapeCorrection:
    """Correction from the sphere of equal volume to an ellipsoid, of the energy products of the s states, shapes (s, s).

    Attributes
    ----------
    products
        Change of the energy products by the ellipsoid minus the change by the sphere.
    derivative
        Derivative of that with respect to ln E of the body.
    sphere_slope
        Derivative of the sphere's change with respect to ln E.
    relative_size
        Size of ``products`` relative to the sphere's change, for the film forces.
    ellipsoid_products
        First-order change of the energy products by the ellipsoid.
    """

    products: Floats
    derivative: Floats
    sphere_slope: Floats
    relative_size: float
    ellipsoid_products: Floats


def check_ellipsoids(scene: Scene) -> None:
    """Refuse ellipsoids that no sphere of equal volume can represent.

    Raises
    ------
    Refusal
        The sphere of an ellipsoid's volume leaves the tissue or touches another body.
    """
    if all(body.diameter is not None for body in scene.inclusion):
        return
    spheres = Tumours.from_scene(scene)
    radius, places = spheres.diameter[0] / 2, np.stack([spheres.x, spheres.y, spheres.depth])[:, 0]
    gaps = np.linalg.norm(places[:, :, None] - places[:, None], axis=0) - radius[:, None] - radius
    np.fill_diagonal(gaps, np.inf)
    outside = (
        np.any(spheres.cover <= 0)
        or np.any(spheres.depth[0] + radius >= scene.tissue.bottom)
        or np.any(Strata.from_tissue(scene.tissue).compute_gap(spheres) <= 0)
    )
    if outside or np.any(gaps <= 0):
        allowed = "ellipsoids whose spheres of equal volume lie inside the tissue and apart from other bodies; or solid"
        raise Refusal("diameters", Words("an ellipsoid near a surface or another body"), allowed)


def correct_for_ellipsoids(base: Undisturbed, scene: Scene, readings: Readings) -> Readings:
    """Correct one set's readings, computed with spheres of equal volumes, for a scene's ellipsoids; the error bounds grow.

    To first order the difference is the integral of eq. IN.1 over the ellipsoid minus eq. EI.1. Reflections stay the spheres'.

    Raises
    ------
    Refusal
        See ``compute_hill_tensor``.
    """
    changes = {k: compute_shape_correction(base, scene, body) for k, body in enumerate(scene.inclusion) if body.diameter is None}
    parts = [
        _correct_part(base, scene, part, observable, changes)
        for part, observable in zip(readings.parts, base.observables, strict=True)
    ]
    corrected = replace(parts[0], charges=parts[1]) if len(parts) > 1 else parts[0]
    return corrected.add_baseline_bounds(base.films)


def _correct_part(
    base: Undisturbed,
    scene: Scene,
    readings: Readings,
    observable: tuple[FilmForces, slice, float],
    changes: dict[int, ShapeCorrection],
) -> Readings:
    """Correct forces or charges, of which ``observable`` is one of ``base.observables``, for ellipsoids.

    ``changes`` are the corrections by the number of the inclusion. The returned bounds are those of the tumours' effects.
    """
    films, rows, unit = observable
    forces, bound, slope_bound = (values.copy() for values in (readings.forces, readings.bound, readings.slope_bound))
    derivatives, target = dict(readings.derivatives), scene.target or 0
    for k, change in changes.items():
        products, derivative, sphere_slope = (
            unit * values[rows, :2] for values in (change.products, change.derivative, change.sphere_slope)
        )
        margin = SHAPE_SAFETY_FACTOR * change.relative_size + MIN_REFLECTION_SHARE  # of the reflections
        reflection_change = unit * _bound_reflection_change(base, scene.inclusion[k], change)[rows]
        reflections = np.abs(readings.forces[0].sum(axis=1) - readings.first_totals[0])
        forces[0] += products
        bound[0] += margin * reflections + 0.01 * np.abs(products.sum(axis=1)) + reflection_change
        if k == target and derivatives:
            reflected_slopes = np.abs((derivatives["youngs_modulus"][0] - sphere_slope).sum(axis=1))
            derivatives["youngs_modulus"] = derivatives["youngs_modulus"] + derivative
            target_slopes = np.abs(derivatives["youngs_modulus"][0].sum(axis=1))
            slope_bound[0] += margin * reflected_slopes + SATURATION_SHARE * target_slopes + reflection_change
    only_tumours = bound - films.bound.totals  # add_baseline_bounds adds them again, with the new forces
    return replace(readings, forces=forces, bound=only_tumours, derivatives=derivatives, slope_bound=slope_bound)


def _bound_reflection_change(base: Undisturbed, body: Inclusion, change: ShapeCorrection) -> Floats:
    """Bound how an ellipsoid's reflections differ from those of the sphere of equal volume, each total, shape (s,).

    The bound is a fraction of the effect that grows with the ratio of the longest semi-axis to the distance of surface, bottom or
    interface, and with the aspect ratio.
    Spheroids on the axis (aspect 1.3 to 16, contrast 1e-7 to 1e4) need up to 0.7 of it by finite elements.
    """
    lengths = np.array(body.diameters or (1.0,)) / 2
    faces = (0.0, *base.strata.interfaces, base.field.states.model.section.tissue_depth)
    face_distance = min(abs(face - body.depth) for face in faces)
    shape = min(1.0, 2 * float(np.log(lengths.max() / lengths.min())))
    fraction = MAX_REFLECTION_CHANGE * shape * min(1.0, float(lengths.max() / face_distance) ** 3)
    products = change.ellipsoid_products
    return np.asarray(fraction * np.sqrt(np.abs(np.diag(products) * products[:2, :2].sum())))


def compute_shape_correction(base: Undisturbed, scene: Scene, body: Inclusion) -> ShapeCorrection:
    """Compute the first-order difference between an ellipsoid and the sphere of equal volume.

    Raises
    ------
    Refusal
        The ellipsoid reaches beyond the modelled tissue; see also ``compute_hill_tensor``.
    """
    placement, axes = scene.placement, np.array(compute_semi_axes(body))
    points, weights = build_whole_ball(*BALL_POINTS)
    x, y, z = (points @ axes.T + np.array([body.x - placement.x, body.y - placement.y, -body.depth])).T
    section, reach = base.field.states.model.section, np.hypot(x, y).max()
    if reach > section.tissue_radius or z.max() > 0 or -z.min() > section.tissue_depth:
        position = f"one that reaches {format_mm(float(reach))} from the probe's axis and {format_mm(float(-z.min()))} deep"
        allowed = (
            f"ellipsoids within {format_maximum_mm(section.tissue_radius)} and "
            f"{format_maximum_mm(section.tissue_depth)}; or solid"
        )
        raise Refusal("diameters", Words(position), allowed)
    strain, host = _compute_cartesian_strain(base, x, y, z), base.scene.tissue.find_material(body.depth)
    volume = 4 / 3 * np.pi * abs(float(np.linalg.det(axes)))
    products, derivative = (
        volume * np.einsum("q,qai,ab,qbj->ij", weights, strain, k, strain, optimize=True)
        for k in compute_polarisation(Isotropic.from_material(host), Isotropic.from_material(body), axes)
    )
    sphere = compute_effects(base.energies, host, Tumours.from_scene(scene.model_copy(update={"inclusion": (body,)})).flatten())
    sphere_size, difference = np.abs(sphere.forces[0]).sum(), products - sphere.products[0]
    relative_size = float(np.abs(difference[:2, :2]).sum() / sphere_size) if sphere_size > 0 else 0.0
    sphere_slope = sphere.derivatives["youngs_modulus"][0]
    return ShapeCorrection(difference, derivative - sphere_slope, sphere_slope, relative_size, products)


def _compute_cartesian_strain(base: Undisturbed, x: Floats, y: Floats, z: Floats) -> Floats:
    """Return strains xx, yy, zz, 2 yz, 2 xz, 2 xy of the s states at points x, y, z, m, shape (q, 6, s)."""
    r = np.hypot(x, y)
    strains = base.field.evaluate(r, z)
    cos, sin = (np.divide(part, r, out=np.full_like(r, limit), where=r > 0)[:, None] for part, limit in ((x, 1.0), (y, 0.0)))
    rr, zz, hoop, rz = strains.strain.transpose(1, 0, 2)
    excess = (strains.dilation - rr - zz - hoop) / 3  # the dilation is more accurate than the trace: it replaces that
    xx, yy = cos**2 * rr + sin**2 * hoop, sin**2 * rr + cos**2 * hoop
    normal = [part + excess for part in (xx, yy, zz)]
    return np.stack([*normal, 2 * sin * rz, 2 * cos * rz, 2 * cos * sin * (rr - hoop)], axis=1)

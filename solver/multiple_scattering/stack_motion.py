"""Compute how stacks of film and bonds deform as actuators, without blocks, by which their charges follow from tractions.

With the charge as a functional of the film's stress (eq. AX.14), its film state is the displacement under the forces of a uniform
strain (d31, d32, d33) / t of the electrode, t the film's thickness. Let w be that displacement at the stack's lower face while
no block holds it. By reciprocity the charge is the work on w of the tractions between block and stack, or

    Q = -a(s, u),  s the state in which the upper end of the block has the displacement w          (MS.12)

The strain is the sum of (d_p, d_p, d33) / t and (d_m, -d_m, 0) / t with d_p = (d31 + d32) / 2 and d_m = (d31 - d32) / 2. With
theta the angle from the x axis, along which d31 acts,

    w_r = U_0 + U_2 cos 2 theta,  w_theta = V_2 sin 2 theta,  w_z = W_0 + W_2 cos 2 theta           (MS.13)

The first part is solved on the meridian mesh of a scene with blocks and tissue so soft that they hold nothing, the second on that
of stacks and base alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.meridian.mesh import Topology, compute_nodes
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import BLOCKS, LAYERS, STACKS, TISSUES, Body
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import CylinderTissue, Placement
from solver.axisymmetric.base_states import MeridianModel, build_model
from solver.axisymmetric.film_states import build_film_lift
from solver.axisymmetric.sections import add_details, build_sections
from solver.elements.shape_functions import evaluate_functions
from solver.linalg.workspace import keep_result, keep_within_limits
from solver.multiple_scattering.azimuthal_systems import AzimuthalSystems

STRIP_FINENESS = MeridianFineness(1, 3, 4)  # work on the blocks' tractions within 1.3e-3 of that of (1, 6, 8)
SOFT_RELATIVE = 1e-7  # modulus of blocks and tissue, of the softest of films and bonds: their effect on w is as small
TISSUE_RADII = 3.0  # outer radii: size of the tissue, which only completes the mesh
PLACES_PER_SIDE = 9  # points on an element's side at which w is tabulated
DEVIATORIC_ORDER = 2  # azimuthal order of the strain (d_m, -d_m, 0)
HEIGHT_TOLERANCE_RELATIVE = 1e-9  # of a block's height: points as near to its upper end lie on it


@dataclass(frozen=True)
class StackMotion:
    """The displacements w of the upper ends of the blocks by both films as actuators, at n radii of both blocks.

    Attributes
    ----------
    radius
        Of the points of each block, rising, m, one array of shape (n,) for each block.
    mean
        U_0 and W_0 of eq. MS.13 at these points, by inner and outer film, ``CHARGE_UNIT`` per N, shape (n, 2, 2).
    double
        U_2, V_2 and W_2 likewise, shape (n, 3, 2).
    """

    radius: tuple[Floats, Floats]
    mean: tuple[Floats, Floats]
    double: tuple[Floats, Floats]

    def evaluate(self, block: int, points: Floats, turn: float, mirrored: bool) -> Floats:
        """Return w at points of the upper end of a block, ``CHARGE_UNIT`` per N, shape (n, 3, 2): point, axis, film.

        Parameters
        ----------
        block
            0 for the inner block, 1 for the outer.
        points
            x and y, m, shape (n, 2).
        turn
            Angle by which the x axis of the points leads that along which d31 acts, rad.
        mirrored
            Whether the points stand for their mirror images in y = 0, too: then the part of w that is odd there is left out.
        """
        x, y = points.T
        r = np.hypot(x, y)
        cosine, sine = np.divide(points.T, r, out=np.stack([np.ones_like(r), np.zeros_like(r)]), where=r > 0)
        double_angle = 2 * np.arctan2(sine, cosine)
        even, odd = np.cos(double_angle), np.sin(double_angle)
        along, across = np.cos(2 * turn), 0.0 if mirrored else np.sin(2 * turn)
        cosine_part, sine_part = along * even - across * odd, along * odd + across * even
        radial, vertical = (self._interpolate(block, self.mean[block][:, k], r) for k in (0, 1))
        radial_2, around_2, vertical_2 = (self._interpolate(block, self.double[block][:, k], r) for k in (0, 1, 2))
        w_r = radial + radial_2 * cosine_part[:, None]
        w_theta = around_2 * sine_part[:, None]
        w_x, w_y = (
            cosine[:, None] * w_r - sine[:, None] * w_theta,
            sine[:, None] * w_r + cosine[:, None] * w_theta,
        )
        return np.stack([w_x, w_y, vertical + vertical_2 * cosine_part[:, None]], axis=1)

    def _interpolate(self, block: int, values: Floats, r: Floats) -> Floats:
        """Return values of both films, given at the radii of a block, (n, 2), at other radii r."""
        return np.stack([np.interp(r, self.radius[block], column) for column in values.T], axis=1)


@keep_within_limits
def compute_stack_motion(scene: Scene) -> StackMotion:
    """Compute the displacements of the blocks' upper ends by the films of a scene as actuators.

    Raises
    ------
    SolveError
        The equations cannot be solved in double precision.
    """
    model = _build_strip(scene)
    assert model.films is not None
    skeleton, numbering = model.shapes.skeleton, model.system.numbering
    lift = build_film_lift(model.section, model.mesh, model.corners, skeleton, model.films)
    solution = model.system.solve(np.zeros((numbering.unknowns, 2)), lift, passes=2)
    # an element of a film has its displacement and the lift
    values = solution.values - lift + solution.shift[:, None] * numbering.vertical[:, None]
    chosen, mesh = _select_stacks(model.mesh)
    mean = values[chosen].reshape(len(chosen), 2, skeleton, 2)
    stacks = replace(
        model, mesh=mesh, corners=model.corners[chosen], geometry=model.geometry.select(chosen), law=model.law.select(chosen)
    )
    return StackMotion(*_tabulate(stacks, np.concatenate([mean, _solve_double_part(stacks)], axis=1)))


@keep_result
def _select_stacks(mesh: Topology) -> tuple[Ints, Topology]:
    """Return the numbers of the elements of stacks and base, and the mesh that they make up."""
    chosen = np.flatnonzero(~np.isin(mesh.body, (*TISSUES, *BLOCKS)))
    arrays = {name: getattr(mesh, name)[chosen] for name in ("shape", "vertices", "circles", "corners", "body")}
    return chosen, replace(mesh, **arrays, columns=np.zeros(1, dtype=int))


def _build_strip(scene: Scene) -> MeridianModel:
    """Build the model of stacks and base with soft blocks and tissue."""
    size = TISSUE_RADII * scene.probe.tube_radius
    tissue = scene.tissue
    cylinder = CylinderTissue(
        shape="cylinder", radius=size, depth=size, youngs_modulus=tissue.youngs_modulus, poisson_ratio=tissue.poisson_ratio
    )
    bare_scene = scene.model_copy(update={"tissue": cylinder, "inclusion": (), "placement": Placement()})
    sections = add_details(scene, build_sections(bare_scene))
    layers = [body for stack in STACKS for body in stack if body in sections.materials]
    modulus = SOFT_RELATIVE * min(sections.materials[body].youngs_modulus for body in layers)
    soft = Material.model_construct(youngs_modulus=modulus, poisson_ratio=0.3)
    materials = sections.materials | dict.fromkeys((Body.TISSUE, *LAYERS, *BLOCKS), soft)
    return build_model(sections.section, materials, "bonded", STRIP_FINENESS, films=sections.films)


def _solve_double_part(model: MeridianModel) -> Floats:
    """Solve for the part of w that varies as cos 2 theta: U_2, V_2 and W_2 of the n elements' functions, (n, 3, functions, 2).

    ``model`` has the elements of stacks and base alone, n of them; its ``condensed`` and ``system`` are not used.
    """
    assert model.films is not None
    skeleton, n = model.shapes.skeleton, len(model.mesh.body)
    systems = AzimuthalSystems(model, "bonded", np.arange(n))
    system = systems.assemble_order(DEVIATORIC_ORDER)
    # the lift of films whose d_p is d_m and whose d33 is zero has U in its first component, and V = -U
    shear_films = tuple(
        film.model_copy(update={"d31": film.lateral_charge_difference, "d32": film.lateral_charge_difference, "d33": 0.0})
        for film in model.films
    )
    inner, outer = shear_films
    lifts = build_film_lift(model.section, model.mesh, model.corners, skeleton, (inner, outer))
    radial = lifts.reshape(n, 2, skeleton, 2)[:, 0]
    lift = np.zeros((n, 3, skeleton, 2))
    lift[:, 1] = 2 * radial  # components U + V, U - V and W
    flat = lift.reshape(n, -1, 2)
    forces = system.numbering.scatter @ (system.stiffness @ flat).reshape(-1, 2)
    v = system.solve(-forces)
    components = (system.numbering.gather @ v).reshape(n, 3, skeleton, 2)
    return np.asarray(np.einsum("ac,ecsk->eask", system.amplitudes, components))


def _tabulate(model: MeridianModel, values: Floats) -> tuple[tuple[Floats, Floats], ...]:
    """Tabulate displacements along the upper ends of both blocks; see ``StackMotion``.

    ``values`` are amplitudes U_0, W_0, U_2, V_2 and W_2 of n elements' functions on corners and edges, (n, 5, functions, 2).
    """
    t = (1 - np.cos(np.linspace(0, np.pi, PLACES_PER_SIDE))) / 2
    zero, unit = np.zeros_like(t), np.ones_like(t)
    places = np.concatenate([np.stack(side, axis=1) for side in ((t, zero), (unit, t), (t, unit), (zero, t))])
    functions = evaluate_functions(places, model.shapes.degrees)[0][:, : model.shapes.skeleton]
    tables = []
    for stack, height in zip(STACKS, (model.section.inner_height, model.section.outer_height), strict=True):
        inside = np.flatnonzero(np.isin(model.mesh.body, stack))
        nodes = compute_nodes(model.section, model.mesh, places, inside)
        on_end = np.abs(nodes[..., 1] - height) < HEIGHT_TOLERANCE_RELATIVE * height
        amplitudes = np.einsum("pf,eafk->epak", functions, values[inside])[on_end]
        radius, first = np.unique(nodes[..., 0][on_end], return_index=True)
        tables.append((radius, amplitudes[first, :2], amplitudes[first, 2:]))
    inner, outer = tables
    return tuple(zip(inner, outer, strict=True))

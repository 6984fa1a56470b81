"""What reflections hold is known before they begin, and stays within the limit."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import read_scene
from geometry.common.resources import LIBRARY_MEMORY_BYTES, LimitReached, Limits, use_limits
from solver.equivalent_inclusion.probe_on_tissue import solve_undisturbed
from solver.inclusions.projection import build_projection
from solver.inclusions.tumours import Tumours
from solver.inclusions.vector_modes import Modes
from solver.linalg.workspace import Workspace, get_workspace, measure_bytes, use_workspace
from solver.multiple_scattering.exchange import Reflector
from tests.support.paths import REFERENCE

SCENE = read_scene(REFERENCE / "axisymmetric" / "shallow.toml")


def make_tumours(count: int) -> Tumours:
    """Ever closer to the surface, off the axis and not in one plane."""
    body, ends = SCENE.inclusion[0], np.linspace(0.0, 1.0, count)
    assert body.diameter is not None
    depth, moduli = body.diameter / 2 * (1.05 + 0.3 * ends), (body.youngs_modulus + 0 * ends, body.poisson_ratio + 0 * ends)
    return Tumours(0.02 + 0.03 * ends, 0.02 * ends, depth, body.diameter + 0 * ends, *moduli)


def test_a_projection_takes_a_fraction_of_its_matrix() -> None:
    modes = Modes(36, 0.45, 16, "both")
    made = build_projection(modes)
    assert measure_bytes(made) < 0.03 * 8 * len(modes) * made.points.size


@pytest.mark.slow
def test_orders_of_close_spheres_are_made_again_where_not_all_have_room() -> None:
    with use_workspace(Workspace()):
        base, shared = solve_undisturbed(SCENE, 0.05), set[int]()
        whole, tight = Reflector(base.field.states, "bonded", close=True), base.choose_reflector(make_tumours(1))
        assert tight.close
        forces = [np.ones((whole.find_interior(m).harmonic.matrix.shape[0], 1)) for m in range(5)]
        answers = [whole.find_interior(m).harmonic.solve(item) for m, item in enumerate(forces)]
        with use_limits(
            Limits(memory=get_workspace().bytes_held + LIBRARY_MEMORY_BYTES + 1.5 * tight._harmonics.bytes_per_order)
        ):
            repeated = [[tight.find_interior(m).harmonic.solve(item) for m, item in enumerate(forces)] for _ in range(2)]
    assert all(np.array_equal(item, answer) for run in repeated for item, answer in zip(run, answers, strict=True))
    measure_bytes(base.field.states, shared)
    assert measure_bytes(tight, set(shared)) < 0.7 * measure_bytes(whole, set(shared))


def test_not_even_one_order_of_close_spheres_is_a_refusal_that_advises() -> None:
    base = solve_undisturbed(SCENE, 0.05)
    reflector = Reflector(base.field.states, "bonded", close=True)
    message = "close to the surface.*fewer, or further from surface, bottom and interfaces, take less"
    short = LIBRARY_MEMORY_BYTES + reflector._harmonics.bytes_per_order / 2  # whatever else is held and may go
    with use_limits(Limits(memory=short)), pytest.raises(LimitReached, match=message):
        reflector.find_interior(0)

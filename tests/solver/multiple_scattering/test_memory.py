"""What reflections hold is known before they begin, and stays within the limit."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from geometry import read_scene
from geometry.common.resources import LIBRARIES, LimitReached, Limits, limited
from solver.equivalent_inclusion.probe_on_tissue import undisturbed
from solver.inclusions.projection import held_bytes, projection
from solver.inclusions.tumours import Tumours
from solver.inclusions.vector_modes import Modes
from solver.linalg.workspace import Workspace, current, size, using
from solver.multiple_scattering.exchange import Reflector
from solver.multiple_scattering.solve import arranged
from tests.support.paths import REFERENCE

SCENE = read_scene(REFERENCE / "axisymmetric" / "shallow.toml")


def beside(count: int) -> Tumours:
    """Ever closer to the surface, off the axis and not in one plane."""
    body, ends = SCENE.inclusion[0], np.linspace(0.0, 1.0, count)
    assert body.diameter is not None
    depth, moduli = body.diameter / 2 * (1.05 + 0.3 * ends), (body.youngs_modulus + 0 * ends, body.poisson_ratio + 0 * ends)
    return Tumours(0.02 + 0.03 * ends, 0.02 * ends, depth, body.diameter + 0 * ends, *moduli)


def test_a_projection_takes_little_more_than_it_holds() -> None:
    modes = Modes(30, 0.45, 16, "even")
    tracemalloc.start()
    try:
        made = projection(modes)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert made.matrix.nbytes == held_bytes(modes)
    assert peak < 6 * made.matrix.nbytes


@pytest.mark.slow
def test_alike_spheres_share_what_projects_on_their_modes() -> None:
    base = undisturbed(SCENE, 0.05)
    alike = beside(2).of_index([0, 0])
    one, other = arranged(base.field.states.model.section, base.strata, replace(alike, y=np.array([0.0, 0.02])))[0]
    assert one.modes.degree > 20  # those below are kept in any case
    assert one.projection is other.projection


def test_spheres_whose_modes_hold_too_much_are_refused_before_any_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def made(modes: Modes) -> None:
        raise AssertionError(modes)

    monkeypatch.setattr("solver.multiple_scattering.solve.projection", made)
    monkeypatch.setattr("solver.multiple_scattering.solve._kept_projection", made)
    base = undisturbed(SCENE, 0.05)
    with limited(Limits(memory=4e8)), pytest.raises(LimitReached, match=r"reflections of 30 tumours .* take less.*--memory"):
        arranged(base.field.states.model.section, base.strata, beside(30))


@pytest.mark.slow
def test_orders_of_close_spheres_are_made_again_where_not_all_have_room() -> None:
    with using(Workspace()):
        base, shared = undisturbed(SCENE, 0.05), set[int]()
        whole, tight = Reflector(base.field.states, "bonded", close=True), base.reflector(beside(1))
        assert tight.close
        forces = [np.ones((whole.interior(m).harmonic.matrix.shape[0], 1)) for m in range(5)]
        answers = [whole.interior(m).harmonic.solve(one) for m, one in enumerate(forces)]
        with limited(Limits(memory=current().bytes_held + LIBRARIES + 1.5 * tight._harmonics.needed)):
            again = [[tight.interior(m).harmonic.solve(one) for m, one in enumerate(forces)] for _ in range(2)]
    assert all(np.array_equal(one, other) for some in again for one, other in zip(some, answers, strict=True))
    size(base.field.states, shared)
    assert size(tight, set(shared)) < 0.7 * size(whole, set(shared))


def test_not_even_one_order_of_close_spheres_is_a_refusal_that_advises() -> None:
    base = undisturbed(SCENE, 0.05)
    reflector = Reflector(base.field.states, "bonded", close=True)
    told = "close to the surface.*fewer, or further from surface, floor and interfaces, take less"
    short = LIBRARIES + reflector._harmonics.needed / 2  # whatever else is held and may go
    with limited(Limits(memory=short)), pytest.raises(LimitReached, match=told):
        reflector.interior(0)

"""Refuse kinds of scenes that only some evaluators take; each text names the evaluator that takes the kind."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from geometry.common.errors import Refusal, SolveError
from geometry.scenes.fit_check import compute_offset, compute_semi_axes
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion

TOUCHING_RELATIVE = 1e-6  # of a body's half height: a body this close to an interface of layers counts as crossed by it

ONE_SPHERE = "with at most one inclusion, a sphere on the axis of an upright probe"
ANY_FACES = f"contact.interface = 'bonded' or 'frictionless', or 'unilateral' {ONE_SPHERE}"

Kind = Literal["contact", "solid", "crossed sphere", "crossed", "layers"]
GEOMETRY_KINDS: tuple[Kind, ...] = ("contact", "solid", "crossed")  # what no rotationally symmetric linear evaluator takes


def find_refusal(scene: Scene, kinds: tuple[Kind, ...]) -> str | None:
    """Return a text naming the evaluator that takes a scene, for an evaluator that refuses some kinds; None where it takes it.

    Parameters
    ----------
    scene
        Any scene.
    kinds
        The kinds of scenes that the asking evaluator refuses. ``contact``: a unilateral interface or round edges, which no linear
        evaluator takes; ``solid``: a tilted probe or a body from a surface file; ``crossed sphere``: a sphere on the axis that an
        interface of layers crosses; ``crossed``: any other body that one crosses; ``layers``: tissue of layers.
    """
    return next((text for kind, text in _iterate_kinds(scene) if kind in kinds), None)


def _iterate_kinds(scene: Scene) -> Iterator[tuple[Kind, str]]:
    """Yield the kinds to which a scene belongs, each with the words of a refusal: the evaluator for it, and "for" what."""
    if scene.contact.interface == "unilateral":
        yield "contact", "contact for contact.interface = 'unilateral'" if is_round(scene) else ANY_FACES
    if scene.contact.edge_radius > 0:
        text = "contact for contact.edge_radius above 0: round edges close bit by bit"
        yield "contact", text if is_round(scene) else f"contact.edge_radius = 0, or more {ONE_SPHERE}"
    if scene.placement.tilt != 0:
        yield "solid", "solid for placement.tilt other than 0"
    if any(body.surface is not None for body in scene.inclusion):
        yield "solid", "solid for an inclusion that is neither sphere nor ellipsoid"
    if not scene.tissue.layer:
        return
    symmetric = is_round(scene)  # then ``axisymmetric`` takes it
    if any(_is_crossed(scene, body) for body in scene.inclusion if body.surface is None):
        text = f"{'axisymmetric' if symmetric else 'solid'} for an inclusion that an interface of the tissue's layers crosses"
        yield "crossed sphere" if symmetric else "crossed", text
    yield "layers", f"{'axisymmetric' if symmetric else 'equivalent-inclusion'} for layers of tissue"


def _is_crossed(scene: Scene, body: Inclusion) -> bool:
    """Return whether an interface of the tissue's layers crosses or touches a body."""
    half_height = math.hypot(*compute_semi_axes(body)[2])  # of an ellipsoid: the norm of the z components of its semi-axes
    return any(abs(interface - body.depth) < half_height * (1 + TOUCHING_RELATIVE) for interface in scene.tissue.interfaces)


def is_round(scene: Scene) -> bool:
    """Return whether the probe is upright with at most one inclusion, a sphere on its axis: a rotationally symmetric scene.

    The tissue is not examined here. Layers keep the symmetry.
    """
    return (
        scene.placement.tilt == 0
        and len(scene.inclusion) <= 1
        and all(body.diameter is not None and compute_offset(scene, body) <= 1e-9 * body.diameter for body in scene.inclusion)
    )


@contextmanager
def refuse_unsolvable(key: str, value: str, allowed: str = "scenes whose sizes and moduli lie closer together") -> Iterator[None]:
    """Run the block of a ``with`` statement in one thread, and convert a ``SolveError`` to the refusal of a value."""
    from solver.linalg.threads import limit_to_one_thread

    with limit_to_one_thread():
        try:
            yield
        except SolveError as fault:
            raise Refusal(key, value, f"{allowed} ({fault})") from fault

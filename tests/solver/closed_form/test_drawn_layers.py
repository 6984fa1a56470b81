"""Layers drawn at random: a result with its error, or a refusal that names who takes the scene."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import Refusal, Scene
from geometry.common.errors import InputError
from solver import evaluate
from solver.closed_form.designs import (
    build_parameters,
    iterate_solutions,
)
from solver.closed_form.evaluator import ClosedForm
from tests.solver.closed_form.test_layers import EXAMPLE, OWN, add_layers


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.floats(-3, 1.6), st.floats(-6, 6), st.floats(0, 0.4999)), min_size=1, max_size=8),
    st.sampled_from(["bonded", "frictionless"]),
    st.booleans(),
)
def test_any_layers_are_answered_or_refused(layers: list[tuple[float, float, float]], interface: str, tumour: bool) -> None:
    """Thickness 1 um to 40 mm, contrast 1e-6 to 1e6: no warning, nothing but finite numbers, or one line."""
    data = EXAMPLE.model_dump(exclude_unset=True) | {"contact": {"interface": interface}}
    data |= {} if tumour else {"inclusion": []}
    tables = [
        {"thickness": 1e-3 * 10**h, "youngs_modulus": OWN[0] * 10**contrast, "poisson_ratio": nu} for h, contrast, nu in layers
    ]
    try:
        scene = Scene.model_validate(data | {"tissue": data["tissue"] | {"layer": tables}})
    except ValueError:  # they fill the tissue
        return
    answer = ClosedForm().compute_films([scene])[0]
    if isinstance(answer, InputError):
        assert "\n" not in str(answer)
        return
    assert np.all(np.isfinite(answer.films.forces))
    shape, values = build_parameters(scene)
    (solution,) = iterate_solutions(shape, values[:, None])
    assert np.abs(solution.works - np.swapaxes(solution.works, 1, 2)).max() <= 1e-6 * np.abs(solution.works).max()


def test_what_it_refuses_names_who_takes_it() -> None:
    for layer, words in (
        ((6.0, 1e4), "axisymmetric or solid for an inclusion nearer to an interface"),
        ((0.02, 1e-3, 0.4999), "axisymmetric for a layer that blocks squeeze"),
        ((0.5, 1e4, 0.4999999), r"tissue.layer\[0\].poisson_ratio up to 0.499999"),
    ):
        with pytest.raises(Refusal, match=words):
            evaluate(add_layers(layer), "closed-form")

"""Errors of the nodes of the closed form's integrals over wave numbers, in its stated errors.

``python -m benchmarks.closed_form.nodes`` prints, over all scenes of tests/reference that it takes, what four times the nodes,
twice those for near sides and for layers, change of ln(ratio), of the logarithms of both totals and of the log-sensitivity,
over the stated error of each: the median, the value that three in a hundred pass, and the largest, for the scenes themselves
and for designs that differ from them by up to 5 % in every number but have their nodes, as in a search.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.closed_form.accuracy import REFERENCE
from geometry import InputError, read_scene
from geometry.common.arrays import Floats
from solver.closed_form.designs import MAX_WAVE_NODES, Shape, build_parameters, compute_forces
from solver.closed_form.evaluator import ClosedForm

DESIGNS = 24
ROUNDING_SCENE_NAME = (
    "incompressible-contrast-1e-6"  # rounding changes its log-sensitivity by half the stated error, whatever the nodes
)


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    for text, spread in (("as they are", 0.0), ("within 5 %", 0.05)):
        rows = np.array([row for path in sorted(REFERENCE.rglob("*.toml")) for row in _shares(path.stem, str(path), spread)])
        for name, level in (("median", 0.5), ("97 %", 0.97), ("largest", 1.0)):
            print(
                f"{len(rows)} scenes {text}, {name}: "
                + ", ".join(f"{quantile:.1e}" for quantile in np.quantile(rows, level, axis=0))
            )


def _shares(stem: str, path: str, spread: float) -> list[Floats]:
    """Return the largest changes among designs near a scene over its stated errors; empty if it is refused."""
    try:
        scene = read_scene(path)
    except InputError:  # another kind of file
        return []
    (films,) = ClosedForm().compute_films([scene])
    if isinstance(films, InputError) or stem == ROUNDING_SCENE_NAME:
        return []
    shape, values = build_parameters(scene)
    rng = np.random.default_rng(1)
    designs = values[:, None] * np.exp(rng.uniform(-spread, spread, (len(values), DESIGNS if spread else 1)))
    is_nearly_incompressible = (values > 0.45) & (values < 0.5)  # Poisson's ratios, if not some length of half a metre
    designs[is_nearly_incompressible] = values[is_nearly_incompressible, None]
    finer = replace(
        shape,
        nodes=min(4 * shape.nodes, MAX_WAVE_NODES),
        side_nodes=2 * shape.side_nodes,
        layer_nodes=2 * shape.layer_nodes,
    )
    stated = np.array([films.errors.log_ratio, *films.errors.log_totals, films.errors.sensitivity])
    with np.errstate(all="ignore"):
        changed = np.abs(_quantities(shape, designs) - _quantities(finer, designs)).T / stated
    return [np.asarray(np.nanmax(changed, axis=0))]


def _quantities(shape: Shape, designs: Floats) -> Floats:
    """ln(ratio), the logarithms of both totals, and the log-sensitivity, shape (4, n)."""
    totals, derivatives = (part.sum(axis=2) for part in compute_forces(shape, designs))
    logs, shares = np.log(totals), derivatives / totals
    return np.array([logs @ [1, -1], *logs.T, shares @ [1, -1]])


if __name__ == "__main__":
    main()

"""Is the closed form's stated error honest? ``python benchmarks/closed_form.py [--scenes N] [--seed K]``.

Draws random scenes, compares the closed form with ``axisymmetric`` and prints the quantiles of
the true error and of true over stated error, which must stay below 1.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from geometry import Contact, CylinderTissue, Inclusion, InputError, Load, Material, Probe, Scene
from solver import evaluate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    errors = np.array([pair for pair in (compared(rng) for _ in range(options.scenes)) if pair is not None])
    print(f"{len(errors)} scenes of {options.scenes} drawn; the rest do not fit together or are refused")
    for text, values in (("true error of the ratio", errors[:, 0]), ("true / stated error", errors[:, 0] / errors[:, 1])):
        print(f"{text}: median {np.median(values):.3g}, 90 % below {np.quantile(values, 0.9):.3g}, largest {values.max():.3g}")


def compared(rng: np.random.Generator) -> tuple[float, float] | None:
    """Return the true and the stated relative error of the ratio of one random scene."""
    try:
        scene = draw(rng)
        found = evaluate(scene, "closed-form")
        exact = evaluate(scene, "axisymmetric", 0.05)
    except InputError:
        return None
    if exact.ratio is None or found.ratio is None or found.error_estimate is None:
        return None
    return abs(found.ratio / exact.ratio - 1), found.error_estimate


def draw(rng: np.random.Generator) -> Scene:
    """Draw a scene; raises ``InputError`` or ``ValueError`` where its parts do not fit."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def material(modulus: float) -> dict[str, Any]:
        return {"youngs_modulus": modulus, "poisson_ratio": float(rng.choice([rng.uniform(0, 0.49), 0.45, 0.48, 0.499]))}

    radius, tissue, size = between(0.5e-3, 10e-3), between(5e2, 2e4), between(1e-3, 20e-3)
    height, cover = between(0.1, 5) * radius, between(0.1, 3) * size
    try:
        probe = Probe(
            inner_radius=radius,
            area_ratio=between(0.05, 20),
            gap=between(0.005, 0.5) * radius,
            inner_height=height,
            outer_height=height * between(0.7, 1.4),
            inner=Material(**material(tissue * between(0.1, 1e3))),
            outer=Material(**material(tissue * between(0.1, 1e3))),
        )
        return Scene(
            probe=probe,
            tissue=CylinderTissue(
                shape="cylinder",
                radius=probe.tube_radius * between(1.3, 20),
                depth=max(between(0.5, 15) * probe.tube_radius, (size + cover) * between(1.05, 3)),
                **material(tissue),
            ),
            inclusion=(Inclusion(diameter=size, depth=cover + size / 2, **material(tissue * between(1e-3, 1e3))),),
            contact=Contact(interface="bonded" if rng.random() < 0.5 else "frictionless"),
            load=Load(indentation=1e-6),
        )
    except ValueError as misfit:
        raise InputError("scene", "drawn", str(misfit)[:60]) from None


if __name__ == "__main__":
    main()

"""Random scenes with their converged answers, kept in a file: what the closed form's stated errors are fitted to and audited on.

``python -m benchmarks.closed_form.scenes FILE --scenes N --seed K`` draws scenes, a third of them ordinary probes on ordinary
tissue, the others from the whole range of the closed form, has ``axisymmetric`` or, beside the axis, ``equivalent-inclusion``
answer each, and appends scene and answer as a line of JSON. Started again it goes on; about one scene a second.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from geometry import InputError, Scene
from solver import evaluate
from solver.closed_form.level import ClosedForm
from solver.linalg.memory import give_back

KEPT = ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity", "error_estimate")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenes", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    known = len(list(answered(options.file))) if options.file.exists() else 0
    with options.file.open("a") as file:
        for number in range(known, options.scenes):
            scene, answer = _next(np.random.default_rng([options.seed, number]))
            line = {"scene": scene.model_dump(mode="json", exclude_unset=True), "answer": answer}
            file.write(json.dumps(line) + "\n")
            file.flush()
            give_back()


def answered(file: Path) -> Iterator[tuple[Scene, dict[str, float | None]]]:
    """Yield the scenes of a file with their answers: the keys ``KEPT``, those that no warning tells to be unsure."""
    for line in file.read_text().splitlines():
        found = json.loads(line)
        yield Scene.model_validate(found["scene"]), found["answer"]


def _next(rng: np.random.Generator) -> tuple[Scene, dict[str, float | None]]:
    """Draw until a scene fits together, the closed form takes it, and an evaluator knows its ratio."""
    while True:
        try:
            scene = draw(rng)
            if ClosedForm().refusal(scene) is not None:
                continue
            beside = any(body.x != scene.placement.x for body in scene.inclusion)
            found = evaluate(scene, "equivalent-inclusion" if beside else "axisymmetric", 0.01 if beside else 0.003)
        except (InputError, ValueError):
            continue
        if found.ratio is None or not (found.error_estimate or 1.0) <= 0.02:
            continue
        answer = {key: getattr(found, key) for key in KEPT}
        if any(note.kind == "sensitivity" for note in found.warnings):
            answer["log_sensitivity"] = None
        return scene, answer


def draw(rng: np.random.Generator) -> Scene:
    """Draw a scene; raises ``ValueError`` where its parts do not fit."""
    return _ordinary(rng) if rng.random() < 1 / 3 else _extreme(rng)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _material(rng: np.random.Generator, modulus: float, least: float = 0.0) -> dict[str, Any]:
    poisson = float(rng.choice([rng.uniform(least, 0.49), 0.45, 0.48, 0.499, 0.4999]))
    return {"youngs_modulus": modulus, "poisson_ratio": poisson}


def _ordinary(rng: np.random.Generator) -> Scene:
    """Blocks of 1 to 6 mm, 5 to 300 times as stiff as the tissue, and a tumour covered by a quarter of its diameter or more."""
    radius, tissue = _between(rng, 1e-3, 6e-3), _between(rng, 1e3, 2e4)
    probe = {
        "inner_radius": radius, "area_ratio": _between(rng, 0.1, 3), "gap": _between(rng, 0.02, 0.1) * radius,
        "inner_height": _between(rng, 0.5, 4) * radius,
        "inner": _material(rng, tissue * _between(rng, 5, 300), 0.3),
        "outer": _material(rng, tissue * _between(rng, 5, 300), 0.3),
    }  # fmt: skip
    probe["outer_height"] = probe["inner_height"]
    size = radius * _between(rng, 0.5, 4)
    material = _material(rng, tissue * _between(rng, 0.02, 100), 0.3)
    sphere = {"diameter": size, "depth": size * (0.5 + _between(rng, 0.25, 2)), **material}
    return _scene(rng, probe, [sphere], tissue, (2.5, 12), (1, 6))


def _extreme(rng: np.random.Generator) -> Scene:
    radius, tissue = _between(rng, 0.1e-3, 20e-3), _between(rng, 5e2, 2e4)
    probe = {
        "inner_radius": radius, "area_ratio": _between(rng, 0.02, 50),
        "gap": min(max(_between(rng, 0.001, 0.5) * radius, 1e-6), 5e-3),
        "inner_height": radius * _between(rng, 0.05, 20), "outer_height": radius * _between(rng, 0.05, 20),
        "inner": _material(rng, tissue * _between(rng, 0.1, 1e4)), "outer": _material(rng, tissue * _between(rng, 0.1, 1e4)),
    }  # fmt: skip
    spheres = []
    for _ in range(int(rng.choice([0, 1, 2], p=[0.05, 0.85, 0.1]))):
        size = radius * _between(rng, 0.3, 10)
        material = _material(rng, tissue * _between(rng, 1e-4, 1e4))
        spheres.append({"diameter": size, "depth": size * (0.5 + _between(rng, 0.1, 3)), **material})
    return _scene(rng, probe, spheres, tissue, (1.05, 20), (0.3, 15))


def _scene(
    rng: np.random.Generator,
    probe: dict[str, Any],
    spheres: list[dict[str, Any]],
    modulus: float,
    sides: tuple[float, float],
    depths: tuple[float, float],
) -> Scene:
    """Put the spheres under the probe, a third of them beside its axis, into tissue of sides and depth in outer radii."""
    inner = np.pi * probe["inner_radius"] ** 2
    outer = float(np.sqrt((probe["inner_radius"] + probe["gap"]) ** 2 + inner / probe["area_ratio"] / np.pi))
    for sphere in spheres:
        sphere["x"] = outer * _between(rng, 0.1, 3) if rng.random() < 0.35 else 0.0
    reach = max((sphere["x"] + 0.55 * sphere["diameter"] for sphere in spheres), default=0.0)
    deepest = max((sphere["depth"] + sphere["diameter"] / 2 for sphere in spheres), default=0.0)
    depth = max(_between(rng, *depths) * outer, deepest * _between(rng, 1.02, 3))
    side = max(outer * _between(rng, *sides), reach)
    tissue: dict[str, Any] = {"shape": "cylinder", "radius": side, "depth": depth}
    kind = rng.random()
    if kind < 0.1:
        tissue = {"shape": "half-space"}
    elif kind < 0.2:
        tissue = {"shape": "block", "length": 2 * side * _between(rng, 1, 2), "breadth": 2 * side, "depth": depth}
    return Scene.model_validate(
        {
            "probe": probe,
            "tissue": tissue | _material(rng, modulus),
            "inclusion": [sphere | {"target": i == 0} for i, sphere in enumerate(spheres)],
            "contact": {"interface": "bonded" if rng.random() < 0.6 else "frictionless"},
            "load": {"indentation": 1e-7},
        }
    )


if __name__ == "__main__":
    main()

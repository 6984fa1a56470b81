"""Check the rule for loads on layered tissue: drawn scenes, pressed by ``contact``.

    python -m benchmarks.extremes.layer_loads --scenes 64 --seed 0 [--first N] [--bonded]

One to four layers, thin to thick, soft to stiff, bonded and frictionless faces, the tumour on the axis. For each scene: the load
that the rule allows to linear elasticity at accuracy 0.01, and what sets it; the shares of the promise that the load really takes
there (ratio, stresses, stiffness within 0.01, log-sensitivity within 0.05; 1 is all of it; what two meshes differ by is taken
off); and the load at which the first promise breaks, or the gap closes, over the one that is allowed (1 or more is safe).

Duration: an hour.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from geometry import ProbeError, Scene
from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached, start_clock
from geometry.scenes.scene_file import scene_from_dict
from geometry.scenes.scene_tables import Contact
from solver.contact.evaluator import ContactEvaluator
from solver.contact.limits import is_gap_closed
from solver.contact.loaded_scene import LoadedScene
from solver.contact.path import Path
from solver.planning.load_limits import build_load_rule, find_largest_load
from solver.planning.loads import LoadRule, compute_sensitivity_size
from solver.results.load_limits import LargestLoad

ACCURACY = 0.01
MAX_DEPTH_OUTER_RADII = 0.3  # outer radii: beyond, the rule says nothing anyway
BROKEN_PROMISE_FACTOR = 1.5  # promises: a path that breaks one by so much is followed no further
PLACE_COUNT = 200  # on a path, where promises are looked at
MIN_SLOPE_DIFFERENCE = 1e-5  # log-sensitivities that differ by less are alike: what every evaluator promises


def draws(seed: int) -> Iterator[Scene]:
    """Layered scenes that the models allow, without an end."""
    random = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(np.exp(random.uniform(math.log(low), math.log(high))))

    while True:
        inner, area_ratio = log(2e-3, 6e-3), log(0.4, 3)
        outer = inner * math.sqrt(1 + 1 / area_ratio)
        tissue = log(2e3, 2e4)
        probe: dict[str, Any] = {
            "inner_radius": f"{inner} m", "area_ratio": area_ratio, "gap": f"{inner * log(0.02, 0.15)} m",
            "height": f"{inner * log(0.5, 2)} m", "base": {"rigid": True},
        }  # fmt: skip
        for block in ("inner", "outer"):
            probe[block] = {"youngs_modulus": f"{tissue * log(20, 500)} Pa", "poisson_ratio": 0.45}
        soft, layers = random.random() < 0.6, list[dict[str, Any]]()
        for _ in range(random.integers(1, 5)):
            contrast = log(0.1, 1) if soft or random.random() < 0.5 else log(1, 30)
            layers.append({
                "thickness": f"{outer * log(0.002, 0.6)} m", "youngs_modulus": f"{tissue * contrast} Pa",
                "poisson_ratio": random.uniform(0.3, 0.49),
            })  # fmt: skip
        diameter = outer * random.uniform(0.4, 1.5)
        top = sum(float(layer["thickness"].split()[0]) for layer in layers)
        body = {
            "diameter": f"{diameter} m", "depth": f"{max(top * 1.05, 0.2 * diameter) + diameter * log(0.55, 1.5)} m",
            "poisson_ratio": 0.45, "youngs_modulus": f"{tissue * log(0.2, 30)} Pa",
        }  # fmt: skip
        ground = {
            "shape": "cylinder", "radius": f"{outer * log(5, 12)} m", "depth": f"{outer * log(5, 12)} m", "layer": layers,
            "youngs_modulus": f"{tissue} Pa", "poisson_ratio": random.uniform(0.3, 0.49),
        }  # fmt: skip
        faces = {"interface": "bonded" if random.random() < 0.6 else "frictionless"}
        try:
            yield scene_from_dict({
                "probe": probe, "tissue": ground, "inclusion": [body], "contact": faces, "load": {"force": "1 mN"},
            })  # fmt: skip
        except (ProbeError, ValueError):
            continue


@dataclass(frozen=True)
class LoadedLayers:
    """What a load changes on the way, as ``contact`` says.

    Attributes
    ----------
    indentation
        m, rising from 0, shape (k,).
    force
        N, likewise.
    changes
        Of ratio, both films' stresses, stiffness, relative, and of the log-sensitivity, absolute, shape (5, k).
    meshes
        By how much two meshes differ in these, likewise.
    size
        What the log-sensitivity counts as, eq. PL.8.
    sensitivity
        At rest.
    closes
        Indentation at which the gap's walls touch, m, or infinite.
    """

    indentation: Floats
    force: Floats
    changes: Floats
    meshes: Floats
    size: float
    sensitivity: float
    closes: float

    @classmethod
    def from_scene(cls, scene: Scene) -> tuple[LoadedLayers, LoadedScene]:
        """Press a scene until a promise is broken, or as far as anything converges."""
        with start_clock():
            loaded_scene = ContactEvaluator().prepare_scene(scene)
        for path in loaded_scene.paths:
            try:
                with start_clock():
                    for _ in path.iterate_steps(MAX_DEPTH_OUTER_RADII * path.radius):
                        if is_gap_closed(path) or _is_promise_broken(loaded_scene, path):
                            break
            except (SolveError, LimitReached):
                pass
        end = min(path.last.indentation for path in loaded_scene.paths)
        if end == 0:
            raise SolveError("not even the first step converges")
        places = np.linspace(0.0, end, PLACE_COUNT)
        coarse, fine = (_changes(loaded_scene, path, places) for path in loaded_scene.paths)
        films = loaded_scene.linear.films[0]
        stiffness = float(loaded_scene.paths[1].points[0].tangent.sum()) * (1 + fine[3])
        touched = [
            point.indentation for path in loaded_scene.paths for point in path.points if is_gap_closed(path) and point.walls <= 0
        ]
        made = cls(
            places, stiffness * places, fine, np.abs(fine - coarse),
            compute_sensitivity_size(films.film_log_sensitivities or (0.0, 0.0)), abs(films.log_sensitivity or 0.0),
            min(touched, default=math.inf),
        )  # fmt: skip
        return made, loaded_scene

    def shares(self) -> Floats:
        """Shares of the promises on the ratio, the stresses and stiffness, the log-sensitivity, shape (3, k)."""
        excess = np.maximum(0.0, np.abs(self.changes) - self.meshes)
        promise = max(5 * ACCURACY * self.sensitivity, MIN_SLOPE_DIFFERENCE)
        return np.array([excess[0] / ACCURACY, excess[1:4].max(axis=0) / ACCURACY, excess[4] / promise])


def _changes(loaded_scene: LoadedScene, path: Path, places: Floats) -> Floats:
    """See ``LoadedLayers``; of one mesh."""
    points = sorted(path.points, key=lambda point: point.indentation)
    depth, start = np.array([point.indentation for point in points]), points[0]
    films = CubicHermiteSpline(depth, [point.films for point in points], [point.tangent for point in points])(places).T
    secants = np.tile(start.tangent[:, None], len(places))
    secants[:, 1:] = films[:, 1:] / places[1:]
    forces = loaded_scene.outputs[0]
    derivatives = PchipInterpolator(depth, [forces.compute_sensitivity(path, point) for point in points])(places)
    inner, outer = secants / start.tangent[:, None]
    stiffness = secants.sum(axis=0) / start.tangent.sum()
    return np.array([inner / outer - 1, inner - 1, outer - 1, stiffness - 1, derivatives - derivatives[0]])


def _is_promise_broken(loaded_scene: LoadedScene, path: Path) -> bool:
    """Whether a path is well beyond a promise, whatever two meshes differ by."""
    changes = np.abs(_changes(loaded_scene, path, np.array([0.0, path.last.indentation]))[:, 1])
    derivative = max(5 * ACCURACY * abs(loaded_scene.linear.films[0].log_sensitivity or 0.0), MIN_SLOPE_DIFFERENCE)
    return bool(max(changes[:4].max() / ACCURACY, changes[4] / derivative) > BROKEN_PROMISE_FACTOR)


@dataclass(frozen=True)
class LayerAudit:
    """What one scene says of the rule.

    Attributes
    ----------
    limit
        That the rule states.
    taken
        Shares of the promises on ratio, stresses and stiffness, log-sensitivity at that limit.
    margin
        True limit over the stated one.
    ends
        Whether a promise breaks on the way; else ``margin`` is a bound from below.
    """

    limit: LargestLoad
    taken: tuple[float, float, float]
    margin: float
    ends: bool


def audit(scene: Scene) -> LayerAudit:
    """Press a scene and hold its stated limit against what happens."""
    made, loaded_scene = LoadedLayers.from_scene(scene)
    return judge(made, build_rule(scene, loaded_scene))


def build_rule(scene: Scene, loaded_scene: LoadedScene) -> LoadRule:
    """Return the rule with the linear result's own stiffness and log-sensitivities, as in every command."""
    films = loaded_scene.linear.films[0]
    return replace(build_load_rule(scene), stiffness=float(films.totals.sum()), films=films.film_log_sensitivities)


def judge(made: LoadedLayers, rule: LoadRule) -> LayerAudit:
    """Hold a rule's limit against what happens."""
    limit, shares = find_largest_load(rule, ACCURACY, promise=True), made.shares()
    taken = tuple(float(np.interp(limit.force, made.force, share)) for share in shares)
    broken = np.flatnonzero((shares.max(axis=0) > 1) | (made.indentation >= made.closes))
    true = float(made.force[broken[0]] if len(broken) else made.force[-1])
    return LayerAudit(limit, taken, true / limit.force if limit.force else math.inf, bool(len(broken)))  # type: ignore[arg-type]


def describe_scene(scene: Scene) -> str:
    """Describe a scene in a few numbers."""
    probe, tissue = scene.probe, scene.tissue
    layers = ", ".join(
        f"{layer.thickness / probe.tube_radius:.2g} R of {layer.youngs_modulus / tissue.youngs_modulus:.2g}"
        for layer in tissue.layer
    )
    return f"{scene.contact.interface}, nu {tissue.poisson_ratio:.2f}, gap {probe.gap / probe.tube_radius:.2g} R; {layers}"


def main() -> None:
    """Draw, press, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=64)
    parser.add_argument("--first", type=int, default=0, help="the number of the first that is pressed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bonded", action="store_true", help="all faces bonded, which is pressed sooner")
    options = parser.parse_args()
    print("| scene | limit, N | by | ratio | stresses | log-sensitivity | true limit / stated |")
    print("|---|---|---|---|---|---|---|")
    audits: list[LayerAudit] = []
    for number, scene in zip(range(options.first + options.scenes), draws(options.seed), strict=False):
        if number < options.first:
            continue
        if options.bonded:
            scene = scene.model_copy(update={"contact": Contact()})
        try:
            outcome = audit(scene)
        except (ProbeError, SolveError, LimitReached) as fault:
            print(f"| {number}: {describe_scene(scene)} | refused: {fault} |", flush=True)
            continue
        audits.append(outcome)
        shares = " | ".join(f"{value:.2f}" for value in outcome.taken)
        mark = " **unsafe**" if max(outcome.taken) > 1 else ""
        margin = f"{'' if outcome.ends else '> '}{outcome.margin:.3g}"
        print(
            f"| {number}: {describe_scene(scene)}{mark} | {outcome.limit.force:.3g} | {outcome.limit.by} | {shares} | {margin} |",
            flush=True,
        )
    summarise(audits)


def summarise(audits: list[LayerAudit]) -> None:
    """Print what all scenes say; those that ``contact`` cannot press to the stated limit say nothing of it."""
    known = [outcome for outcome in audits if outcome.ends or outcome.margin >= 1]
    taken, ends = np.array([outcome.taken for outcome in known]), np.array([outcome.margin for outcome in known if outcome.ends])
    print(
        f"\n{len(audits)} scenes, {len(known)} of them pressed to the stated limit, {int((taken.max(axis=1) > 1).sum())} unsafe"
    )
    print("largest shares of the promises on ratio, stresses, log-sensitivity:", np.round(taken.max(axis=0), 2).tolist())
    print(
        f"true limit over the stated one, {len(ends)} scenes that reach it: least {ends.min():.3g}, median {np.median(ends):.3g}"
    )


if __name__ == "__main__":
    main()

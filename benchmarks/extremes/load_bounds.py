"""Check the plan's cheap bounds on loads: drawn scenes on the axis, pressed by ``contact`` as far as the rule applies.

    python -m benchmarks.extremes.load_bounds --scenes 60 --seed 0 [--light] [--narrow] [--layered]

For each scene: the largest load of which the rule says anything; the largest share of the bounds that ratio, stresses, stiffness
and log-sensitivity take up to there (1 is all of it; what two meshes differ by is taken off); the load at which the gap closes
over that up to which the plan, and the bound for formulas (PL.4), say that it stays open (1 or more is right). With --light
0.15 of the largest load has to do, where the shares are about as large, and no gap is closed: some 4 s a scene in place of 15.
With --narrow gaps are up to a hundred times narrower, blocks up to ten times stiffer and half the tumours softer than tissue,
where walls may hardly near each other without a tumour; scenes of which little is known, by x or the gap, are passed over.
With --layered scenes without layers are passed over.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry import ProbeError, Scene
from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached, start_clock
from geometry.scenes.scene_file import scene_from_dict
from solver.contact.evaluator import ContactEvaluator
from solver.contact.limits import find_gap_closure_load
from solver.contact.loaded_scene import LoadedScene
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import build_load_rule
from solver.planning.loads import (
    LoadRule,
    bound_closure_force,
    bound_log_sensitivity_change,
    bound_ratio_change,
    compute_sensitivity_size,
)

LOAD_SHARES, LIGHT_LOAD_SHARES = (0.1, 0.3, 1.0), (0.15,)  # of the largest load of which the rule says anything
NEAR_CLOSURE = 0.4  # of the force by eq. PL.4
MIN_SLOPE_DIFFERENCE = 1e-5  # log-sensitivities that differ by less are alike: what every evaluator promises


@dataclass(frozen=True)
class Audit:
    """What one scene says of the bounds.

    Attributes
    ----------
    force
        The largest that contact was pressed to, N.
    x
        Of the rule there.
    used
        Shares of the bounds on ratio, stresses, stiffness and log-sensitivity.
    open
        Closure load over what the plan says, and over what formulas say.
    closes
        Whether it does; else ``open`` are bounds from below.
    """

    force: float
    x: float
    used: tuple[float, ...]
    open: tuple[float, ...]
    closes: bool

    @property
    def optimistic(self) -> bool:
        """Whether a bound does not hold."""
        return max(self.used) > 1 or (self.closes and min(self.open) < 1)


def draws(seed: int) -> Iterator[Scene]:
    """Scenes that the models allow, without an end: deep and shallow, stiff and soft, layered or not."""
    random = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(np.exp(random.uniform(math.log(low), math.log(high))))

    while True:
        inner = log(1.5e-3, 6e-3)
        probe = {
            "inner_radius": f"{inner} m", "area_ratio": log(0.2, 5), "gap": f"{inner * log(0.01, 0.12)} m",
            "height": f"{inner * log(0.3, 2)} m", "base": {"rigid": True},
        }  # fmt: skip
        tissue = log(1e3, 2e4)
        for block in ("inner", "outer"):
            probe[block] = {"youngs_modulus": f"{tissue * log(3, 200)} Pa", "poisson_ratio": random.choice([0.4, 0.48, 0.499])}
        depth, nu = inner * log(2, 15), random.choice([0.4, 0.45, 0.49, 0.499])
        cover = log(0.1, 1.5)
        diameter = depth * random.uniform(0.15, 0.45)
        body = {
            "diameter": f"{diameter} m", "depth": f"{diameter * (0.5 + cover)} m", "poisson_ratio": nu,
            "youngs_modulus": f"{tissue * log(0.1, 100)} Pa",
        }  # fmt: skip
        ground: dict[str, Any] = {
            "shape": "cylinder", "radius": f"{inner * log(5, 15)} m", "depth": f"{depth} m", "youngs_modulus": f"{tissue} Pa",
            "poisson_ratio": nu,
        }  # fmt: skip
        if random.random() < 0.2:
            skin = {"thickness": f"{inner * log(0.05, 0.5)} m", "youngs_modulus": f"{tissue * log(0.2, 30)} Pa"}
            ground["layer"] = [skin | {"poisson_ratio": nu}]
        scene = {"probe": probe, "tissue": ground, "inclusion": [body], "load": {"force": "1 mN"}}
        try:
            yield scene_from_dict(scene)
        except (ProbeError, ValueError):
            continue


def draw_narrowed(seed: int) -> Iterator[Scene]:
    """Draw scenes with narrow gaps, stiff blocks and soft tumours, where the bounds end before the gap closes by eq. PL.4."""
    random = np.random.default_rng(seed + 2000)
    for scene in draws(seed):
        times, stiffer, softer = np.exp(random.uniform([math.log(0.01), 0.0, math.log(0.01)], [0.0, math.log(10), math.log(0.5)]))
        probe, (body,) = scene.probe, scene.inclusion
        inner, outer = (
            block.model_copy(update={"youngs_modulus": stiffer * block.youngs_modulus}) for block in (probe.inner, probe.outer)
        )
        probe = probe.model_copy(update={"gap": probe.gap * times, "inner": inner, "outer": outer})
        if random.random() < 0.5:
            body = body.model_copy(update={"youngs_modulus": softer * scene.tissue.youngs_modulus})
        made = scene.model_copy(update={"probe": probe, "inclusion": (body,)})
        try:
            with start_clock():
                rule, totals = build_load_rule(made), CoarseModel.from_scene(made, details=False).forces.sum(axis=1)
        except ProbeError:
            continue
        if rule.largest_known_force > NEAR_CLOSURE * bound_closure_force(made, totals):
            yield made


def audit(scene: Scene, light: bool = False) -> Audit:
    """Press a scene and hold it against the rule."""
    with start_clock():
        loaded_scene = ContactEvaluator().prepare_scene(scene)
    totals = loaded_scene.linear.films[0].totals
    rule = replace(build_load_rule(scene), stiffness=float(totals.sum()))
    used, force = np.zeros(4), 0.0
    for share in LIGHT_LOAD_SHARES if light else LOAD_SHARES:
        try:
            with start_clock():
                force = loaded_scene.press_to_force(share * rule.largest_known_force).point.force
        except (SolveError, LimitReached, ProbeError):
            break
        used = np.maximum(used, _compute_used_shares(loaded_scene, rule, force))
    closes, closure = (False, force) if light else _closure(loaded_scene)
    formulas = replace(rule, closure=bound_closure_force(scene, totals))
    opened = (closure / rule.largest_known_force, closure / formulas.largest_known_force)
    return Audit(force, rule.compute_x(force), tuple(used.tolist()), opened, closes)


def _compute_used_shares(loaded_scene: LoadedScene, rule: LoadRule, force: float) -> np.ndarray[Any, Any]:
    """Shares of the bounds on ratio, stresses, stiffness and log-sensitivity that a load takes."""
    _, path = loaded_scene.paths
    _, point = (path_point.press_to_force(force) for path_point in loaded_scene.paths)
    start, bound = path.points[0], bound_ratio_change(rule.compute_x(force), rule.covered)
    outputs = loaded_scene.outputs[0]
    difference = outputs.compute_differences(point.indentation)
    films = np.abs(point.films / point.indentation / start.tangent - 1) - difference.outputs
    stiffness = abs(point.force / point.indentation / start.tangent.sum() - 1) - difference.outputs.max()
    odds = abs(_ratio(point.films) / _ratio(start.tangent) - 1) - difference.log_ratio
    first, then = outputs.compute_sensitivity(path, start), outputs.compute_sensitivity(path, point)
    size = compute_sensitivity_size(loaded_scene.linear.films[0].film_log_sensitivities or (0.0, 0.0))
    derivative = max(0.0, abs(then - first) - MIN_SLOPE_DIFFERENCE - difference.sensitivity * max(abs(first), abs(then))) / size
    strained = (odds / bound, films.max() / bound, stiffness / bound)
    return np.array([*strained, derivative / bound_log_sensitivity_change(rule.compute_x(force))])


def _ratio(films: Any) -> float:
    return float(films[0] / films[1])


def _closure(loaded_scene: LoadedScene) -> tuple[bool, float]:
    """Whether the gap closes, and the load, N: where it does or as far as it does not."""
    path = loaded_scene.paths[0]
    try:
        with start_clock():
            closing_load = find_gap_closure_load(path)
    except (SolveError, LimitReached):
        closing_load = None
    return closing_load is not None, path.last.force if closing_load is None else closing_load.force


def describe_scene(scene: Scene) -> str:
    """Describe a scene in a few numbers."""
    probe, tissue, body = scene.probe, scene.tissue, scene.inclusion[0]
    radius, E = probe.tube_radius, tissue.youngs_modulus
    deep = 0.0 if tissue.shape == "half-space" else tissue.depth / radius
    moduli = ", ".join(
        f"{modulus / E:.3g}" for modulus in (probe.inner.youngs_modulus, probe.outer.youngs_modulus, body.youngs_modulus)
    )
    layers = f", skin {tissue.layer[0].youngs_modulus / E:.2g}" if tissue.layer else ""
    return f"gap {probe.gap / radius:.3f} R, tissue {deep:.2g} R, nu {tissue.poisson_ratio:g}, moduli {moduli}{layers}"


def main() -> None:
    """Draw, press, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="the number of the first that is pressed")
    parser.add_argument("--light", action="store_true", help="small loads only")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--narrow", action="store_true", help="narrow gaps, stiff blocks, soft tumours")
    parser.add_argument("--layered", action="store_true", help="layered scenes only")
    options = parser.parse_args()
    drawn = (draw_narrowed if options.narrow else draws)(options.seed)
    if options.layered:
        drawn = (scene for scene in drawn if scene.tissue.layer)
    print("| scene | force, N | x | ratio | stresses | stiffness | log-sensitivity | closure / plan's | / formulas' |")
    print("|---|---|---|---|---|---|---|---|---|")
    audits: list[Audit] = []
    for number, scene in zip(range(options.first + options.scenes), drawn, strict=False):
        if number < options.first:
            continue
        try:
            outcome = audit(scene, options.light)
        except (ProbeError, LimitReached) as fault:
            print(f"| {number}: {describe_scene(scene)} | refused: {fault} |", flush=True)
            continue
        audits.append(outcome)
        shares = " | ".join(f"{value:.2f}" for value in outcome.used)
        prefix = "" if outcome.closes else "> "
        opened = " | ".join(f"{prefix}{value:.3g}" for value in outcome.open)
        mark = " **optimistic**" if outcome.optimistic else ""
        print(
            f"| {number}: {describe_scene(scene)}{mark} | {outcome.force:.3g} | {outcome.x:.2g} | {shares} | {opened} |",
            flush=True,
        )
    _summary(audits)


def _summary(audits: list[Audit]) -> None:
    used = np.array([outcome.used for outcome in audits])
    closed = np.array([outcome.open for outcome in audits if outcome.closes])
    print(f"\n{len(audits)} scenes, {sum(outcome.optimistic for outcome in audits)} of them optimistic")
    print("largest shares of the bounds on ratio, stresses, stiffness, log-sensitivity:", np.round(used.max(axis=0), 2).tolist())
    print("medians:", np.round(np.median(used, axis=0), 2).tolist())
    if len(closed):
        lowest, middle = np.round(closed.min(axis=0), 2).tolist(), np.round(np.median(closed, axis=0), 1).tolist()
        print(f"closure over the plan's and over the formulas', {len(closed)} scenes: least {lowest}, median {middle}")


if __name__ == "__main__":
    main()

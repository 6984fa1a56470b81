"""Compare the designs that `optimize` chooses with the load as a variable and with a load limited by linear elasticity.

    python -m benchmarks.contact.designs [--scene example|nodule|gel]... [--force 0.25]... [--starts 2]

Three scenes: examples/scene.toml, a shallow nodule under a small probe, and a phantom of 5 kPa with a deeper tumour. Each row is
one run under one largest force: the best design within linear elasticity, and the best where the load is a variable, whose gain
over the other it tells. Costs are the processor's.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import process_time

from geometry import Scene, read_scene
from geometry.common.resources import Limits, use_limits
from geometry.scenes.scene_tables import CylinderTissue, Inclusion, Load
from probe_design.design_search.tumour_study import optimize_for_tumour
from probe_design.design_search.verification import TumourVerification
from tests.support.scenes import nodule

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.toml"


def gel() -> Scene:
    """Return a phantom of 5 kPa with a tumour of 10 mm, 14 mm deep."""
    tissue = CylinderTissue(shape="cylinder", radius=50e-3, depth=50e-3, youngs_modulus=5e3, poisson_ratio=0.48)
    body = Inclusion(diameter=10e-3, depth=14e-3, youngs_modulus=4e4, poisson_ratio=0.48)
    return read_scene(EXAMPLE).model_copy(update={"tissue": tissue, "inclusion": (body,)})


SCENES = {"example": lambda: read_scene(EXAMPLE), "nodule": nodule, "gel": gel}


def _describe(design: TumourVerification) -> str:
    probe, load = design.scene.probe, design.pressing
    lengths = probe.inner_radius, probe.tube_radius, probe.gap, probe.core_height
    sizes = ", ".join(f"{1e3 * length:.3g}" for length in lengths)
    return f"{sizes} | {load.force:.3g} ({load.limited_by}) | {design.value:.3g} ({design.lower:.3g} to {design.upper:.3g})"


def row(name: str, force: float, starts: int) -> str:
    """Return the line of one scene under one largest force."""
    begin, scene = process_time(), SCENES[name]().model_copy(update={"load": Load(force=force)})
    optimum = optimize_for_tumour(scene, lambda stage, done, total: None, starts=starts)
    best, start = optimum.best_tried, optimum.start
    linear_best = min((design.linear or design for design in optimum.finalists), key=lambda design: design.value)
    gain, error = best.compute_gain(linear_best)
    baseline = f"{start.value:.3g} at {start.pressing.force:.3g} N ({start.pressing.limited_by})"
    cells = name, f"{force:g}", baseline, _describe(linear_best), _describe(best), f"{gain:.0%} ({error:.1%})", optimum.status
    return f"| {' | '.join(cells)} | {process_time() - begin:.0f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", action="append", choices=[*SCENES])
    parser.add_argument("--force", action="append", type=float)
    parser.add_argument("--starts", type=int, default=2)
    given = parser.parse_args()
    design = "inner, outer radius, gap, height, mm | N (limited by) | sd (within)"
    print(f"| scene | up to, N | start's sd | linearly: {design} | freely: {design} | gain (error) | status | processor, s |")
    print("|" + "---|" * 12)
    with use_limits(Limits(seconds=3600.0)):
        for name in given.scene or SCENES:
            for force in given.force or (0.25,):
                print(row(name, force, given.starts), flush=True)


if __name__ == "__main__":
    main()

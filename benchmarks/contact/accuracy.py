"""Measure true errors, stated errors and cost of ``contact`` against the solutions of other codes.

    python -m benchmarks.contact.accuracy [--part references|gaps|faces|section] [-o docs/pictures/contact-section.png]

Costs are the processor's, of one process. The references' own uncertainties stand beside the errors.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import process_time

import numpy as np

from geometry import ProbeError, Scene, read_scene
from geometry.common.resources import Limits, use_limits
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.scene_tables import Contact, Load
from solver.axisymmetric.sections import build_sections
from solver.contact.evaluator import ContactEvaluator
from solver.contact.model import ContactModel
from solver.contact.path import Path as LoadPath
from solver.evaluation import press

FOLDER = Path(__file__).parents[2] / "tests" / "reference" / "contact"
GAPS = (0.05e-3, 0.1e-3, 0.2e-3, 0.5e-3)
PICTURE_DEPTH_OUTER_RADII = 0.45  # outer radii, of the picture


def references() -> None:
    """Print a line for each solution of other codes."""
    print("| scene | indentation, mm | ratio: true / stated (reference's own) | force | log-sensitivity (own) | processor, s |")
    print("|---|---|---|---|---|---|")
    for name, expected in json.loads((FOLDER / "expected.json").read_text()).items():
        scene = read_scene(FOLDER / f"{name}.toml")
        for row in expected["rows"]:
            start, depth = process_time(), row["indentation"]
            result = ContactEvaluator().evaluate(scene.model_copy(update={"load": Load(indentation=depth)}))
            seconds = process_time() - start
            assert result.ratio is not None
            assert result.stiffness is not None
            assert result.error_estimate is not None
            assert result.log_sensitivity is not None
            ratio_error = result.ratio / row["ratio"] - 1
            force = result.stiffness * depth / row["force"] - 1
            derivative = result.log_sensitivity / row["log_sensitivity"] - 1
            reference_error, reference_slope_error = (row[f"{key}_unc"] / row[key] for key in ("ratio", "log_sensitivity"))
            ratio = f"{ratio_error:+.2%} / {result.error_estimate:.2%} ({reference_error:.2%})"
            print(
                f"| {name} | {1e3 * depth:g} | {ratio} | {force:+.3%} | {derivative:+.1%} ({reference_slope_error:.1%}) | "
                f"{seconds:.1f} |",
                flush=True,
            )


def gaps() -> None:
    """Print ratio and log-sensitivity of the paper's probe and of the example against load, for several gaps."""
    for name, max_indentation in (("paper", 1e-3), ("example", 2e-3)):
        scene = read_scene(FOLDER / f"{name}.toml")
        print(
            f"\n{name}, up to {1e3 * max_indentation:g} mm\n\n| gap, mm | closes at, N | ratio at fifths of it | "
            "log-sensitivity | ends |"
        )
        print("|---|---|---|---|---|")
        for gap in GAPS:
            probe = scene.probe.model_copy(update={"gap": gap})
            print(_gap(scene.model_copy(update={"probe": probe}), gap, max_indentation), flush=True)


def _gap(scene: Scene, gap: float, max_indentation: float) -> str:
    try:
        loaded = press(scene, indentation=max_indentation, points=5)
    except ProbeError as fault:
        return f"| {1e3 * gap:g} | | | | {fault} |"
    closes = "-" if loaded.gap_closure_load is None else f"{loaded.gap_closure_load.force:.3g}"
    ratios = ", ".join(f"{value:.4g}" for value in loaded.ratio)
    derivatives = ", ".join("-" if value is None else f"{value:.3g}" for value in loaded.log_sensitivity)
    return f"| {1e3 * gap:g} | {closes} | {ratios} | {derivatives} | {loaded.force[-1]:.3g} N |"


def faces() -> None:
    """Print what round edges and other faces change on the example, with what is stated of the ratio."""
    scene = read_scene(FOLDER / "example.toml")
    kinds = {f"edges of {1e3 * radius:g} mm": Contact(edge_radius=radius) for radius in (0.0, 0.05e-3, 0.1e-3, 0.2e-3)}
    kinds |= {"frictionless": Contact(interface="frictionless"), "opening": Contact(interface="unilateral")}
    kinds |= {"opening, friction 0.3": Contact(interface="unilateral", friction=0.3)}
    print("| faces | ratio at 0.02 N (stated) | log-sensitivity | ratio at 0.05 N (stated) | log-sensitivity | processor, s |")
    print("|---|---|---|---|---|---|")
    for name, contact in kinds.items():
        start, cells = process_time(), []
        for force in (0.02, 0.05):
            pressed = scene.model_copy(update={"contact": contact, "load": Load(force=force)})
            with use_limits(Limits(seconds=600.0)):
                result = ContactEvaluator().evaluate(pressed, accuracy=0.03)
            cells.append(f"{result.ratio:.4f} ({result.error_estimate:.1%}) | {result.log_sensitivity:.4f}")
        print(f"| {name} | {' | '.join(cells)} | {process_time() - start:.0f} |", flush=True)


def section(picture: Path) -> None:
    """Draw the example's section down to ``PICTURE_DEPTH_OUTER_RADII``: cells as they are deformed, and its corner closer."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    scene = read_scene(FOLDER / "example.toml")
    sections = build_sections(scene)
    path = LoadPath(
        ContactModel.from_section(sections.section, sections.materials, "bonded", MeridianFineness(1, 0, 3)), sensitive=False
    )
    point = path.press_to_indentation(PICTURE_DEPTH_OUTER_RADII * path.radius)
    outlines = 1e3 * _outlines(path.model, point.equilibrium.state.v, point.indentation)
    figure = Figure(figsize=(10.0, 5.0), dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    radius = 1e3 * path.radius
    windows = (
        ((0, 2.6 * radius), (-2.2 * radius, 0.6 * radius)),
        ((0.93 * radius, 1.13 * radius), (-0.47 * radius, -0.33 * radius)),
    )
    for axes, (across, up) in zip(figure.subplots(1, 2), windows, strict=True):
        axes.add_collection(PolyCollection(list(outlines), facecolors="tab:blue", edgecolors="k", linewidths=0.5, alpha=0.3))
        axes.set(xlim=across, ylim=up, aspect="equal", xlabel="r, mm", ylabel="z, mm")
    figure.suptitle(f"examples/scene.toml at {1e3 * point.indentation:.3g} mm, {point.force:.3g} N")
    figure.savefig(picture)


def _outlines(model: ContactModel, v: np.ndarray, depth: float) -> np.ndarray:
    """Return the deformed edges of the elements, m, shape (n, points, 2)."""
    from geometry.meridian.mesh import compute_nodes
    from solver.elements.shape_functions import build_shapes, evaluate_functions

    t = np.linspace(0, 1, 9)[:-1]
    zero, unit = np.zeros_like(t), np.ones_like(t)
    around = np.concatenate([np.stack(pair, axis=-1) for pair in ((t, zero), (unit, t), (1 - t, unit), (zero, 1 - t))])
    shapes = build_shapes(model.elements.shapes.order)
    value = evaluate_functions(around, shapes.degrees)[0][:, : shapes.skeleton]
    moved = model.compute_displacements(v, depth).reshape(len(model.mesh.body), 2, -1)
    return np.asarray(compute_nodes(model.section, model.mesh, around) + np.einsum("gs,ncs->ngc", value, moved))


def main() -> None:
    """Run the parts asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=("references", "gaps", "faces", "section"))
    parser.add_argument("-o", "--picture", type=Path, default=Path("contact-section.png"))
    options = parser.parse_args()
    if options.part in (None, "references"):
        references()
    if options.part in (None, "gaps"):
        gaps()
    if options.part in (None, "faces"):
        faces()
    if options.part in (None, "section"):
        section(options.picture)


if __name__ == "__main__":
    main()

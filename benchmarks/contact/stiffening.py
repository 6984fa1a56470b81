"""Print what a tissue that stiffens changes of ratio and log-sensitivity, and the bias of inverting by other laws.

The example's tissue has Yeoh's law with C2 / C1 of 0, 1, 5 and 17 (the breast of `tissue show breast-ex-vivo`), the same modulus
at no strain, and is pressed to forces of a hand. A reading of it is inverted for E_object by linear elasticity and by a
neo-Hookean tissue: the bias is the difference of ln ratio over the model's log-sensitivity. A second table has the ratio of one
press and that about a preload of the same force, and the bias of taking one for the other. Draws docs/pictures/stiffening.png.

    python -m benchmarks.contact.stiffening

Duration: four minutes.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import probe_design
from geometry import read_scene
from solver.results.result import LoadCurve

SCENE, PICTURE = "examples/scene.toml", "docs/pictures/stiffening.png"
CONSTANTS = (0.0, 1.0, 5.0, 17.1)  # C2 / C1
FORCES_N = (0.04, 0.08, 0.12, 0.16, 0.2)
PRELOADS_N = (0.0125, 0.025, 0.05)


def press(c2: float) -> LoadCurve:
    """Return the example on tissue of Yeoh's law, pressed to the forces."""
    return probe_design.press(
        read_scene(SCENE).replace({"tissue.law": "yeoh", "tissue.c2_over_c1": c2}), force=FORCES_N[-1], points=len(FORCES_N)
    )


def compute_bias(curve: LoadCurve, log_ratio: np.ndarray, sensitivity: np.ndarray) -> np.ndarray:
    """Return the bias of ln E_object by a model with these ln ratios and log-sensitivities at the same forces."""
    return np.asarray((np.log(curve.ratio) - log_ratio[: len(curve.ratio)]) / sensitivity[: len(curve.ratio)])


def draw(curves: dict[float, LoadCurve], biases: dict[float, np.ndarray]) -> Figure:
    """Return a figure of ratio, log-sensitivity and bias over force."""
    figure = Figure(figsize=(10.0, 3.6), dpi=150, facecolor="white", layout="constrained")
    for axes, name in zip(
        figure.subplots(1, 3), ("ratio", "log-sensitivity", "bias of ln E_object, linear inversion"), strict=True
    ):
        for c2, curve in curves.items():
            values = {"ratio": curve.ratio, "log-sensitivity": curve.log_sensitivity}.get(name, biases[c2])
            axes.plot(curve.force, np.array(values, dtype=float), marker=".", label=f"C2/C1 = {c2:g}")
        axes.set_xlabel("force, N")
        axes.set_title(name, fontsize=10)
        axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def print_preloads() -> None:
    """Print the ratio of one press to a force, the tangent ratio about it, and the bias of inverting one as the other."""
    print("C2/C1  force, N  ratio of a press  about a preload  error   bias of ln E_object")
    for c2 in (0.0, 5.0):
        scene = read_scene(SCENE).replace({"tissue.law": "yeoh", "tissue.c2_over_c1": c2})
        for force in PRELOADS_N:
            pressed, tangent = (
                probe_design.evaluate(scene.replace({"load.force": peak, "load.preload": preload}), evaluator="contact")
                for peak, preload in ((force, 0.0), (2 * force, force))
            )
            assert pressed.ratio is not None
            assert tangent.ratio is not None
            assert pressed.log_sensitivity is not None
            bias = np.log(tangent.ratio / pressed.ratio) / pressed.log_sensitivity
            print(
                f"{c2:5g}  {force:8.3f}  {pressed.ratio:16.4f}  {tangent.ratio:15.4f}  "
                f"{tangent.error_estimate:.4f}  {bias:+19.3f}"
            )


def main() -> None:
    """Print the table and draw the picture."""
    linear = probe_design.evaluate(SCENE, evaluator="axisymmetric", accuracy=1e-3)
    assert linear.ratio is not None
    assert linear.log_sensitivity is not None
    curves = {c2: press(c2) for c2 in CONSTANTS}
    plain = curves[0.0]
    biases = {}
    print("C2/C1  force, N  indentation, mm  ratio   error   log-sensitivity  bias of ln E_object: linear, neo-Hookean")
    for c2, curve in curves.items():
        count = len(curve.force)
        biases[c2] = compute_bias(curve, np.full(count, np.log(linear.ratio)), np.full(count, linear.log_sensitivity))
        by_plain = compute_bias(curve, np.log(plain.ratio), np.array(plain.log_sensitivity, dtype=float))
        columns = (curve.force, curve.indentation, curve.ratio, curve.error_estimate, curve.log_sensitivity, biases[c2], by_plain)
        for force, depth, ratio, error, sensitivity, bias, other in zip(*columns, strict=True):
            start = f"{c2:5g}  {force:8.2f}  {1e3 * depth:15.2f}  {ratio:.4f}  {error:.4f}"
            print(f"{start}  {sensitivity:15.4f}  {bias:+27.2f}  {other:+11.2f}")
        if curve.stopped:
            print(f"{c2:5g}  ends early: {curve.stopped}")
    draw(curves, biases).savefig(PICTURE)
    print_preloads()


if __name__ == "__main__":
    main()

"""Compute what the ratio's phase adds to the ratio on three scenes: the standard deviation of ln E_object by one reading.

``python -m benchmarks.evaluators.phase`` prints the table of docs/explanation/phase.md. Beside the tumour's modulus the
tissue's is known to 30 % and each loss factor to 20 %, by Fisher's information of ratio and phase from the derivatives
that ``evaluate`` returns.

Duration: a minute.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from geometry import Scene, read_scene
from geometry.scenes.variables import list_loss_factors
from solver import evaluate

ROOT = Path(__file__).parents[2]
SCENES = ("examples/scene.toml", "examples/skin.toml", "tests/reference/axisymmetric/shallow.toml")
LOSSES = {"tissue": 0.2, "inclusion": 0.1, "tissue.layer[0]": 0.2}
NOISE, DEGREES = 0.01, 0.1  # of the ratio, relative; of the phase
MODULUS_PRIOR_SD, LOSS_PRIOR_SD, WIDE_PRIOR_SD = (
    0.3,
    0.2,
    3.0,
)  # prior sd of ln of the tissue's moduli, of ln of loss factors, of ln E_object
FREQUENCY = 2.0  # Hz


def lossy(scene: Scene) -> Scene:
    """Return a scene whose tissue and tumour lose as above."""
    losses = {key: LOSSES[key.removesuffix(".loss_factor")] for key in list_loss_factors(scene) if not key.startswith("probe")}
    return scene.replace(losses)


def spreads(scene: Scene) -> tuple[float, float, float, float]:
    """Return phase and its error, rad, and the standard deviation of ln E_object by the ratio alone and by both."""
    result = evaluate(scene, "axisymmetric", 0.003, frequency=FREQUENCY)
    derivatives, losses = result.ratio_phase_derivatives, list_loss_factors(scene)
    assert derivatives is not None
    assert result.ratio_phase is not None
    assert result.ratio_phase_error is not None
    names = [name for name in LOSSES if f"{name}.loss_factor" in losses]
    modulus = [_modulus(scene, name) for name in names]
    loss_derivatives = [derivatives[f"{name}.loss_factor"] * (1 + losses[f"{name}.loss_factor"] ** 2) for name in names]
    turns = [derivatives[f"{name}.youngs_modulus"] * change for name, change in zip(names, modulus, strict=True)]
    by_losses = [derivatives[f"{name}.loss_factor"] * losses[f"{name}.loss_factor"] for name in names]
    jacobian = np.array([[*loss_derivatives, *(0.0 for _ in names)], [*turns, *by_losses]])
    prior = [WIDE_PRIOR_SD if name == "inclusion" else MODULUS_PRIOR_SD for name in names] + [LOSS_PRIOR_SD for _ in names]
    phase_noise = math.hypot(math.radians(DEGREES), result.ratio_phase_error / math.sqrt(3))
    noise, which = np.array([NOISE, phase_noise]), names.index("inclusion")
    alone, combined = (_spread(jacobian[:rows], noise[:rows], np.array(prior), which) for rows in (1, 2))
    return result.ratio_phase, result.ratio_phase_error, alone, combined


def _modulus(scene: Scene, name: str) -> float:
    bodies = {"tissue": scene.tissue, "inclusion": scene.inclusion[0]}
    return (bodies | {f"tissue.layer[{k}]": layer for k, layer in enumerate(scene.tissue.layer)})[name].youngs_modulus


def _spread(jacobian: np.ndarray, noise: np.ndarray, prior: np.ndarray, which: int) -> float:
    information = (jacobian.T / noise**2) @ jacobian + np.diag(prior**-2.0)
    return float(np.sqrt(np.linalg.inv(information)[which, which]))


def main() -> None:
    """Print the table."""
    print("| scene | phase, rad | its error | sd of ln E_object by the ratio | by ratio and phase |\n|---|---|---|---|---|")
    for name in SCENES:
        phase, error, alone, combined = spreads(lossy(read_scene(ROOT / name)))
        print(f"| `{name}` | {phase:.4f} | {error:.4f} | {alone:.2f} | {combined:.2f} |", flush=True)


if __name__ == "__main__":
    main()

"""Evaluator ``published``: the paper's equivalent modulus by eq. (8) as printed, and the list of the paper's defects."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Scene
from solver.published.equations import compute_modulus_corrected, compute_modulus_from_compatibility, compute_modulus_printed
from solver.results.evaluator import ProgressCallback
from solver.results.refusals import GEOMETRY_KINDS, find_refusal, is_round
from solver.results.result import Curve, Result
from solver.results.warnings import Note

PAPER_DEFECTS = (
    "eq. (1) is a far field: on the axis sigma [1 - (d / sqrt(a^2 + d^2))^3] holds, at d = a 0.646 sigma, printed 1.5 sigma",
    "eqs. (4), (6), (7) add the object's shortening without subtracting that of the tissue it replaces: "
    "a rigid object softens the tissue, one of the tissue's modulus does not vanish",
    "eq. (8) has (1-nu)^2 where eq. (7) gives (1-nu^2)",
    "eqs. (9) to (11) leave out thicknesses and give the tumour's shortening the tissue's modulus: a homogeneous block gets E/3",
    "section 2.4 has spheres of 50 and 80 mm in a block 60 mm deep; 5 and 8 mm keep its '60 % larger'",
    "sections 2.1, 2.2: 1 N would crush a block of 100 Pa, so the moduli serve small loads only",
    "section 2.1 gives no radii, heights or film diameters",
    "eq. (12): psi_1 and psi_2 are never given; with 1 for both, Table 1 sums to +2 pC/N",
    "Table 3: the ratio at position 4 is -26.6, its sign is lost; the stresses balance 1 N with another area at each position, "
    "so they are not mean stresses of one probe",
)


@dataclass(frozen=True)
class Published:
    """The paper's equivalent modulus, eq. (8) as printed, with ``a`` the probe's outer radius."""

    name: str = "published"
    summary: str = "the paper's eqs. (1)-(12) as printed; an equivalent modulus, no stresses; for reproducing the paper"

    def refusal(self, scene: Scene) -> str | None:
        """Return which evaluator to use instead if the paper's equations cannot describe the scene, and why; else None."""
        if scene.tissue.layer:
            return find_refusal(scene, (*GEOMETRY_KINDS, "crossed sphere", "layers"))
        if len(scene.inclusion) != 1 or scene.inclusion[0].diameter is None:
            return "axisymmetric or closed-form unless there is exactly one sphere: eq. (8) has one diameter, one depth"
        if not is_round(scene):
            return "closed-form for an inclusion off the axis of an upright probe"
        return None

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Return ``equivalent_modulus``; the equations give no film stresses, so the other values are None.

        ``accuracy`` has no effect: the equations have no error estimate.

        Raises
        ------
        Refusal
            The equations cannot describe the scene.
        """
        start = perf_counter()
        reason = self.refusal(scene)
        if reason is not None:
            raise Refusal("evaluator", self.name, reason)
        body, tissue = scene.inclusion[0], scene.tissue
        sizes = scene.probe.tube_radius, body.depth, body.diameter or 0.0
        moduli = {"E_matrix": tissue.youngs_modulus, "E_object": body.youngs_modulus}
        modulus = compute_modulus_printed(*sizes, nu=tissue.poisson_ratio, **moduli)
        consistent_modulus = compute_modulus_from_compatibility(*sizes, nu=tissue.poisson_ratio, **moduli)
        try:
            corrected = f"{compute_modulus_corrected(*sizes, **moduli):.4g} Pa without their defects"
        except InputError as fault:
            corrected = f"none without their defects ({fault})"
        null = "stresses, ratio and error_estimate are null: the paper's equations give an equivalent modulus, not film stresses"
        summary = f"equivalent_modulus is {modulus:.4g} Pa by eq. (8), {consistent_modulus:.4g} Pa by eq. (7), {corrected}"
        texts = (summary, *(f"defect of the paper: {defect}" for defect in PAPER_DEFECTS))
        notes = (Note("null", null), *(Note("published", text) for text in texts))
        return Result(self.name, perf_counter() - start, equivalent_modulus=modulus, warnings=notes)

    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """Refuse: equations that give no stresses reach no accuracy.

        Raises
        ------
        Refusal
            Always.
        """
        raise Refusal("accuracy", accuracy, "none for this evaluator: the paper's equations give no film stresses")

    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """Refuse: the equations give no ratio, of which a curve could be computed.

        Raises
        ------
        Refusal
            Always.
        """
        raise Refusal("evaluator", self.name, "any other for a curve: the paper's equations give no film stresses")


def create_evaluator(progress: ProgressCallback | None = None) -> Published:
    """Return the evaluator; it reports no progress."""
    return Published()

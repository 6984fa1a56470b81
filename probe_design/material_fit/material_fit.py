"""The result of a fit: constants with their errors, the misfit in words, and the table that a scene takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.probe import Material
from geometry.scenes.sourced_numbers import Number, format_comment, format_toml
from geometry.scenes.units import format_modulus
from probe_design.material_fit.curve import StressCurve
from probe_design.material_fit.fit import Constants, choose_constants, find_stable_strain, find_tension_strain, fit_constants

GOOD_MISFIT_RELATIVE, FAIR_MISFIT_RELATIVE = 0.02, 0.05  # of the largest stress; between samples tissue scatters by 10 % or more
MAX_PER_CENT_STRAIN = 3.0  # a strain without unit above it may be meant in per cent
NAMES = {1: "neo-Hookean", 2: "Yeoh, 2 constants", 3: "Yeoh, 3 constants"}


@dataclass(frozen=True)
class MaterialFit:
    """A law fitted to a measured curve.

    Attributes
    ----------
    curve
        The measured points, nominal stress.
    laws
        The fitted laws, from one to three constants.
    chosen
        The one that is printed for a scene.
    poisson_ratio
        Assumed: a curve of one stress does not determine it.
    source
        Name of the curve's file.
    """

    curve: StressCurve
    laws: tuple[Constants, ...]
    chosen: Constants
    poisson_ratio: float
    source: str

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus at small strain, Pa, from the shear modulus 2 C1."""
        return float(4 * (1 + self.poisson_ratio) * self.chosen.values[0])

    @property
    def log_sd(self) -> float:
        """Standard deviation of ln E: that of C1."""
        return float(np.sqrt(self.chosen.covariance[0, 0]) / self.chosen.values[0])

    @property
    def ratio_sds(self) -> tuple[float, float]:
        """Standard deviations of C2 / C1 and C3 / C1."""
        first = self.chosen.values[0]
        gradients: list[Floats] = [np.eye(3)[k] / first - np.eye(3)[0] * self.chosen.values[k] / first**2 for k in (1, 2)]
        second, third = (float(np.sqrt(np.maximum(g @ self.chosen.covariance @ g, 0.0))) for g in gradients)
        return (second if self.chosen.count > 1 else 0.0), (third if self.chosen.count > 2 else 0.0)

    @property
    def law_strain(self) -> float:
        """Strain in uniaxial tension with the largest I - 3 of the curve: up to there the law was measured."""
        return find_tension_strain(float(self.curve.distortion.max()))

    @property
    def stable_strain(self) -> float | None:
        """Strain in uniaxial tension up to which the law is stable; None where it is stable throughout."""
        strain = find_stable_strain(self.chosen)
        return strain if np.isfinite(strain) else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user."""
        texts = []
        if self.chosen.misfit > FAIR_MISFIT_RELATIVE:
            texts.append(f"the law fits poorly ({self.describe_misfit()}): use --max-strain for the strains that matter")
        if self.chosen.is_limited:
            texts.append("the best constants are unstable within the curve's range: the best stable ones are given")
        if self.curve.test == "tension" and self.curve.deformation.max() - 1 > MAX_PER_CENT_STRAIN:
            texts.append(f"the strain is taken as {self.curve.deformation.max() - 1:.0%}: one in per cent needs the unit %")
        return tuple(texts)

    def describe_misfit(self) -> str:
        """Return the misfit in words."""
        share = self.chosen.misfit
        grade = "good" if share <= GOOD_MISFIT_RELATIVE else "fair" if share <= FAIR_MISFIT_RELATIVE else "poor"
        return f"{grade}: {format_percent(share)} of the largest stress, root mean square, R2 {self._compute_r2():.5g}"

    def describe_stability(self) -> str:
        """Return in words up to where the law is stable."""
        limit = self.stable_strain
        beyond = "throughout" if limit is None else f"up to a strain of {limit:.3g} in tension"
        return f"stable by Drucker's condition {beyond}" + (
            ", which the fit enforces over the curve" if self.chosen.is_limited else ""
        )

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design material fit``; SI units."""
        values, covariance = self.chosen.values.tolist(), self.chosen.covariance.tolist()
        ratios, sds = self.chosen.ratios, self.ratio_sds
        return {
            "law": self._table["law"].value, "youngs_modulus": self.youngs_modulus, "log_sd": self.log_sd,
            "poisson_ratio": self.poisson_ratio, "c2_over_c1": ratios[0], "c2_over_c1_sd": sds[0],
            "c3_over_c1": ratios[1], "c3_over_c1_sd": sds[1],
            "constants": values, "covariance": covariance, "test": self.curve.test, "points": int(self.curve.stress.size),
            "deformation_range": [float(self.curve.deformation.min()), float(self.curve.deformation.max())],
            "law_strain": self.law_strain, "stable_strain": self.stable_strain, "is_limited": self.chosen.is_limited,
            "misfit": self.chosen.misfit, "r2": self._compute_r2(), "misfit_words": self.describe_misfit(),
            "laws": {NAMES[law.count]: {"constants": law.values.tolist(), "misfit": law.misfit} for law in self.laws},
            "toml": self.to_toml(), "warnings": list(self.warnings),
        }  # fmt: skip

    def to_toml(self) -> str:
        """Return a table of a scene file, each number below a comment with its source."""
        lines = format_comment(f"fitted to {self.source}: {self.curve.describe_range()}, {self.curve.stress.size} points")
        lines += format_comment(f"misfit {self.describe_misfit()}; {self.describe_stability()}")
        also = "  # as well [[tissue.layer]], [[inclusion]], [probe.inner], [probe.outer]"
        return "\n".join([*lines, f"[tissue]{also}", *format_toml(self._table), ""])

    @property
    def _table(self) -> dict[str, Number]:
        """The numbers of a scene's table with their explanations."""
        ratios, sds = self.chosen.ratios, self.ratio_sds
        modulus = Number(format_modulus(self.youngs_modulus), f"at small strain; standard deviation of ln E {self.log_sd:.2g}")
        poisson = Number(self.poisson_ratio, "assumed: the curve does not determine it")
        table = {"youngs_modulus": modulus, "poisson_ratio": poisson, "law": Number("neo-hookean", NAMES[self.chosen.count])}
        if self.chosen.count > 1:
            table["law"] = Number("yeoh", NAMES[self.chosen.count])
            table["c2_over_c1"] = Number(float(f"{ratios[0]:.4g}"), f"standard deviation {sds[0]:.2g}")
        if self.chosen.count > 2:
            table["c3_over_c1"] = Number(float(f"{ratios[1]:.4g}"), f"standard deviation {sds[1]:.2g}")
        explanation = "strain in uniaxial tension with the largest I - 3 of the curve"
        return table | {"law_strain": Number(float(f"{self.law_strain:.3g}"), explanation)}

    def _compute_r2(self) -> float:
        """Return the share of the stress's variance that the chosen law explains."""
        return float(1 - self.chosen.residual**2 / np.var(self.curve.stress))


def build_fit(curve: StressCurve, law: str, poisson_ratio: float, source: str) -> MaterialFit:
    """Fit the laws to a curve and choose one.

    Parameters
    ----------
    curve
        To be fitted.
    law
        "auto", "neo-hookean" or "yeoh": which laws may be chosen.
    poisson_ratio
        For Young's modulus and the scene's table.
    source
        Name of the curve, for the table.

    Raises
    ------
    InputError
        No stable law fits, or a constant is out of the range that a scene allows.
    """
    laws = tuple(fit_constants(curve, count) for count in (1, 2, 3))
    candidates = {"auto": laws, "neo-hookean": laws[:1], "yeoh": laws[1:]}[law]
    chosen = choose_constants(curve, candidates)
    if np.isfinite(find_stable_strain(chosen)):  # corners of blocks strain beyond any curve
        steady = [c for c in candidates if not np.isfinite(find_stable_strain(c)) and c.misfit <= GOOD_MISFIT_RELATIVE]
        chosen = steady[-1] if steady else chosen
    fitted = MaterialFit(curve, laws, chosen, poisson_ratio, source)
    second, third = chosen.ratios
    constants = {"law": "yeoh", "c2_over_c1": second, "c3_over_c1": third}
    try:
        Material.model_validate({"youngs_modulus": fitted.youngs_modulus, "poisson_ratio": poisson_ratio} | constants)
    except ValueError as fault:
        raise InputError("curve", source, "a curve whose law a scene can have: check the units of stress and strain") from fault
    return fitted

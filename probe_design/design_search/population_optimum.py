"""Define the result of an optimisation for a population: verdict, active limits and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from geometry.common.json_types import JsonObject
from geometry.scenes.scene_file import scene_to_dict
from probe_design.design_search.optimum import NO_GAIN, Optimum
from probe_design.design_search.variables import SAME_DESIGN_TOLERANCE_RELATIVE, Limit
from probe_design.design_search.verification import GAIN_SIGNIFICANCE, PopulationVerification
from probe_design.design_search.workshop import Robustness
from probe_design.populations.performance import Performance
from probe_design.populations.tables import DesignLimits

LINEARITY_LIMITS = ("linearity", "gap_closure")  # limits of the force due to linear elasticity


@dataclass(frozen=True)
class PopulationOptimum(Optimum[PopulationVerification]):
    """The result of an optimisation for a population.

    Attributes
    ----------
    single
        The verified optimum for one tumour in the middle of the population; None if there is none.
    robust
        Effect of workshop tolerances on start and finalists, by the closed form.
    why_no_single
        The reason why there is no ``single``, in words.
    """

    single: PopulationVerification | None
    robust: tuple[Robustness, ...]
    why_no_single: str = ""

    @property
    def others(self) -> dict[str, PopulationVerification]:
        """See ``Optimum``."""
        return {} if self.single is None else {"one tumour": self.single}

    @property
    def limits(self) -> tuple[Limit, ...]:
        """See ``Optimum``; with the limits of the force."""
        pressed, given = self.best.pressed, self.design.limits
        rows = [limit for limit in super().limits if not (self.search_space.shelf and "modulus" in limit.name)]
        rows += [
            Limit(name, _get_limit_value(given, name, pressed.allowed[name]), pressed.limited_by == name)
            for name in pressed.allowed
        ]
        if given.charge is not None:
            min_charge = given.charge[0]
            active = abs(pressed.charge[0] - min_charge) <= SAME_DESIGN_TOLERANCE_RELATIVE * min_charge
            rows.append(Limit("least charge", min_charge, active))
        return tuple(rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """See ``Optimum``."""
        texts = [note for item in (self.start, self.best) if (note := item.performance.draw.note)]
        texts += self.warn_wide_start()
        texts += self._warn_unused_force()
        if (warning := explain_low_detection(self.best.performance)) is not None:
            texts.append(warning)
        texts += self._warn_missing_channels()
        if self.why_no_single:
            texts.append(f"no design for one tumour to compare with: {self.why_no_single}")
        return tuple(dict.fromkeys(texts))

    def _warn_missing_channels(self) -> Iterator[str]:
        """Yield a warning that names the channels without results because their noise is too small."""
        missing = [name for name, performance in self.best.performance.by_observable.items() if performance is None]
        if missing:
            named = " and ".join(missing)
            yield f"no results for {named}: [noise] gives this channel less noise than any instrument has"

    def _warn_unused_force(self) -> Iterator[str]:
        """Yield a warning if linear elasticity limits the force below the allowed one; ``contact`` takes no off-axis tumours."""
        pressed = self.best.pressed
        key = next(name for name in ("scene", "force") if name in pressed.allowed)
        if pressed.limited_by in LINEARITY_LIMITS:
            named = "limits.force" if key == "force" else "the scene's load"
            yield (
                f"{named} of {pressed.allowed[key]:.3g} N is more than linear elasticity allows: searched and verified under "
                f"{pressed.force:.3g} N (limited by {pressed.limited_by}); contact, which knows more, takes no tumours "
                "beside the axis"
            )

    @property
    def verdict(self) -> str:
        """See ``Optimum``."""
        kind, (gain, error) = self.design.objective.maximise, self.gain
        start, best = ("{:.3f} ± {:.2g}".format(*verified.objective) for verified in (self.start, self.best_tried))
        change = f"a gain of {gain:.3g}; twice its error is {GAIN_SIGNIFICANCE * error:.2g}"
        if self.winner is not None:
            return f"improved: {kind} {best} of the recommended design, {start} of the start, {change}"
        if not self.finalists:
            return f"{NO_GAIN}; no other design within the limits could be verified, {kind} of the start is {start}"
        return f"{NO_GAIN}; {kind} {best} of the best design tried, {start} of the start, {change}"

    def build_summary(self, files: list[str]) -> JsonObject:
        """See ``Optimum``."""
        named = {"start": self.start, "single": self.single, "optimum": self.best, "found": self.best_tried}
        return super().build_summary(files) | {
            "maximise": self.design.objective.maximise,
            "statistic": self.design.objective.statistic,
            "population": {name: None if item is None else item.performance.as_dict() for name, item in named.items()},
            "single_reason": self.why_no_single or None,
            "pressing": {name: None if item is None else item.summarize_pressing() for name, item in named.items()},
            "designs": {name: None if item is None else scene_to_dict(item.scene) for name, item in named.items()},
            "materials": list(self.best.materials),
            "tolerances": [item.as_dict() for item in self.robust],
        }


def explain_low_detection(performance: Performance) -> str | None:
    """Return a warning if no more tumours are detected than false alarms would give, else None."""
    lower_limit = performance.means["detection"] - GAIN_SIGNIFICANCE * performance.errors["detection"].total
    if lower_limit > performance.false_alarm:
        return None
    detected = f"{100 * performance.means['detection']:.3g} ± {100 * performance.errors['detection'].total:.2g} of 100 tumours"
    alarms = f"{100 * performance.false_alarm:g} of 100"
    return (
        f"the recommended design detects {detected}, no more than false alarms alone may, {alarms}; "
        "the report's 'What would help most' says what to change"
    )


def _get_limit_value(given: DesignLimits, name: str, force: float) -> float:
    """Return the value of a limit in the design file; for a limit without a number, the force that it allows, N."""
    stated = getattr(given, name, None)
    if stated is None or isinstance(stated, bool):
        return force
    return float(stated[1] if name == "charge" else stated)

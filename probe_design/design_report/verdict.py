"""Write the verdict of an optimisation in plain words: what to build, what it detects and cannot do, what would help most."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from geometry.common.percent import format_percent
from geometry.scenes.catalogue import list_materials
from geometry.scenes.film import RIGID_BOND, Film
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.design_report.depth_map import DepthMap
from probe_design.design_report.improvements import Improvement
from probe_design.design_search.optimum import PopulationOptimum, TumourOptimum
from probe_design.design_search.verification import is_significant
from probe_design.populations.population import ScenePopulation
from probe_design.populations.tables import ChannelSet

CHANNEL_PHRASES: dict[ChannelSet, str] = {"ratio": "ratio alone", "stiffness": "stiffness alone", "both": "ratio and stiffness"}
MIN_RESOLVED_FRACTION = 0.5  # of the tumours, below which the verdict says that the probe cannot resolve their stiffness
MIN_RESOLVED_GAIN = 0.05  # of the tumours, below which a change is not named as a remedy
MAX_TOLERANCE_LOSS = 0.1  # of the detection, above which the verdict warns of workshop tolerances
INTERFACE_ASSUMPTIONS = {
    "bonded": "The blocks stick to the tissue, as on dry skin; under gel they slip (interface = 'frictionless').",
    "frictionless": "The blocks slip on the tissue and never lift off it; on dry skin they stick (interface = 'bonded').",
    "unilateral": "The blocks lift off and rub as [contact] states; its friction is that of your skin or gel.",
}


def write_population_verdict(
    optimum: PopulationOptimum, maps: dict[str, DepthMap], improvements: Sequence[Improvement]
) -> tuple[str, ...]:
    """Return the verdict on an optimisation for a population, one or two sentences on each question.

    Parameters
    ----------
    optimum
        The result.
    maps
        Depth maps by the headings of the designs, of which the last is the recommended one.
    improvements
        Changes of the readings from ``compute_improvements``, the first of which changes nothing.
    """
    return tuple(_iterate_population_verdict(optimum, maps, improvements))


def write_tumour_verdict(optimum: TumourOptimum) -> tuple[str, ...]:
    """Return the verdict on an optimisation for one tumour read once, one or two sentences on each question."""
    best, limit = optimum.best, MAX_RESOLVED_LOG_SD
    texts = [_describe_probe(optimum.scene, best.force[0], improved=optimum.winner is not None)]
    if not math.isfinite(best.value):
        return (*texts, "Its readings do not depend on the tumour's stiffness.")
    spread = f"a factor of {math.exp(min(best.value, math.log(9999))):.2g} either way (one standard deviation)"
    if best.value <= limit:
        return (*texts, f"One reading determines the tumour's stiffness to {spread}.")
    # by eq. DS.6 the standard deviation is proportional to the noise
    noise, charge = (item * limit / best.value for item in (optimum.noise.ratio, optimum.noise.charge))
    return (
        *texts,
        f"It cannot resolve the tumour's stiffness: one reading determines it to {spread}.",
        f"What would help most: noise of {format_percent(noise)} on the ratio and {charge * 1e12:.2g} pC on each charge, or many "
        "readings; a scan that detects tumours is designed by probe-design optimize DESIGN (--template prints a DESIGN file).",
    )


def list_assumptions(optimum: PopulationOptimum | TumourOptimum) -> tuple[str, ...]:
    """Return what the numbers of an optimisation assume, the most important assumptions first."""
    scene, noise = optimum.design.scene, optimum.design.noise
    texts = []
    if isinstance(optimum, PopulationOptimum):
        texts.append(
            "The tumours are those of [population]: round, and bonded to their tissue. Others are detected more or less often."
        )
        texts.append(
            f"The noise is that of [noise]: {format_percent(noise.white, 6)} of each ratio and {noise.charge * 1e12:g} pC on "
            "each charge. probe-design read measures that of your bench."
        )
        if optimum.design.protocol.blank:
            texts.append("The baseline reading is taken over the same tissue and layers, with no tumour below.")
    else:
        texts.append("The tumour is round, bonded to its tissue, and its place and size are known.")
    texts.append(INTERFACE_ASSUMPTIONS[scene.contact.interface])
    texts.append("Tissue and blocks are elastic: they neither creep nor relax while a reading is taken.")
    return tuple(texts)


def format_film(film: Film | None) -> str:
    """Return the thickness of the inner and, where it differs, the outer film in um."""
    thicknesses = [] if film is None else [f"{item.thickness * 1e6:.4g}" for item in film.by_block]
    return " / ".join(dict.fromkeys(thicknesses)) or "-"


def format_bonds(film: Film | None) -> str:
    """Return the bonds of the inner film to block and base, by name or by thickness in um."""
    bonds = [] if film is None else [film.bond_to_block or RIGID_BOND, film.bond_to_base or RIGID_BOND]
    return " / ".join(bond.name or ("rigid" if bond.is_rigid else f"{bond.thickness * 1e6:.4g} um") for bond in bonds) or "-"


def _iterate_population_verdict(
    optimum: PopulationOptimum, maps: dict[str, DepthMap], improvements: Sequence[Improvement]
) -> Iterator[str]:
    """Yield the sentences of ``write_population_verdict``."""
    best, improved = optimum.best, optimum.winner is not None
    yield _describe_probe(optimum.scene, best.pressed.force, improved=improved)
    if optimum.search_space.film_choices:
        film = optimum.scene.probe.film
        yield f"Its films: {format_film(film)} um, bonds to block / base {format_bonds(film)}."
    yield _describe_detection(optimum, [*maps.values()][-1])
    yield _describe_resolution(best.performance.means["resolved"], improvements)
    yield _describe_improvement(optimum, improvements)
    yield from _describe_tolerances(optimum)


def _describe_probe(scene: Scene, force: float, *, improved: bool) -> str:
    """Return the sizes, materials and force of the probe to build, or of the start where no design is better."""
    probe = scene.probe
    heights = " and ".join(f"{1e3 * height:.4g} mm" for height in dict.fromkeys((probe.core_height, probe.tube_height)))
    return (
        f"{'Build this' if improved else 'Keep the start, as no better design was verified'}: inner radius "
        f"{1e3 * probe.inner_radius:.4g} mm, outer radius {1e3 * probe.tube_radius:.4g} mm, gap {1e3 * probe.gap:.4g} mm, height "
        f"{heights}; the inner block of {_describe_material(probe.inner)}, the outer of {_describe_material(probe.outer)}. "
        f"Press it with {force:.3g} N."
    )


def _describe_material(material: Material) -> str:
    """Return a material by its catalogue name, or by its modulus and the elastomer of the catalogue that is nearest to it."""
    if material.material:
        return material.material
    modulus, elastomers = material.youngs_modulus, [item for item in list_materials().values() if item.kind == "elastomer"]
    nearest = min(elastomers, key=lambda item: abs(math.log(item.youngs_modulus / modulus)))
    return f"{modulus / 1e3:.4g} kPa (nearest to buy: {nearest.name}, {nearest.youngs_modulus / 1e3:.3g} kPa)"


def _describe_detection(optimum: PopulationOptimum, depth_map: DepthMap) -> str:
    """Return how many tumours are detected, by which channels, and down to which depth the largest are."""
    performance, channel = optimum.best.performance, optimum.design.protocol.channel_set
    parts = []
    for name in dict.fromkeys((channel, "ratio", "both")):
        item = performance.by_channels.get(name)
        if item is not None:
            mean, error = item.means["detection"], item.errors["detection"].total
            digits = 0 if 100 * error >= 1 else 1
            parts.append(f"{100 * mean:.{digits}f} ± {100 * error:.{digits}f} by {CHANNEL_PHRASES[name]}")
    diameter = max(ScenePopulation.from_scene(optimum.design.scene, optimum.design.population).ranges["diameter"].values)
    deepest = depth_map.find_deepest(diameter)
    at_least = "at least " if deepest == depth_map.depth.max() else ""  # the map ends there
    reach = "at no depth" if deepest is None else f"down to a depth of {at_least}{1e3 * deepest:.3g} mm"
    return (
        f"Of 100 of your tumours it detects {', '.join(parts)}, with {format_percent(performance.false_alarm, 6)} false alarms. "
        f"It detects those of {1e3 * diameter:.2g} mm, 9 times in 10, {reach}."
    )


def _describe_resolution(fraction: float, improvements: Sequence[Improvement]) -> str:
    """Return the fraction of the tumours whose stiffness is resolved, and, where it is small, what would raise it."""
    counted = f"of {100 * fraction:.0f} of 100"
    if fraction >= MIN_RESOLVED_FRACTION:
        return f"It resolves the stiffness {counted}, to a factor of {math.exp(MAX_RESOLVED_LOG_SD):.2g}."
    best_change = max(improvements, key=lambda item: item.resolved)
    if best_change.resolved < fraction + MIN_RESOLVED_GAIN:
        return f"It cannot resolve their stiffness (that {counted}), nor could it after any single change of the readings."
    return f"It cannot resolve their stiffness (that {counted}); {best_change.label}: {100 * best_change.resolved:.0f} of 100."


def _describe_improvement(optimum: PopulationOptimum, improvements: Sequence[Improvement]) -> str:
    """Return the change of the readings that helps most, if its gain is beyond twice its error."""
    aim, (present, *changes) = optimum.design.objective, improvements
    helpful = [item for item in changes if is_significant(item.gain, item.error)]
    if not helpful:
        return "What would help most: no single change of the readings helps beyond its error; wider limits may."
    best_change = max(helpful, key=lambda item: item.gain)
    value, now = (
        f"{100 * item.value:.0f} of 100" if aim.unit == "%" else f"{aim.scale * item.value:.3g}"
        for item in (best_change, present)
    )
    name = aim.maximise if aim.unit == "%" else aim.label
    return f"What would help most: {best_change.label}; {name} {value} in place of {now}, by the closed form."


def _describe_tolerances(optimum: PopulationOptimum) -> Iterator[str]:
    """Yield what the probes as built detect; a warning where workshop tolerances cost much of the detection."""
    designs = (optimum.start, *optimum.finalists)
    item = next(item for verified, item in zip(designs, optimum.robust, strict=True) if verified is optimum.best)
    if optimum.design.objective.maximise != "detection":
        return
    built, low, drawn = "built to the tolerances that the report states", f"{100 * item.low:.0f}", f"{100 * item.nominal:.0f}"
    if item.nominal - item.low > MAX_TOLERANCE_LOSS:
        yield (
            f"Build it closely: of probes {built}, one in twenty detects fewer than about {low} of 100 ({drawn} as drawn), by "
            "the closed form; probe-design tolerances says which size to hold."
        )
    else:
        yield f"Of probes {built}, 19 in 20 detect at least {low} of 100 ({drawn} as drawn), by the closed form."

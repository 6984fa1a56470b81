"""Public functions that correspond to the commands: take scenes or scene files, return results in SI units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design.data.noise import DEFAULT_NOISE, MAX_RESOLVED_LOG_SD

if TYPE_CHECKING:
    from probe_design.design_search.design_source import DesignSource
    from probe_design.design_search.outcome import PopulationOptimum
    from probe_design.estimation.estimate_result import Estimate
    from probe_design.estimation.measurements import Reading
    from probe_design.maps.detectability import Detectability
    from probe_design.maps.scan import Scan
    from probe_design.optimisation.optimum import Optimum
    from probe_design.populations.design_file import Design
    from probe_design.workshop.package import ExportSummary

NO_NUISANCES: Mapping[str, Any] = MappingProxyType({})


def resolve_scene(scene: Scene | Path | str) -> Scene:
    """Return a scene as it is, or read it from a file.

    Raises:
        InputError: the argument is neither a scene nor a file name, or the file cannot be read.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, Path | str):
        return read_scene(scene)
    raise InputError("scene", scene, "a Scene, or the name of a scene file")


def scan(
    scene: Scene | Path | str, *, along: str = "x", positions: ArrayLike | None = None, at: float | None = None,
    accuracy: float = 0.01, linear: bool = False, progress: Callable[[int, int], None] | None = None,
) -> Scan:  # fmt: skip
    """Compute readings of the probe along a line over the tissue; the tumours stay in place.

    Args:
        scene: spheres, bonded or frictionless, no tilt; or the name of a scene file.
        along: "x" or "y", the axis along which the probe moves.
        positions: of the probe's axis along the line, m, shape (n,); default: 41 from -20 mm to 20 mm.
        at: coordinate of the line along the other axis, m; default: the scene's placement.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        linear: whether to use linear elasticity at any load, see ``solver.evaluate``.
        progress: called with the number of positions done and their total, where there are many.

    Raises:
        InputError: the axis is unknown, or the probe would leave the tissue.
        Refusal: the evaluator cannot model the scene, or its load is beyond the range of linear elasticity.

    Example:
        >>> from probe_design import scan
        >>> scan("examples/two-tumours.toml", positions=[-8e-3, 0.0, 8e-3]).ratio  # doctest: +SKIP
    """
    from probe_design.maps.scan import scan as run

    if along not in ("x", "y"):
        raise InputError("along", along, "'x' or 'y'")
    line_positions = _choose_lengths(positions, np.linspace(-20e-3, 20e-3, 41))
    return run(resolve_scene(scene), along, line_positions, at, accuracy=accuracy, linear=linear, progress=progress)


def detectability(
    scene: Scene | Path | str, *, depths: ArrayLike | None = None, diameters: ArrayLike | None = None, points: int = 50,
    noise: float = DEFAULT_NOISE, seen: float = 3.0, resolved: float = MAX_RESOLVED_LOG_SD, accuracy: float | None = None,
    linear: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Detectability:  # fmt: skip
    """Map which tumours the probe detects, and which it resolves in stiffness, over depth and diameter.

    Args:
        scene: with a target, whose material and lateral offset are kept; or the name of a scene file.
        depths: from the surface to the centre, m, shape (k,); default: ``points`` values chosen from probe and target.
        diameters: m, shape (m,); default: likewise.
        points: number of default depths, and of default diameters.
        noise: relative standard deviation of one reading of the ratio.
        seen: change of the ratio, in multiples of the noise, from which a tumour is detected.
        resolved: standard deviation of ln E_object up to which the stiffness is resolved.
        accuracy: relative, of the ratio; default: the noise, within 5e-4 and 0.01.
        linear: whether to use linear elasticity at any load, see ``solver.evaluate``.
        progress: called with the number of spheres done and their total, for the spheres that take long.

    Raises:
        InputError: the scene has no target, or a size or threshold is not allowed.
        Refusal: the evaluator cannot model the scene, or its load is beyond the range of linear elasticity.
    """
    from probe_design.maps.detectability import detectability as run
    from probe_design.maps.sphere_effects import Thresholds
    from probe_design.maps.target_grid import choose_sizes

    target_scene = resolve_scene(scene)
    default_depths, default_diameters = choose_sizes(target_scene, points)
    thresholds = Thresholds(noise, seen, resolved)
    return run(
        target_scene,
        _choose_lengths(depths, default_depths),
        _choose_lengths(diameters, default_diameters),
        thresholds,
        accuracy=accuracy,
        linear=linear,
        progress=progress,
    )


def estimate(
    scene: Scene | Path | str, *, ratio: float | None = None, noise: float = DEFAULT_NOISE, stiffness: float | None = None,
    stiffness_noise: float | None = None, readings: tuple[Reading, ...] | Path | str | None = None,
    unknown: str = "youngs_modulus", accuracy: float | None = None, linear: bool = False,
    nuisances: Mapping[str, Any] = NO_NUISANCES,
) -> Estimate:  # fmt: skip
    """Estimate one unknown of the target or the tissue from readings, with its 95 % interval.

    Args:
        scene: all other parameters, taken as known; or the name of a scene file.
        ratio: measured stress_inner / stress_outer at the scene's placement. Give either ``ratio`` or ``readings``.
        noise: relative standard deviation of a ratio, for readings that do not state it.
        stiffness: force on the base per indentation, measured together with the ratio, N/m.
        stiffness_noise: relative standard deviation of a stiffness; default: that of the ratio.
        readings: several readings, or the name of a .toml or .csv file; see ``probe-design estimate --help``.
        unknown: youngs_modulus, diameter or depth of the target, or a number of the tissue, "tissue.layer[0].thickness".
        accuracy: of the model's ratio, relative; default: a quarter of the smallest noise, within 5e-4 and 0.01.
        linear: whether to use linear elasticity at any load.
        nuisances: relative standard deviations, 0.2 or "20 %", of uncertain numbers of the scene, by their keys.

    Raises:
        InputError: an unknown, reading or nuisance is not allowed.
        Refusal: nothing can be estimated for this kind of scene, or its load is beyond the range of the models.
    """
    from probe_design.estimation.estimate import estimate as run
    from probe_design.estimation.measurements import build_single_reading, read_readings

    known_scene = resolve_scene(scene)
    if (ratio is None) == (readings is None):
        raise InputError("ratio", Words("missing" if ratio is None else "given beside readings"), "one of ratio and readings")
    if isinstance(readings, Path | str):
        readings = read_readings(Path(readings), known_scene, noise, stiffness_noise)
    measured = build_single_reading(known_scene, ratio, noise, stiffness, stiffness_noise) if readings is None else readings
    return run(known_scene, measured, unknown, accuracy, linear=linear, nuisances=nuisances)


def optimize(
    design: DesignSource = None, *, output: Path | str | None = None, outer_radius: float | None = None,
    starts: int = 8, evaluator: str | None = None, noise: float = DEFAULT_NOISE, force: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Optimum | PopulationOptimum:  # fmt: skip
    """Find a better probe for the tumours of a design file or for the tumour of a scene, and verify it by finite elements.

    The load of a scene is an upper limit. Where it is beyond linear elasticity, ``contact`` evaluates each design under the best
    load up to that limit.

    Args:
        design: a ``Design`` or the tables of a design file, or the initial ``Scene``, or the name of a file of either; default:
            the built-in design file. A design file states by its own keys what ``outer_radius`` to ``noise`` state for a scene.
        output: folder for the design, STEP files and report; default: nothing is written.
        outer_radius: upper limit of the probe's outer radius, m; default: 1.4 times the initial one.
        starts: number of local searches.
        evaluator: verifies and refines the candidates, "axisymmetric" or "equivalent-inclusion"; default: chosen by the scene.
        noise: relative standard deviation of one reading of the ratio.
        force: whether parts of another design in ``output`` are replaced.
        progress: called with the name of a stage, the number of steps done and their total.

    Returns:
        the initial design, all verified designs and the best; ``status`` states whether there is a gain.

    Raises:
        InputError: no target, a load of 0, no allowed design, no such evaluator; or ``output`` holds another design.
        Refusal: the closed form or the verifying evaluator cannot model the scene.
    """
    from geometry.common.files import check_writable
    from probe_design.design_search.design_source import read_design_source
    from probe_design.optimisation.optimize import optimize as run
    from probe_design.optimisation.report import write_all

    tell, start = progress or _ignore_progress, read_design_source(design)
    if output is not None:
        check_writable(Path(output))
    if not isinstance(start, Scene):
        _refuse_settings(outer_radius, starts, evaluator, noise)
        return _optimize_population(start, output, tell, force)
    optimum = run(start, tell, outer_radius=outer_radius, starts=starts, judge=evaluator, noise=noise)
    if output is not None:
        write_all(optimum, Path(output), tell, force=force)
    return optimum


def _refuse_settings(outer_radius: float | None, starts: int, evaluator: str | None, noise: float) -> None:
    """Refuse settings that a design file states by its own keys."""
    settings = {
        "outer_radius": (outer_radius, None),
        "starts": (starts, 8),
        "evaluator": (evaluator, None),
        "noise": (noise, DEFAULT_NOISE),
    }
    for key, (value, default) in settings.items():
        if value != default:
            raise InputError(key, value, "none for a design file, whose tables say it")


def _optimize_population(
    design: Design, output: Path | str | None, tell: Callable[[str, int, int], None], force: bool
) -> PopulationOptimum:
    from probe_design.design_report.report import compute_maps, write_all
    from probe_design.design_search.optimize import optimize as run

    optimum = run(design, tell)
    if output is not None:
        write_all(optimum, Path(output), tell, compute_maps(optimum), force=force)
    return optimum


def export(
    scene: Scene | Path | str, output: Path | str, *, step: float | None = None, tolerance: float = 0.01,
    shrinkage: float | None = None, draft: float | None = None, force: bool = False,
    progress: Callable[[str], None] | None = None,
) -> ExportSummary:  # fmt: skip
    """Write the files for the workshop: STEP, drawings, film patterns, moulds, lists (docs/guides/workshop.md).

    Args:
        scene: whose probe; or the name of a scene file.
        output: folder for the files, made if needed.
        step: sizes are rounded to multiples of this length, m, such as 1e-4; default: no rounding.
        tolerance: standard deviation of ln ratio that the tolerances of the drawings may cause together: 0.01 for 1 %.
        shrinkage: relative linear shrinkage of the elastomer while it cures, for the moulds; default: 0.001.
        draft: maximum draft angle of the moulds' walls, rad; default: half a degree.
        force: whether parts of another design in the folder are replaced.
        progress: called with a line of text before each long step.

    Returns:
        the scene as built, the paths of the files, and the effect of the rounding.

    Raises:
        ExportError: a part that was read back differs from its parameters; no file is left.
        InputError: the folder holds another design, or step, tolerance, shrinkage or draft is not allowed.
        MissingLibrary: CAD cannot be loaded.

    Example:
        >>> from probe_design import export
        >>> export("examples/scene.toml", "out/parts", step=1e-4).files  # doctest: +SKIP
    """
    from geometry.provenance.block import record_scene
    from geometry.workshop.package import DEFAULT_CASTING, Casting
    from probe_design.workshop.package import export as write

    casting = Casting(
        DEFAULT_CASTING.shrinkage if shrinkage is None else shrinkage, DEFAULT_CASTING.draft if draft is None else draft
    )
    probe_scene, tell = resolve_scene(scene), progress or _ignore_progress
    with record_scene(probe_scene):
        return write(probe_scene, Path(output), step=step, force=force, tolerance=tolerance, casting=casting, tell=tell)


def _choose_lengths(values: ArrayLike | None, default: Floats) -> Floats:
    """Return given lengths as an array of shape (n,), or the default."""
    return default if values is None else np.atleast_1d(np.asarray(values, dtype=float))


def _ignore_progress(stage: str, done: int = 0, total: int = 0) -> None:
    """Accept a progress report and discard it."""

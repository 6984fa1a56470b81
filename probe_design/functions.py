"""What the verbs of the command line do, as functions: scenes or their files in, results out; numbers in SI units."""

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
from probe_design.data.noise import NOISE, RESOLVED

if TYPE_CHECKING:
    from probe_design.design_search.outcome import PopulationOptimum
    from probe_design.design_search.question import Asked
    from probe_design.estimation.answer import Estimate
    from probe_design.estimation.readings import Reading
    from probe_design.maps.detectability import Detectability
    from probe_design.maps.scan import Scan
    from probe_design.optimisation.optimum import Optimum
    from probe_design.populations.design_file import Design
    from probe_design.workshop.package import Exported

NOTHING: Mapping[str, Any] = MappingProxyType({})


def read(scene: Scene | Path | str) -> Scene:
    """Return a scene, or that of a file.

    Raises:
        InputError: it is neither, or the file cannot be used.
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
    """Say what the probe reads along a line over the tissue; tumours stay where they are.

    Args:
        scene: spheres, bonded or frictionless, no tilt; or the name of a scene file.
        along: "x" or "y", the axis along which the probe moves.
        positions: of the probe's axis along the line, m, shape (n,); left out: 41 from -20 mm to 20 mm.
        at: where the line lies along the other axis, m; left out: the scene's placement.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        linear: whether to answer linearly at any load, see ``solver.evaluate``.
        progress: called with positions done and all, where there are many.

    Raises:
        InputError: no such axis; the probe would leave the tissue.
        Refusal: the scene is of a kind that the level cannot take; its load is beyond what linear elasticity allows.

    Example:
        >>> from probe_design import scan
        >>> scan("examples/two-tumours.toml", positions=[-8e-3, 0.0, 8e-3]).ratio  # doctest: +SKIP
    """
    from probe_design.maps.scan import scan as run

    if along not in ("x", "y"):
        raise InputError("along", along, "'x' or 'y'")
    places = _lengths(positions, np.linspace(-20e-3, 20e-3, 41))
    return run(read(scene), along, places, at, accuracy=accuracy, linear=linear, progress=progress)


def detectability(
    scene: Scene | Path | str, *, depths: ArrayLike | None = None, diameters: ArrayLike | None = None, points: int = 50,
    noise: float = NOISE, seen: float = 3.0, resolved: float = RESOLVED, accuracy: float | None = None, linear: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Detectability:  # fmt: skip
    """Say which tumours the probe sees, and of which it resolves the stiffness: maps over depth and diameter.

    Args:
        scene: with a target, whose material and place beside the probe's axis are kept; or the name of a scene file.
        depths: from the surface to the centre, m, shape (k,); left out: ``points`` that probe and target suggest.
        diameters: m, shape (m,); likewise.
        points: of each that is left out.
        noise: relative standard deviation of one reading of the ratio.
        seen: change of the ratio, times the noise, from which a tumour is seen.
        resolved: standard deviation of ln E_object up to which its stiffness is.
        accuracy: relative, of the ratio; left out: the noise, from 5e-4 to 0.01.
        linear: whether to answer linearly at any load, see ``solver.evaluate``.
        progress: called with spheres done and all, of those that take long.

    Raises:
        InputError: no target, or sizes or thresholds that are none.
        Refusal: the scene is of a kind that the level cannot take; its load is beyond what linear elasticity allows.
    """
    from probe_design.maps.detectability import detectability as run
    from probe_design.maps.sphere_effects import Thresholds
    from probe_design.maps.target_grid import chosen_sizes

    asked = read(scene)
    deep, wide = chosen_sizes(asked, points)
    limits = Thresholds(noise, seen, resolved)
    return run(
        asked, _lengths(depths, deep), _lengths(diameters, wide), limits, accuracy=accuracy, linear=linear, progress=progress
    )


def estimate(
    scene: Scene | Path | str, *, ratio: float | None = None, noise: float = NOISE, stiffness: float | None = None,
    stiffness_noise: float | None = None, readings: tuple[Reading, ...] | Path | str | None = None,
    unknown: str = "youngs_modulus", accuracy: float | None = None, linear: bool = False, nuisances: Mapping[str, Any] = NOTHING,
) -> Estimate:  # fmt: skip
    """Say what was pressed on: one unknown of the target or the tissue with its 95 % interval.

    Args:
        scene: everything else, taken as known; or the name of a scene file.
        ratio: stress_inner / stress_outer as it was read at the scene's placement; or ``readings``, one of the two.
        noise: relative standard deviation of a ratio, where readings do not say.
        stiffness: force on the base per indentation as it was read beside the ratio, N/m.
        stiffness_noise: relative standard deviation of a stiffness; left out: that of the ratio.
        readings: several, or the name of a .toml or .csv file of them; see ``probe-design estimate --help``.
        unknown: youngs_modulus, diameter or depth of the target, or a number of the tissue, "tissue.layer[0].thickness".
        accuracy: of the model's ratio, relative; left out: a quarter of the least noise, from 5e-4 to 0.01.
        linear: whether linear elasticity answers at any load.
        nuisances: relative standard deviations, 0.2 or "20 %", of numbers of the scene that are known roughly, by their keys.

    Raises:
        InputError: no such unknown, reading or nuisance.
        Refusal: the scene is of a kind that cannot be estimated, or its load is beyond what the models take.
    """
    from probe_design.estimation.estimate import estimate as run
    from probe_design.estimation.readings import one_reading, read_readings

    asked = read(scene)
    if (ratio is None) == (readings is None):
        raise InputError("ratio", Words("missing" if ratio is None else "given beside readings"), "one of ratio and readings")
    if isinstance(readings, Path | str):
        readings = read_readings(Path(readings), asked, noise, stiffness_noise)
    found = one_reading(asked, ratio, noise, stiffness, stiffness_noise) if readings is None else readings
    return run(asked, found, unknown, accuracy, linear=linear, nuisances=nuisances)


def optimize(
    design: Asked = None, *, output: Path | str | None = None, outer_radius: float | None = None,
    starts: int = 8, evaluator: str | None = None, noise: float = NOISE, force: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Optimum | PopulationOptimum:  # fmt: skip
    """Find a better probe, for a design file's tumours or for the one of a scene, and prove it by finite elements.

    Of a scene the load is a limit: where linear elasticity does not answer for it, level ``contact`` judges designs under the
    best of all loads up to it.

    Args:
        design: a ``Design`` or the tables of a design file, or the start as a ``Scene``, or the name of a file of either; left
            out: the built-in design file. A design file says itself what ``outer_radius`` to ``noise`` say for a scene.
        output: folder for the design, STEP files and report; left out: nothing is written.
        outer_radius: limit of the probe's outer radius, m; left out: 1.4 times the start's.
        starts: local searches.
        evaluator: who judges and polishes, "axisymmetric" or "equivalent-inclusion"; left out: what the scene asks for.
        noise: relative standard deviation of one reading of the ratio.
        force: whether parts of another design that ``output`` holds are replaced.
        progress: called with a stage's name, the steps done and their number.

    Returns:
        the start, all judged designs and the best; ``status`` says whether there is a gain.

    Raises:
        InputError: no target, a load of 0, no room for a design, no such evaluator; ``output`` holds another design.
        Refusal: closed form or judge cannot take the scene.
    """
    from geometry.common.files import check_writable
    from probe_design.design_search.question import question
    from probe_design.optimisation.optimize import optimize as run
    from probe_design.optimisation.report import write_all

    tell, start = progress or _silent, question(design)
    if output is not None:
        check_writable(Path(output))
    if not isinstance(start, Scene):
        _refuse_settings(outer_radius, starts, evaluator, noise)
        return _for_population(start, output, tell, force)
    optimum = run(start, tell, outer_radius=outer_radius, starts=starts, judge=evaluator, noise=noise)
    if output is not None:
        write_all(optimum, Path(output), tell, force=force)
    return optimum


def _refuse_settings(outer_radius: float | None, starts: int, evaluator: str | None, noise: float) -> None:
    """Refuse what a design file says by its tables."""
    given = {"outer_radius": (outer_radius, None), "starts": (starts, 8), "evaluator": (evaluator, None), "noise": (noise, NOISE)}
    for key, (value, usual) in given.items():
        if value != usual:
            raise InputError(key, value, "none for a design file, whose tables say it")


def _for_population(
    design: Design, output: Path | str | None, tell: Callable[[str, int, int], None], force: bool
) -> PopulationOptimum:
    from probe_design.design_report.report import maps_of, write_all
    from probe_design.design_search.optimize import optimize as run

    optimum = run(design, tell)
    if output is not None:
        write_all(optimum, Path(output), tell, maps_of(optimum), force=force)
    return optimum


def export(
    scene: Scene | Path | str, output: Path | str, *, step: float | None = None, tolerance: float = 0.01,
    shrinkage: float | None = None, draft: float | None = None, force: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Exported:  # fmt: skip
    """Write the probe as the workshop needs it: STEP, drawings, film patterns, moulds, lists (docs/guides/workshop.md).

    Args:
        scene: whose probe; or the name of a scene file.
        output: folder for the files, made if needed.
        step: m, to which sizes are rounded, 1e-4 for 0.1 mm; left out: they stay.
        tolerance: standard deviation of ln ratio that the drawings' tolerances may make: 0.01 for 1 %.
        shrinkage: linear, of the elastomer while it cures, for the moulds; left out: 0.001.
        draft: of the moulds' walls, at most, rad; left out: half a degree.
        force: whether parts of another design that the folder holds are replaced.
        progress: called with a line before each long piece of work.

    Returns:
        the scene as it is built, the files' paths, and what the rounding costs.

    Raises:
        ExportError: a part, read back, is not what the parameters say; no file is left.
        InputError: the folder holds another design; no such step, tolerance, shrinkage or draft.
        MissingLibrary: CAD cannot be loaded.

    Example:
        >>> from probe_design import export
        >>> export("examples/scene.toml", "out/parts", step=1e-4).files  # doctest: +SKIP
    """
    from geometry.provenance.block import about
    from geometry.workshop.package import USUAL, Casting
    from probe_design.workshop.package import export as write

    casting = Casting(USUAL.shrinkage if shrinkage is None else shrinkage, USUAL.draft if draft is None else draft)
    built, tell = read(scene), progress or _silent
    with about(built):
        return write(built, Path(output), step=step, force=force, tolerance=tolerance, casting=casting, tell=tell)


def _lengths(given: ArrayLike | None, usual: Floats) -> Floats:
    """What is given as an array, or what is usual."""
    return usual if given is None else np.atleast_1d(np.asarray(given, dtype=float))


def _silent(stage: str, done: int = 0, total: int = 0) -> None:
    """Tell nobody."""

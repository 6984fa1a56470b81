"""The commands `scan`, `detectability` and `load`: many readings of one probe, as curves and maps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from pydantic import Field

from geometry.common.errors import InputError
from geometry.scenes.probe import format_mm
from geometry.scenes.quantities import POSITION_QUANTITY, Length, Position
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from geometry.scenes.scene_tables import Force, Indentation
from probe_design.commands.fields import Accuracy, Fraction, LimitedRequest, Linear, Noise, Picture, SceneSource
from probe_design.commands.output import present
from probe_design.commands.request import Number, Option, is_positive, use_request
from probe_design.data.noise import DEFAULT_NOISE, MAX_RESOLVED_LOG_SD
from probe_design.terminal.console import show_count, show_steps

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from geometry.common.arrays import Floats
    from probe_design.maps.detectability import Detectability
    from probe_design.maps.scan import Scan

Progress = Callable[[int, int], None]
DEFAULT_POSITIONS = (-20e-3, 20e-3, 41)  # m, m, number


class ScanRequest(LimitedRequest):
    """Compute readings of the probe along a line over the tissue.

    The probe is lifted, moved and pressed again; tumours and tissue stay where SCENE has them, and SCENE's own
    placement along the line does not matter. Positions are in SCENE's frame, whose origin is the tissue's middle.
    Any number of spheres, anywhere; without one the line is flat.

    \b
    probe-design scan scene.toml --along x --from "-20 mm" --to "20 mm" --plot scan.png
    probe-design scan scene.toml --along y --at "5 mm" --points 81 --json
    """  # noqa: D301

    scene: SceneSource
    along: Annotated[Literal["x", "y"], Option("Axis that the probe moves along.")] = "x"
    low: Annotated[Position, Option("First position of the probe's axis.", "--from")] = DEFAULT_POSITIONS[0]
    high: Annotated[Position, Option("Last position of the probe's axis.", "--to")] = DEFAULT_POSITIONS[1]
    points: Annotated[int, Field(ge=2, le=10_000), Option("Positions, evenly spaced.")] = DEFAULT_POSITIONS[2]
    at: Annotated[Position | None, Option("Coordinate of the line along the other axis.", left_out="the scene's placement")] = (
        None
    )
    accuracy: Accuracy = None
    linear: Linear = False
    picture: Annotated[
        Picture, Option("Draw the scan above a section of the tissue to this .png, .svg or .pdf file.", "--plot")
    ] = None

    def run(self) -> None:
        """Compute the scan at evenly spaced positions."""
        import numpy as np

        from probe_design.terminal.result_tables import build_scan_table

        scene = load_scene(self.scene)
        if not self.low < self.high:
            raise InputError("to", format_mm(self.high), f"a position above from = {format_mm(self.low)!r}")
        with show_count(f"scan of {self.scene}") as progress:
            result = self.call(scan, scene=scene, positions=np.linspace(self.low, self.high, self.points), progress=progress)
        present(result, build_scan_table, self.as_json, self.picture)


@use_request(ScanRequest)
def scan(
    scene: Scene | Path | str, *, along: str = "x", positions: ArrayLike | None = None, at: float | None = None,
    accuracy: float | None = None, linear: bool = False, progress: Progress | None = None,
) -> Scan:  # fmt: skip
    """Compute readings of the probe along a line over the tissue; the tumours stay in place.

    Parameters
    ----------
    positions : array_like, shape (n,), m; default: 41 from -20 mm to 20 mm
        Positions of the probe's axis along the line.
    progress : callable, optional
        Called with the number of positions done and their total, where there are many.

    Returns
    -------
    Scan
        Readings at each position; ``probe_design.plot`` draws them above a section of the tissue.

    Raises
    ------
    InputError
        The axis is unknown, or the probe would leave the tissue.
    Refusal
        The evaluator cannot model the scene (spheres, bonded or frictionless, no tilt), or its load is beyond the range of
        linear elasticity.

    Examples
    --------
    >>> from probe_design import scan
    >>> scan("examples/two-tumours.toml", positions=[-8e-3, 0.0, 8e-3]).ratio  # doctest: +SKIP
    """
    import numpy as np

    from probe_design.maps.scan import scan as run

    line_positions = _choose_lengths("positions", positions, np.linspace(*DEFAULT_POSITIONS))
    return run(load_scene(scene), along, line_positions, at, accuracy=accuracy, linear=linear, progress=progress)


class DetectabilityRequest(LimitedRequest):
    """Map which tumours the probe detects, and which it resolves in stiffness, over depth and diameter.

    SCENE's target inclusion is replaced by spheres of its material at its lateral offset; all else stays. For each sphere the
    maps show the change of the ratio, and the standard deviation of ln E_object from one reading of the ratio,
    noise / |log_sensitivity|, all other numbers of the scene being known, size and depth included.

    Detected: the ratio changes by 3 times the noise or more. A threshold at half of that misses 1 of 15 tumours, and reports a
    tumour at 1 of 15 healthy places (6.7 %; 3.29 times the noise gives 5 %, Currie 1968). The ratio without tumour is taken as
    known: where it is a baseline reading with noise too, give 1.41 times the noise.

    Resolved: a standard deviation of ln E_object up to 0.5, a factor of 1.65 either way.

    \b
    probe-design detectability scene.toml --noise 0.01 --plot map.png
    probe-design detectability scene.toml --noise 0.002 --depth-to "30 mm" --diameter-to "12 mm" --json
    """  # noqa: D301

    scene: SceneSource
    noise: Noise = DEFAULT_NOISE
    seen: Annotated[
        float,
        Number("a number above 0, in multiples of the noise (3 for three times the noise): no percentage", is_positive),
        Option("Change of the ratio, in multiples of the noise, from which a tumour is detected."),
    ] = 3.0
    resolved: Annotated[
        float, Number("a number above 0", is_positive), Option("Standard deviation of ln E_object up to which it is resolved.")
    ] = MAX_RESOLVED_LOG_SD
    depth_from: Annotated[Length | None, Option("Smallest depth of a centre.", left_out="1/50 of the largest")] = None
    depth_to: Annotated[
        Length | None,
        Option("Largest depth of a centre.", left_out="4 outer radii or what the scene's tumour needs"),
    ] = None
    diameter_from: Annotated[Length | None, Option("Smallest diameter.", left_out="1/50 of the largest")] = None
    diameter_to: Annotated[
        Length | None,
        Option("Largest diameter.", left_out="2.5 outer radii or what the scene's tumour needs"),
    ] = None
    points: Annotated[int, Field(ge=2, le=300), Option("Depths, and as many diameters.")] = 50
    accuracy: Annotated[
        Fraction | None, Option("Relative error that the ratio may have.", left_out="--noise, between 0.0005 and 0.01")
    ] = None
    linear: Linear = False
    picture: Annotated[Picture, Option("Draw both maps to this .png, .svg or .pdf file.", "--plot")] = None

    def run(self) -> None:
        """Compute both maps at evenly spaced depths and diameters."""
        from probe_design.maps.target_grid import choose_sizes
        from probe_design.terminal.result_tables import build_threshold_table

        scene = load_scene(self.scene)
        depths, diameters = self.call(choose_sizes, scene=scene)
        with show_count(f"detectability of {self.scene}") as progress:
            result = self.call(detectability, scene=scene, depths=depths, diameters=diameters, progress=progress)
        present(result, build_threshold_table, self.as_json, self.picture)


@use_request(DetectabilityRequest)
def detectability(
    scene: Scene | Path | str, *, depths: ArrayLike | None = None, diameters: ArrayLike | None = None, points: int = 50,
    noise: float = DEFAULT_NOISE, seen: float = 3.0, resolved: float = MAX_RESOLVED_LOG_SD, accuracy: float | None = None,
    linear: bool = False, progress: Progress | None = None,
) -> Detectability:  # fmt: skip
    """Map which tumours the probe detects, and which it resolves in stiffness, over depth and diameter.

    Material and lateral offset of the scene's target are kept.

    Parameters
    ----------
    depths : array_like, shape (k,), m; default: ``points`` values chosen from probe and target
        Depths from the surface to the centre.
    diameters : array_like, shape (m,), m; default: likewise
        Diameters of the spheres.
    progress : callable, optional
        Called with the number of spheres done and their total, for the spheres that take long.

    Returns
    -------
    Detectability
        Both maps; ``probe_design.plot`` draws them.

    Raises
    ------
    InputError
        The scene has no target, or a size or threshold is not allowed.
    Refusal
        The evaluator cannot model the scene, or its load is beyond the range of linear elasticity.
    """
    from probe_design.maps.detectability import detectability as run
    from probe_design.maps.sphere_effects import Thresholds
    from probe_design.maps.target_grid import choose_sizes

    target_scene = load_scene(scene)
    default_depths, default_diameters = choose_sizes(target_scene, points)
    return run(
        target_scene,
        _choose_lengths("depths", depths, default_depths),
        _choose_lengths("diameters", diameters, default_diameters),
        Thresholds(noise, seen, resolved),
        accuracy=accuracy,
        linear=linear,
        progress=progress,
    )


class LoadRequest(LimitedRequest):
    """Compute ratio, log-sensitivity and the gap between the blocks under rising loads.

    Finite strain and contact are modelled (evaluator contact): tissue folds onto the blocks' walls, and the gap closes. The
    command also reports the load at which the gap closes, the load up to which linear theory holds within --accuracy, and the
    range of loads in which the ratio is constant within --accuracy. The log-sensitivity is taken at constant force. Where no
    further step converges, the curve ends early, with a warning.
    """

    scene: SceneSource
    max_load: Annotated[str, Option('Largest load: a force, "0.3 N", or an indentation, "2 mm".', "--to")]
    points: Annotated[int, Field(ge=1, le=1000), Option("Loads, evenly spaced above 0.")] = 20
    accuracy: Accuracy = None
    picture: Annotated[Picture, Option("Draw ratio, log-sensitivity and walls to this .png, .svg or .pdf file.", "--plot")] = None

    def run(self) -> None:
        """Compute the scene under rising loads."""
        from probe_design.terminal.result_tables import build_load_table, list_load_lines
        from solver.evaluation import press

        force, indentation = _read_load(self.max_load)
        scene = load_scene(self.scene)
        with show_steps(f"pressing {self.scene}") as progress:
            result = self.call(press, scene=scene, force=force, indentation=indentation, progress=progress)
        present(result, build_load_table, self.as_json, self.picture, lines=list_load_lines)


def _read_load(text: str) -> tuple[float | None, float | None]:
    """Return (force, None), N, or (None, indentation), m, from a text that states one of both with its unit."""
    for k, kind in enumerate((Force, Indentation)):  # annotated types, whose second argument reads a text
        try:
            value = float(get_args(kind)[1].read("to", text))
        except InputError:
            continue
        if value > 0:
            return (value, None) if k == 0 else (None, value)
    raise InputError("to", text, "a force such as '0.3 N', or an indentation such as '2 mm', above 0")


def _choose_lengths(name: str, values: ArrayLike | None, default: Floats) -> Floats:
    """Return ``values``, numbers or texts with units, as an array of shape (n,), m, or ``default`` if they are None."""
    import numpy as np

    if values is None:
        return default
    entries = np.atleast_1d(np.asarray(values, dtype=object)).tolist()
    try:
        read = [POSITION_QUANTITY.read(name, entry) if isinstance(entry, str) else float(entry) for entry in entries]
    except TypeError:
        raise InputError(name, values, "lengths, m, or texts with units, such as ['-5 mm', '0 mm']") from None
    return np.array(read)

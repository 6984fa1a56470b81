"""Read a design file: the scene to start from, and tables of population, protocol, noise, limits, variables and objective."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from pydantic import Field, ValidationError

from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.text_files import parse_tables, read_tables, read_text
from geometry.scenes.file_kinds import check_kind
from geometry.scenes.quantities import Frozen
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import find_scene, read_scene
from geometry.scenes.scene_tables import Reading
from geometry.scenes.validation_messages import convert_error
from probe_design.populations.objective import Objective
from probe_design.populations.tables import (
    FORCE_QUANTITY,
    DesignLimits,
    DesignVariables,
    NoiseModel,
    PopulationRanges,
    Protocol,
)

DESIGN_SECTIONS = ("population", "protocol", "noise", "limits", "variables", "objective")
QUESTION_FILE, RECOMMENDED_FILE = "question.toml", "design.toml"  # in the folder of `optimize`: what was asked for, and the scene
PROTOCOL_FILE = "protocol.toml"  # there, the table [protocol] of the recommended scan, where scans were varied

ALLOWED_SOURCES = "a Design or Scene, the name of a design or scene file, or the tables of a design file"


class Design(Frozen):
    """The specification of a design; frozen, in SI units.

    Attributes
    ----------
    scene
        The start: its probe, and its tissue and inclusion for values that ``population`` does not give.
    population, protocol, noise, limits, variables, objective
        The tables of the file.
    """

    scene: Scene
    population: PopulationRanges = Field(default_factory=PopulationRanges)
    protocol: Protocol = Field(default_factory=Protocol)
    noise: NoiseModel = Field(default_factory=NoiseModel)
    limits: DesignLimits = Field(default_factory=DesignLimits)
    variables: DesignVariables = Field(default_factory=DesignVariables)
    objective: Objective = Field(default_factory=Objective)


DesignSource = Design | Scene | Path | str | Mapping[str, object] | None


def is_design(tables: Mapping[str, object]) -> bool:
    """Return whether the tables of a file are those of a design file; a scene file has the tables probe and tissue instead.

    A table noise alone does not make a design file.
    """
    return "scene" in tables or (bool(set(DESIGN_SECTIONS) - {"noise"} & set(tables)) and "probe" not in tables)


def read_builtin_design_text() -> str:
    """Return the text of the built-in design file."""
    return files("probe_design.data").joinpath("builtin_design.toml").read_text(encoding="utf-8")


def read_builtin_design() -> Design:
    """Return the built-in design; its file states the source of every number."""
    return design_from_dict(parse_tables(read_builtin_design_text(), "built-in design", "a design file"), units_required=True)


def read_design_source(source: DesignSource) -> Design | Scene:
    """Return the design or scene of any source, by default the built-in design; in tables from Python numbers are in SI units.

    A file is recognised by its tables as a design file or a scene file.

    Raises
    ------
    InputError
        The source is none of ``ALLOWED_SOURCES``, or contains a value that is not allowed.
    """
    question = _read_source(source)
    load = question.scene.load if isinstance(question, Design) else question.load
    if load.preload:
        allowed = "0 in a search, whose force varies: readings of a design are those of one press from zero to the peak"
        raise InputError("load.preload", Words(f"{load.preload:g} N"), allowed)
    return question


def _read_source(source: DesignSource) -> Design | Scene:
    """Return the design or scene of any source; see ``read_design_source``."""
    if source is None:
        return read_builtin_design()
    if isinstance(source, Design | Scene):
        return source
    if isinstance(source, Mapping):
        return design_from_dict(source)
    if not isinstance(source, Path | str):
        raise InputError("design", source, ALLOWED_SOURCES)
    if Path(source).is_dir():
        return _read_result_folder(Path(source))
    tables = parse_tables(read_text(source, "scene file"), str(source), "a TOML scene or design file")
    return _check_file(tables, Path(source)) if is_design(tables) else read_scene(source)


def _read_result_folder(folder: Path) -> Design:
    """Return the design that `optimize` wrote into a folder: what was asked for, with the recommended probe as the scene."""
    for name in (QUESTION_FILE, RECOMMENDED_FILE):
        if not (folder / name).is_file():
            allowed = f"a design file, or a folder that optimize wrote, with {QUESTION_FILE} and {RECOMMENDED_FILE}"
            raise InputError("design", Words(f"the folder {folder} without {name}"), allowed)
    tables = read_tables(folder / QUESTION_FILE, "design file")
    if (folder / PROTOCOL_FILE).is_file():
        tables = {**tables, **read_tables(folder / PROTOCOL_FILE, "design file")}
    return _check_file({**tables, "scene": RECOMMENDED_FILE}, folder / QUESTION_FILE)


def read_design(path: Path | str) -> Design:
    """Read a design file; names of files in it are relative to its folder.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or contains a value that is not allowed.
    """
    return _check_file(read_tables(path, "design file"), Path(path))


def _check_file(tables: Mapping[str, object], path: Path) -> Design:
    """Check the tables of a design file. Raises ``InputError``, which for another command's file names that command."""
    check_kind(tables, str(path), "design file", "a design file, with [population], or a scene file, with [probe]")
    return design_from_dict(tables, path.parent, units_required=True)


def design_from_dict(tables: Mapping[str, object], folder: Path | str = ".", units_required: bool = False) -> Design:
    """Check a design given as the tables of a design file.

    Parameters
    ----------
    tables
        Tables as in the file; ``scene`` may be a ``Scene``, numbers are in SI units.
    folder
        Folder to which file names are relative.
    units_required
        Whether a bare number is refused for a quantity with a unit.

    Raises
    ------
    InputError
        A value is not allowed.
    """
    sections = {name: table for name, table in tables.items() if name != "scene"}
    if unknown := [name for name in sections if name not in DESIGN_SECTIONS]:
        raise InputError(str(unknown[0]), sections[unknown[0]], describe_choices(unknown[0], ("scene", *DESIGN_SECTIONS)))
    scene = find_scene(tables.get("scene"), Path(folder))
    try:
        design = Design.model_validate({**sections, "scene": scene}, context={"units_required": units_required})
    except ValidationError as refused:
        raise convert_error(refused, Design, "design") from None
    return _resolve_calibration_path(_check_against_scene(_set_observable(design)), Path(folder))


def _set_observable(design: Design) -> Design:
    """Return the design with a scene that reads what the protocol names; raise ``InputError`` for charges without films."""
    observable, scene = design.protocol.observable, design.scene
    if observable is None:
        return design
    if observable == "charge" and scene.probe.film is None:
        raise InputError("protocol.observable", "charge", "'stress', or [probe.film] given in the scene")
    return design.model_copy(update={"scene": scene.model_copy(update={"reading": Reading(observable=observable)})})


def _check_against_scene(design: Design) -> Design:
    """Return the design if its tables fit its scene; raise ``InputError`` otherwise."""
    ranges, scene = design.population, design.scene
    if len(ranges.layer) > len(scene.tissue.layer):
        raise InputError(
            "population.layer",
            Words(f"{len(ranges.layer)} tables"),
            f"at most {len(scene.tissue.layer)}, as many as the scene has layers",
        )
    if len(scene.inclusion) > 1:
        raise InputError(
            "scene.inclusion", Words(f"{len(scene.inclusion)} tables"), "one or none: the population's tumours take its place"
        )
    if scene.inclusion and scene.inclusion[0].diameter is None and ranges.diameter is None:
        raise InputError("population.diameter", Words("missing"), "diameters of spheres: the scene's inclusion is none")
    if ranges.samples < 2 and ranges.is_varied:
        raise InputError("population.samples", ranges.samples, "2 or more, as tumours differ: one alone gives no sampling error")
    if design.protocol.loads:
        _check_loads(design)
    _check_place(design)
    if design.protocol.raster and ranges.x is not None and ranges.y is None:
        design = design.model_copy(update={"population": ranges.model_copy(update={"y": ranges.x})})
    if design.variables.force.fixed and scene.load.force is None:
        raise InputError("variables.force", "fixed", "bounds or choices, as the scene's load is an indentation")
    for key in ("depth", "diameter", "object"):
        if not scene.inclusion and getattr(ranges, key) is None:
            raise InputError(f"population.{key}", Words("missing"), "a value, a range or a list, as the scene has no inclusion")
    return design


def _check_place(design: Design) -> None:
    """Raise ``InputError`` where a design for the place knows the place."""
    aim, ranges = design.objective, design.population
    is_spread = any(part is not None and not part.is_single for part in (ranges.x, ranges.y))
    if aim.maximise == "place_error" and not is_spread:
        raise InputError(
            "population.x", Words("one value or missing"), "a range, with maximise = 'place_error': the place is unknown"
        )


def _check_loads(design: Design) -> None:
    """Raise ``InputError`` where the design file limits forces below the largest load of its protocol."""
    variable, scene_force = design.variables.force, design.scene.load.force
    varied = scene_force if variable.fixed else max(variable.choices, default=variable.high)
    limits = {"limits.force": design.limits.force, "variables.force": varied}
    for key, limit in limits.items():
        if limit is not None and limit < max(design.protocol.loads):
            texts = [FORCE_QUANTITY.format_value(load) for load in design.protocol.loads]
            raise InputError("protocol.loads", texts, f"at most {FORCE_QUANTITY.format_value(limit)}, the largest {key}")


def _resolve_calibration_path(design: Design, folder: Path) -> Design:
    """Return the design with the absolute path of its calibration file."""
    name = design.noise.calibration
    if name is None:
        return design
    return design.model_copy(update={"noise": design.noise.model_copy(update={"calibration": str((folder / name).absolute())})})

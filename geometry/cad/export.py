"""Export the parts and their assembly as STEP files; each is read back and measured before it takes its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

from geometry.cad import parts_record, solids, step_check, step_writer
from geometry.cad.stamp import build_stamp
from geometry.common.files import write_together
from geometry.scenes.probe import Probe

Writer = Callable[[Path], object]
NO_FILES: Mapping[str, Writer] = MappingProxyType({})


def export_parts(
    probe: Probe,
    folder: Path,
    force: bool = False,
    question_digest: str | None = None,
    other_files: Mapping[str, Writer] = NO_FILES,
    *,
    edge_radius: float = 0.0,
) -> tuple[Path, ...]:
    """Write inner, outer, film-inner, film-outer (if any), base and assembly ``.step`` (mm) into ``folder``; returns their paths.

    Every draft is read back and compared with the probe's parameters through formulas that are independent of the CAD
    model; the files are moved to the folder together, only after all have passed. ``parts.json`` beside them records their
    design and the dimensions that the scene leaves open; see ``geometry.cad.parts_record``. Its path follows those of the parts.

    Parameters
    ----------
    probe
        The probe to be built.
    folder
        For the files, made if needed.
    force
        Whether parts of another design that are there are replaced, with all that was written about it.
    question_digest
        Digest of the design file or scene of which the probe is the optimum, for the record.
    other_files
        Other files of the design, such as drawings: by name, the function that writes one to a path. These files take their
        places with the parts, and their paths come last.
    edge_radius
        Of the blocks' lower edges in m, the scene's ``contact.edge_radius``; 0: sharp.

    Raises
    ------
    ExportError
        A file deviates from the parameters by more than ``step_check.RELATIVE_TOLERANCE``; no file is left.
    InputError
        The folder holds another design; see also ``solids.build_parts``.
    MissingLibrary
        See ``solids.load_cadquery``.
    OSError
        The folder cannot be written.
    """
    old_record = parts_record.read_record(folder) if force else parts_record.check_same_design(folder, probe, edge_radius)
    same_design_record = (
        old_record
        if old_record is not None and old_record.design == parts_record.compute_design_digest(probe, edge_radius)
        else None
    )
    stamp = build_stamp(probe, edge_radius)
    with step_writer.silence_messages():
        shapes = solids.build_parts(probe, edge_radius)
        contents = {name: {name: shape} for name, shape in shapes.items()} | {"assembly": shapes}
        parts = dict(zip(contents, parts_record.list_part_files(probe), strict=True))
        # the record first: a kill between the moves leaves parts that it does not fit
        with write_together(folder, names := [parts_record.RECORD_NAME, *parts.values(), *other_files]) as draft_folder:
            for name, content in contents.items():
                solids.call_modeller(parts[name], partial(step_writer.write_step, content, draft_folder / parts[name], stamp))
            read = {name: draft_folder / file for name, file in parts.items()}
            solids.call_modeller("reading back", partial(step_check.check_files, probe, read, edge_radius))
            for name, write in other_files.items():
                write(draft_folder / name)
            drafts = {name: draft_folder / name for name in names[1:]}
            new_record = parts_record.build_record(probe, drafts, same_design_record, question_digest, edge_radius)
            (draft_folder / parts_record.RECORD_NAME).write_text(new_record.text(), encoding="utf-8")
    parts_record.remove_replaced(folder, old_record if same_design_record is None else None, names[1:])
    return tuple(folder / name for name in (*parts.values(), parts_record.RECORD_NAME, *other_files))

"""STEP files of the parts and of their assembly, each read back and measured before it takes its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

from geometry.cad import record, solids, step_check, step_writer
from geometry.cad.stamp import stamp_of
from geometry.common.files import written_together
from geometry.scenes.probe import Probe

Writer = Callable[[Path], object]
NOTHING: Mapping[str, Writer] = MappingProxyType({})


def export(
    probe: Probe,
    folder: Path,
    force: bool = False,
    asked: str | None = None,
    beside: Mapping[str, Writer] = NOTHING,
    *,
    edge_radius: float = 0.0,
) -> tuple[Path, ...]:
    """Write inner, outer, film-inner, film-outer (if any), base and assembly ``.step`` (mm) into ``folder``; returns their paths.

    Every draft is read back and compared with the probe's parameters through formulas that know nothing of the CAD
    model; the files take their names together, only after all have passed. ``parts.json`` beside them tells which design they
    are of and what in them the scene leaves open; see ``geometry.cad.record``. Its path follows those of the parts.

    Args:
        probe: what is to be built.
        folder: for the files, made if needed.
        force: whether parts of another design that are there are replaced, with all that was written about it.
        question_digest: digest of the question that the probe is the answer to, for the record.
        other_files: what else tells of design, a drawing say: by name what writes it to the path that it is given. These files
            take their places with the parts, and their paths come last.
        edge_radius: of the blocks' lower edges in m, the scene's ``contact.edge_radius``; 0: sharp.

    Raises:
        ExportError: a file does not hold what the parameters say, to ``step_check.RELATIVE_TOLERANCE``; no file is left.
        InputError: the folder holds another design; see also ``solids.build_parts``.
        MissingLibrary: see ``solids.load_cadquery``.
        OSError: the folder cannot be written.
    """
    before = record.read_record(folder) if force else record.check_same(folder, probe, edge_radius)
    same = before if before is not None and before.design == record.design_of(probe, edge_radius) else None
    stamp = stamp_of(probe, edge_radius)
    with step_writer.quiet():
        shapes = solids.parts(probe, edge_radius)
        contents = {name: {name: shape} for name, shape in shapes.items()} | {"assembly": shapes}
        parts = dict(zip(contents, record.part_files(probe), strict=True))
        # the record first: a kill between the moves leaves parts that it does not fit
        with written_together(folder, names := [record.NAME, *parts.values(), *beside]) as new:
            for name, content in contents.items():
                solids.built(parts[name], partial(step_writer.write, content, new / parts[name], stamp))
            read = {name: new / file for name, file in parts.items()}
            solids.built("reading back", partial(step_check.check, probe, read, edge_radius))
            for name, write in beside.items():
                write(new / name)
            drafts = {name: new / name for name in names[1:]}
            told = record.record_of(probe, drafts, same, asked, edge_radius)
            (new / record.NAME).write_text(told.text(), encoding="utf-8")
    record.clear(folder, before if same is None else None, names[1:])
    return tuple(folder / name for name in (*parts.values(), record.NAME, *beside))

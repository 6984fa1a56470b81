"""STEP files of the parts and of their assembly, each read back and measured before it takes its place."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path

from geometry.cad import record, solids, step_check, step_writer
from geometry.common.files import written_whole
from geometry.scenes.probe import Probe


def export(probe: Probe, folder: Path, force: bool = False, asked: str | None = None) -> tuple[Path, ...]:
    """Write inner, outer, film-inner, film-outer (if any), base and assembly ``.step`` (mm) into ``folder``; returns their paths.

    Every draft is read back and compared with the probe's parameters through formulas that know nothing of the CAD
    model; the files take their names only after all have passed, each of them whole. ``parts.json`` beside them, the last of
    the paths, tells which design they are of and what in them the scene leaves open; see ``geometry.cad.record``.

    Args:
        probe: what is to be built.
        folder: for the files, made if needed.
        force: whether parts of another design that are there are replaced, with all that was written about it.
        asked: digest of the question that the probe is the answer to, for the record.

    Raises:
        ExportError: a file does not hold what the parameters say, to ``step_check.TOLERANCE``; no file is left.
        InputError: the folder holds another design; see also ``geometry.scenes.base_sizes.base_sizes``.
        MissingLibrary: see ``solids.cadquery``.
        OSError: the folder cannot be written.
    """
    before = record.read_record(folder) if force else record.check_same(folder, probe)
    same = before if before is not None and before.design == record.design_of(probe) else None
    with step_writer.quiet(), ExitStack() as stack:
        shapes = solids.parts(probe)
        contents = {name: {name: shape} for name, shape in shapes.items()} | {"assembly": shapes}
        paths = {name: Path(folder, f"{name}.step") for name in contents}
        drafts = {name: stack.enter_context(written_whole(path)) for name, path in paths.items()}
        for name, content in contents.items():
            solids.built(paths[name].name, partial(step_writer.write, content, drafts[name]))
        solids.built("reading back", partial(step_check.check, probe, drafts))
        files = {paths[name].name: draft for name, draft in drafts.items()}
        # the last to be opened takes its place first: a kill in between leaves parts that their record does not fit
        new = stack.enter_context(written_whole(folder / record.NAME))
        new.write_text(record.record_of(probe, files, same, asked).text(), encoding="utf-8")
    record.clear(folder, before if same is None else None, files)
    return *paths.values(), folder / record.NAME

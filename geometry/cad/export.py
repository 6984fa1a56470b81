"""STEP files of the parts and of their assembly, each read back and measured before it takes its place."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path

from geometry.cad import solids, step_check, step_writer
from geometry.common.files import written_whole
from geometry.scenes.probe import Probe


def export(probe: Probe, folder: Path) -> tuple[Path, ...]:
    """Write inner, outer, film-inner, film-outer, base and assembly ``.step`` (mm) into ``folder``; returns their paths.

    Every draft is read back and compared with the probe's parameters through formulas that know nothing of the CAD
    model; the files take their names only after all have passed, each of them whole.

    Raises:
        ExportError: a file does not hold what the parameters say, to ``step_check.TOLERANCE``; no file is left.
        InputError: see ``geometry.scenes.base_sizes.base_sizes``.
        MissingLibrary: see ``solids.cadquery``.
        OSError: the folder cannot be written.
    """
    with step_writer.quiet(), ExitStack() as stack:
        shapes = solids.parts(probe)
        contents = {name: {name: shape} for name, shape in shapes.items()} | {"assembly": shapes}
        paths = {name: Path(folder, f"{name}.step") for name in contents}
        drafts = {name: stack.enter_context(written_whole(path)) for name, path in paths.items()}
        for name, content in contents.items():
            solids.built(paths[name].name, partial(step_writer.write, content, drafts[name]))
        solids.built("reading back", partial(step_check.check, probe, drafts))
    return tuple(paths.values())

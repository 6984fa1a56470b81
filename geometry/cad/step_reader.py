"""Read STEP files with names and colours by OCC's reader (XCAF)."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import solids
from geometry.cad.step_writer import create_document
from geometry.common.errors import ExportError

if TYPE_CHECKING:
    import cadquery
    from OCP.Quantity import Quantity_Color
    from OCP.TDF import TDF_Label, TDF_LabelSequence
    from OCP.TDocStd import TDocStd_Document


Rgb = tuple[float, float, float]  # linear red, green and blue
Part = tuple[str, "cadquery.Shape", Rgb]  # name, shape, colour


def read_step(path: Path) -> list[Part]:
    """Return name, shape and colour of every part in a STEP file that declares millimetres.

    The parts of an assembly are named ``assembly/part``; a colour that is missing is NaN.

    Raises
    ------
    ExportError
        The file declares another unit, or the reader stops.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Reader

    unit = re.search(rb"LENGTH_UNIT\(\)[^;]*?SI_UNIT\(([^)]*)\)", path.read_bytes())
    if unit is None or unit[1] != b".MILLI.,.METRE.":
        raise ExportError(f"{path.name}: unit = {unit and unit[1].decode()}, expected .MILLI.,.METRE.")
    reader, document = STEPCAFControl_Reader(), create_document()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone or not reader.Transfer(document):
        raise ExportError(f"{path.name}: the STEP reader stopped, expected a readable file")
    return _list_parts(document)


def _list_parts(document: TDocStd_Document) -> list[Part]:
    """Return the parts of a document; those of an assembly by their place in it."""
    from OCP.TDF import TDF_Label, TDF_LabelSequence
    from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    labels = TDF_LabelSequence()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    parts = []
    for label in _list_labels(labels):
        components = TDF_LabelSequence()
        XCAFDoc_ShapeTool.GetComponents_s(label, components)
        for placed in _list_labels(components):
            part = TDF_Label()
            XCAFDoc_ShapeTool.GetReferredShape_s(placed, part)
            parts.append(_read_part(f"{_read_name(label)}/{_read_name(part)}", part, placed))
        if components.IsEmpty():
            parts.append(_read_part(_read_name(label), label, label))
    return parts


def _list_labels(labels: TDF_LabelSequence) -> list[TDF_Label]:
    """Return the labels of an OCC sequence, which counts from 1."""
    return [labels.Value(index + 1) for index in range(labels.Length())]


def _read_part(name: str, label: TDF_Label, placed: TDF_Label) -> Part:
    """Return a part: its colour from its own label, its shape from the label of its place in an assembly."""
    from OCP.Quantity import Quantity_Color
    from OCP.XCAFDoc import XCAFDoc_ColorTool, XCAFDoc_ColorType, XCAFDoc_ShapeTool

    colour = Quantity_Color()
    kinds = (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen)
    coloured = any(XCAFDoc_ColorTool.GetColor_s(label, kind, colour) for kind in kinds)
    shape = solids.load_cadquery().Shape.cast(XCAFDoc_ShapeTool.GetShape_s(placed))
    return name, shape, read_rgb(colour) if coloured else (math.nan,) * 3


def _read_name(label: TDF_Label) -> str:
    """Return the name of a label; empty where it has none."""
    from OCP.TDataStd import TDataStd_Name

    name = TDataStd_Name()
    return name.Get().ToExtString() if label.FindAttribute(TDataStd_Name.GetID_s(), name) else ""


def read_rgb(colour: Quantity_Color) -> Rgb:
    """Return the components of an OCC colour."""
    return colour.Red(), colour.Green(), colour.Blue()

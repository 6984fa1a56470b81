"""STEP files written by OCC's writer with names and colours (XCAF)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from geometry.cad import solids
from geometry.common.errors import ExportError

ASSEMBLY = "probe"
"""Name of the assembly inside ``assembly.step``."""


def write(shapes: dict[str, Any], path: Path) -> None:
    """Write one solid, or several as the components of an assembly, with their names and colours.

    Raises:
        ExportError: the writer stops.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Writer

    document, writer = new_document(), STEPCAFControl_Writer()
    _add(document, shapes)
    if not writer.Transfer(document) or writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ExportError(f"{path.name}: the STEP writer stopped, expected a file in {path.parent.parent}")


def _add(document: Any, shapes: dict[str, Any]) -> None:
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    tool, colours = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()), XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    whole = _named(tool.NewShape(), ASSEMBLY) if len(shapes) > 1 else None
    for name, shape in shapes.items():
        # the solid itself: wrapped in a compound, as cadquery's exporter has it, it reads back as a nameless assembly
        label = _named(tool.AddShape(shape.wrapped, False), name)
        colours.SetColor(label, colour_of(name), XCAFDoc_ColorType.XCAFDoc_ColorSurf)
        if whole is not None:
            _named(tool.AddComponent(whole, label, TopLoc_Location()), name)
    tool.UpdateAssemblies()


def new_document() -> Any:
    """Create an empty OCC document that holds shapes with names and colours."""
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFApp import XCAFApp_Application

    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    return document


def colour_of(name: str) -> Any:
    """Return the colour of the part of that name as OCC has it."""
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor

    return Quantity_Color(*solids.COLOURS[name], Quantity_TypeOfColor.Quantity_TOC_sRGB)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep OCC's own messages off stdout, where the program prints its JSON."""
    solids.cadquery()
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)


def _named(label: Any, name: str) -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name

    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    return label

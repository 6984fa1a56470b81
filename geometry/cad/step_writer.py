"""Write STEP files (ISO 10303-242, AP242) with names, colours, materials and origin by OCC's writer (XCAF)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import solids
from geometry.cad.materials import PartMaterial
from geometry.cad.stamp import Stamp
from geometry.common.errors import ExportError
from geometry.provenance.texts import split_block

if TYPE_CHECKING:
    import cadquery
    from OCP.Interface import Interface_InterfaceModel
    from OCP.Quantity import Quantity_Color
    from OCP.TDF import TDF_Label
    from OCP.TDocStd import TDocStd_Document


ASSEMBLY_NAME = "probe"
"""Name of the assembly inside ``assembly.step``."""
STEP_SCHEMA = "AP242DIS"
FIXED_TIMESTAMP = "1970-01-01T00:00:00"  # in place of a date, which the format wants: the same design gives the same file


def write_step(shapes: Mapping[str, cadquery.Shape], path: Path, stamp: Stamp) -> None:
    """Write one solid, or several as the components of an assembly, with their names, colours and materials.

    Raises
    ------
    ExportError
        The writer stops.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.Interface import Interface_Static
    from OCP.STEPCAFControl import STEPCAFControl_Writer

    document, writer = create_document(), STEPCAFControl_Writer()
    Interface_Static.SetCVal_s("write.step.schema", STEP_SCHEMA)
    _add_shapes(document, shapes, stamp)
    transferred = writer.Transfer(document)
    _write_header(writer.ChangeWriter().Model(), path.name, stamp)
    if not transferred or writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ExportError(f"{path.name}: the STEP writer stopped, expected a file in {path.parent.parent}")


def _write_header(model: Interface_InterfaceModel, name: str, stamp: Stamp) -> None:
    """Write file name, program, stamp and provenance into the file's header, without a date or an author."""
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.Interface import Interface_HArray1OfHAsciiString
    from OCP.TCollection import TCollection_HAsciiString

    header, (system, file, time, nobody) = (
        APIHeaderSection_MakeHeader(model),
        (TCollection_HAsciiString(text) for text in (stamp.program, name, FIXED_TIMESTAMP, "")),
    )
    header_lines = [stamp.text, *split_block(stamp.provenance)]
    description = Interface_HArray1OfHAsciiString(1, len(header_lines))
    for place, text in enumerate(header_lines, start=1):
        description.SetValue(place, TCollection_HAsciiString(text))
    header.SetName(file)
    header.SetTimeStamp(time)
    header.SetOriginatingSystem(system)
    header.SetDescription(description)
    header.SetAuthorValue(1, nobody)
    header.SetOrganizationValue(1, nobody)


def _add_shapes(document: TDocStd_Document, shapes: Mapping[str, cadquery.Shape], stamp: Stamp) -> None:
    """Add shapes to a document, with names, colours and materials; several as the components of one assembly."""
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    tool, colours = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()), XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    assembly = _set_name(tool.NewShape(), ASSEMBLY_NAME) if len(shapes) > 1 else None
    for name, shape in shapes.items():
        # the solid itself: wrapped in a compound, as cadquery's exporter has it, it reads back as a nameless assembly
        label = _set_name(tool.AddShape(shape.wrapped, False), name)
        colours.SetColor(label, find_colour(name), XCAFDoc_ColorType.XCAFDoc_ColorSurf)
        _set_material(document, label, stamp.materials.get(name))
        if assembly is not None:
            _set_name(tool.AddComponent(assembly, label, TopLoc_Location()), name)
    tool.UpdateAssemblies()


def _set_material(document: TDocStd_Document, label: TDF_Label, material: PartMaterial | None) -> None:
    """Set a part's material, with the density among its properties: OCC 7.9 writes the format's own density in g^3 cm^2."""
    from OCP.TCollection import TCollection_HAsciiString
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    if material is None:
        return
    density = "" if material.density is None else f", density {material.density:g} kg/m3"
    name, properties, nothing = (TCollection_HAsciiString(text) for text in (material.name, material.properties + density, ""))
    XCAFDoc_DocumentTool.MaterialTool_s(document.Main()).SetMaterial(label, name, properties, 0.0, nothing, nothing)


def create_document() -> TDocStd_Document:
    """Create an empty OCC document that holds shapes with names and colours."""
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFApp import XCAFApp_Application

    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    return document


def find_colour(name: str) -> Quantity_Color:
    """Return the colour of a part, by its name, as an object of OCC."""
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor

    return Quantity_Color(*solids.PART_COLOURS[name], Quantity_TypeOfColor.Quantity_TOC_sRGB)


@contextmanager
def silence_messages() -> Iterator[None]:
    """Keep OCC's own messages off stdout, where the program prints its JSON."""
    solids.load_cadquery()
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


def _set_name(label: TDF_Label, name: str) -> TDF_Label:
    """Name a label of a document, and return it."""
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name

    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    return label

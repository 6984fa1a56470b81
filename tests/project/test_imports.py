"""Direction of imports, package by package and subpackage by subpackage.

A subpackage is a folder of a package; the modules of a package's own folder are its face, which has the package's name.
"""

from __future__ import annotations

from graphlib import TopologicalSorter

import pytest

from tests.support.imports import everywhere, find_subpackage, module, sources
from tests.support.paths import ROOT

SCENES = {"geometry.common", "geometry.scenes"}
PROVENANCE = {"geometry.provenance", *SCENES}
MESHES = {"geometry.meridian", *SCENES}
SIGNALS = {"hw", "hw.common", "hw.signal"}
ANSWERS = {"solver", "solver.results", *PROVENANCE}  # asked for by the face

# What each subpackage may import of ours beside itself: subpackages, or single modules of those that it needs nothing else of;
# comments state the reasons.
ALLOWED: dict[str, set[str]] = {
    # geometry stands alone: a workshop needs no solver
    "geometry": SCENES,
    "geometry.common": set(),
    "geometry.scenes": {"geometry.common"},
    "geometry.meridian": {"geometry.common"},
    "geometry.provenance": SCENES,
    "geometry.cad": PROVENANCE,
    "geometry.workshop": {"geometry.cad", *PROVENANCE},
    "geometry.processes": {"geometry.common"},
    "geometry.mesh_programs": {"geometry.processes", "geometry.common"},
    "geometry.tetra": {"geometry.cad", "geometry.mesh_programs", "geometry.processes", *SCENES},
    # hw stands alone: a measuring computer needs neither shapes nor solvers; sources of samples know the wire, the reader all
    "hw": {"hw.common", "hw.files", "hw.wire", "hw.recordings", "hw.usb", "hw.serial_port", "hw.simulation", "hw.oscilloscope"},
    "hw.common": set(),
    "hw.wire": {"hw.common"},
    "hw.signal": {"hw.common"},
    "hw.recordings": {"hw.common"},
    "hw.files": {"hw.common"},
    "hw.usb": {"hw.common", "hw.wire"},
    "hw.serial_port": {"hw.common", "hw.wire"},
    "hw.simulation": {"hw.common", "hw.wire"},
    "hw.oscilloscope": {"hw.common", "hw.usb"},
    # solver sees scenes only: results never depend on how they are asked for, optimised or shown; a level knows those that it
    # stands on, planning the three that it chooses from, the face all, and no level the face
    "solver.linalg": {"geometry.common"},
    "solver.results": {"solver.linalg", *PROVENANCE},
    "solver.inclusions": {"solver.linalg", "solver.materials", *SCENES},
    "solver.published": {"solver.results", *SCENES},
    "solver.materials": SCENES,
    "solver.layers": {"solver.materials", *SCENES},
    "solver.closed_form": {"solver.inclusions", "solver.layers", "solver.linalg", "solver.results", *SCENES},
    "solver.tumour_waves": {"solver.closed_form", "solver.inclusions", "solver.layers", "geometry.common"},
    "solver.elements": {"solver.linalg", "solver.materials", "geometry.common"},
    "solver.axisymmetric": {"solver.elements", "solver.linalg", "solver.materials", "solver.results", *MESHES},
    "solver.contact": {
        "solver.axisymmetric",
        "solver.elements",
        "solver.equivalent_inclusion",  # of tumours off the axis, the linear limit
        "solver.inclusions",
        "solver.linalg",
        "solver.materials",
        "solver.results",
        *MESHES,
    },
    "solver.multiple_scattering": {
        *("solver.axisymmetric", "solver.elements", "solver.inclusions", "solver.linalg", "solver.materials"),
        *MESHES,
    },
    "solver.equivalent_inclusion": {
        "solver.axisymmetric",
        *("solver.elements", "solver.inclusions", "solver.linalg", "solver.materials", "solver.multiple_scattering"),
        "solver.results",
        *MESHES,
    },
    "solver.reading_tables": {
        *("geometry", "solver.contact", "solver.equivalent_inclusion", "solver.inclusions", "solver.linalg"),
        *("solver.materials", "solver.planning"),
        *ANSWERS,
    },
    "solver.solid": {
        "solver.axisymmetric",
        "solver.linalg",
        "solver.materials",
        "solver.multiple_scattering",  # how stacks of film and bonds deform, which is no field of a rotationally symmetric probe
        "solver.results",
        "geometry.processes",
        "geometry.tetra",
        *SCENES,
    },
    "solver.phase": {"solver.axisymmetric", "solver.equivalent_inclusion", "solver.materials", "solver.results", *MESHES},
    "solver.planning": {
        "solver.axisymmetric",
        "solver.contact",
        "solver.elements",
        "solver.equivalent_inclusion",
        "solver.inclusions",
        "solver.linalg",
        "solver.materials",
        "solver.results",
        "solver.solid",
        "geometry.tetra",
        *MESHES,
    },
    "solver.casadi_functions": {
        "solver.axisymmetric",
        "solver.closed_form",
        "solver.equivalent_inclusion",
        "solver.results",
        *MESHES,
    },
    "solver": {
        "solver.axisymmetric",
        "solver.closed_form",
        "solver.contact",
        "solver.equivalent_inclusion",
        "solver.linalg",
        "solver.phase",
        "solver.planning",
        "solver.published",
        "solver.results",
        "solver.solid",
        *PROVENANCE,
    },
    # probe_design: what is computed knows neither the terminal nor the command line, so that scripts and workers can ask for it;
    # beside the solver's face each subpackage sees those inner subpackages whose batches of results it needs
    "probe_design.data": SCENES,
    "probe_design.inference": {"geometry.common"},
    "probe_design.repetition": PROVENANCE,
    "probe_design.reporting": {
        "probe_design.maps",
        "solver.axisymmetric",
        "solver.elements",
        "solver.equivalent_inclusion",
        "geometry.meridian",
        *ANSWERS,
    },
    "probe_design.populations": {
        "probe_design.built_probe.calibration_record",  # gains that were calibrated
        "probe_design.data",
        "probe_design.inference",
        "probe_design.maps.sphere_effects",
        "probe_design.maps.scan_line",
        "solver.closed_form",
        "solver.contact",  # readings under a load
        "solver.equivalent_inclusion",
        "solver.inclusions",
        "solver.planning",
        *ANSWERS,
    },
    "probe_design.design_report": {
        "probe_design.data",
        "probe_design.design_search",
        "probe_design.reporting",
        "probe_design.populations",
        "geometry.cad",
        "geometry.workshop",
        "geometry.provenance",
        *ANSWERS,
    },
    "probe_design.design_search": {
        "probe_design.data",
        "solver.contact",
        "probe_design.estimation.measurements",
        "probe_design.inference",
        "probe_design.locating",  # simulated scans verify what a scan says
        "probe_design.populations",
        *("probe_design.built_probe", "probe_design.tolerancing"),  # how a probe varies as built
        "solver.casadi_functions",
        "solver.closed_form",
        *("solver.equivalent_inclusion", "solver.inclusions"),
        "solver.planning",
        "solver.tumour_waves",
        *ANSWERS,
    },
    "probe_design.material_fit": {"solver.materials", "hw.common", "hw.files", *SCENES},
    "probe_design.maps": {
        "probe_design.data",
        "solver.contact",
        "solver.equivalent_inclusion",
        "solver.inclusions",
        "solver.planning",
        *ANSWERS,
    },
    "probe_design.estimation": {
        "probe_design.data",
        "probe_design.inference",
        "probe_design.maps.target_grid",
        "solver.contact",
        "solver.equivalent_inclusion",
        "solver.inclusions",
        "solver.phase",
        "solver.planning",
        *ANSWERS,
    },
    "probe_design.locating": {
        *{f"probe_design.estimation.{name}" for name in ("made_readings", "measurements")},
        "probe_design.populations",
        "probe_design.reporting",
        "solver.equivalent_inclusion",
        "solver.inclusions",
        "solver.planning",  # the load up to which the tables hold
        "solver.reading_tables",
        *ANSWERS,
    },
    "probe_design.explorer": {
        "probe_design.built_probe",  # readings of the bench page, of a virtual probe, too
        "probe_design.data",
        "probe_design.design_search",  # in the worker, as the workshop's files
        "probe_design.estimation.measurements",
        "probe_design.locating",
        "probe_design.maps",
        "probe_design.measuring",
        "probe_design.populations",
        "probe_design.surveys",
        "probe_design.workshop",
        "geometry.cad",
        "geometry.processes",
        "solver.closed_form",
        "solver.evaluators",
        "solver.linalg.workspace",  # of each design its own, so that memory stays
        *{"hw.files.columns", "hw.simulation", *SIGNALS},
        *ANSWERS,
    },
    "probe_design.surveys": {
        "probe_design.built_probe",  # the virtual one, and readings of it
        "probe_design.data.noise",
        *{f"probe_design.estimation.{name}" for name in ("made_readings", "measurements")},
        "probe_design.locating",
        "probe_design.populations",
        "probe_design.reporting",
        "solver.reading_tables",  # readings of the virtual tissue, by the evaluator that tables are built from
        "solver.inclusions",
        *ANSWERS,
    },
    "probe_design.tolerancing": {
        "geometry.cad.materials",  # how each block is made
        "geometry.workshop.tolerance",  # and how exactly
        "probe_design.built_probe",  # the bench's tolerances, the probe as a workshop measures it
        "probe_design.data",
        "probe_design.reporting",
        "solver.axisymmetric",
        "solver.closed_form",
        "solver.contact",
        "solver.equivalent_inclusion",
        "solver.planning",
        *ANSWERS,
    },
    "probe_design.tradeoffs": {
        "probe_design.reporting",
        "solver.linalg",
        "solver.planning",
        "geometry.tetra",
        *ANSWERS,
    },
    "probe_design.sweeps": {
        "probe_design.reporting",
        "geometry.processes",
        "solver.closed_form",
        "solver.linalg",
        "solver.planning",
        *ANSWERS,
    },
    "probe_design.built_probe": {
        "geometry.cad.fixture",  # the sizes of pin and ring, which it derives without a solid
        "geometry.meridian.section",  # the bodies of bonds and tissue, by whose moduli readings are differentiated
        "geometry.workshop.tolerance",  # how exactly each block is made
        "probe_design.inference",
        "solver.axisymmetric",
        "solver.contact",
        "solver.equivalent_inclusion",
        "solver.phase",
        "solver.planning",
        *SIGNALS,
        *ANSWERS,
    },
    "probe_design.measuring": {
        "probe_design.built_probe",
        "geometry.cad",
        "geometry.processes",
        "geometry.workshop",  # the fixture's sizes and the probe's outlines, on the page to print
        "solver.planning",
        *SIGNALS,
        *ANSWERS,
    },
    "probe_design.probe_check": {"probe_design.built_probe", "probe_design.inference", "hw.common", "hw.signal", *ANSWERS},
    "probe_design.doctor": {"probe_design.built_probe", "hw.common", "hw.signal", "hw.usb", *PROVENANCE},
    "probe_design.solid_output": {
        "probe_design.reporting",
        "solver.planning",
        "solver.solid",
        "geometry.cad",
        "geometry.processes",
        "geometry.tetra",
        *ANSWERS,
    },
    "probe_design.workshop": {"probe_design.tolerancing", "geometry.cad", "geometry.workshop", *ANSWERS},
    # terminal shows what they found, cli asks them for it; the face offers from Python what can be asked
    "probe_design.terminal": {
        "probe_design.measuring",
        "probe_design.built_probe",
        "probe_design.data",
        "probe_design.doctor",
        "probe_design.estimation",
        "probe_design.maps",
        "probe_design.probe_check",
        "probe_design.reporting",
        "probe_design.sweeps",
        "probe_design.tolerancing",
        "probe_design.workshop",
        "solver.planning",
        "solver.results",
        "hw.common",
        *SCENES,
    },
    "probe_design.process": set(),
    "probe_design.commands": {
        "probe_design.built_probe",
        "probe_design.data",
        "probe_design.design_report",
        "probe_design.design_search",
        "probe_design.doctor",
        "probe_design.estimation",
        "probe_design.explorer",
        "probe_design.locating",
        "probe_design.maps",
        "probe_design.material_fit",
        "probe_design.measuring",
        "probe_design.reporting",
        "probe_design.populations",
        "probe_design.probe_check",
        "probe_design.process",
        "probe_design.repetition",
        "probe_design.solid_output",
        "probe_design.surveys",
        "probe_design.sweeps",
        "probe_design.terminal",
        "probe_design.tolerancing",
        "probe_design.tradeoffs",
        "probe_design.workshop",
        "solver",
        "geometry.cad",
        "geometry.workshop",
        "hw",
        "hw.common",
        "hw.files",
        "hw.recordings",
        "hw.signal",
        "hw.simulation",
        *PROVENANCE,
    },
    "probe_design": {
        "geometry.scenes",  # Scene is a public name
        "probe_design.commands",
        "probe_design.design_report",
        "probe_design.design_search",
        "probe_design.locating",  # Locator is a public name
        "probe_design.process",
        "probe_design.reporting",
        "probe_design.sweeps",
        "solver",
        "solver.reading_tables",
        "solver.results",
    },
}
PACKAGES = sorted({name.split(".")[0] for name in ALLOWED})


def test_every_subpackage_has_a_direction() -> None:
    assert {find_subpackage(module(path)) for package in PACKAGES for path in sources(package)} == ALLOWED.keys()


@pytest.mark.parametrize("package", PACKAGES)
def test_direction(package: str) -> None:
    wrong = []
    for path in sources(package):
        subpackage = find_subpackage(module(path))
        allowed = {subpackage, *ALLOWED[subpackage]}
        wrong += [
            f"{path.relative_to(ROOT)} imports {name}" for name in everywhere(path) if not {name, find_subpackage(name)} & allowed
        ]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_import_cycles(package: str) -> None:
    """The modules of a package can be put in an order in which each knows earlier ones only, late imports and types included."""
    names = {module(path): everywhere(path) - {module(path)} for path in sources(package)}
    TopologicalSorter({name: needs & names.keys() for name, needs in names.items()}).prepare()


def test_no_cycles_of_subpackages() -> None:
    """So can all subpackages, whatever is imported late or for types only."""
    needs: dict[str, set[str]] = {name: set() for name in ALLOWED}
    for path in (path for package in PACKAGES for path in sources(package)):
        subpackage = find_subpackage(module(path))
        needs[subpackage] |= {find_subpackage(name) for name in everywhere(path)} - {subpackage}
    TopologicalSorter(needs).prepare()

"""The commands by name: group in the help text, request, and a description of one line.

They are stated here, and tested against the requests, so that ``probe-design --help`` imports no request.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from probe_design.commands.request import Request


@dataclass(frozen=True)
class CommandName:
    """A command in the help text.

    Attributes
    ----------
    group
        Heading under which it stands.
    request
        Module of this package and class, "maps:ScanRequest"; "" for a command that consists of others.
    summary
        Description of one line, at most ``MAX_SUMMARY_LENGTH`` characters.
    """

    group: str
    request: str
    summary: str

    def load_request(self) -> type[Request]:
        """Import and return the class of the request."""
        module, _, name = self.request.partition(":")
        request: type[Request] = getattr(import_module(f"probe_design.commands.{module}"), name)
        return request


MAX_SUMMARY_LENGTH = 61  # so that it stands beside the longest name within 80 columns
DESIGN, PREDICT, READINGS, BUILT_PROBE, DATA = "Design", "Predict", "From readings", "Built probe", "Data"
COMMANDS = {
    "init": CommandName(DESIGN, "init:InitRequest", "Write a first scene or design file after a few questions."),
    "optimize": CommandName(DESIGN, "optimize:OptimizeRequest", "Search a better probe, verify it and export it."),
    "sweep": CommandName(DESIGN, "sweep:SweepRequest", "Evaluate thousands of designs, each once."),
    "tolerances": CommandName(DESIGN, "evaluate:TolerancesRequest", "Effect of manufacturing tolerances on the ratio."),
    "tradeoff": CommandName(DESIGN, "sweep:TradeoffRequest", "Time and error of every evaluator on your scenes."),
    "explore": CommandName(DESIGN, "explore:ExploreRequest", "A page on which you see what each dimension does."),
    "export": CommandName(DESIGN, "export:ExportRequest", "Write the files that a workshop needs."),
    "evaluate": CommandName(PREDICT, "evaluate:EvaluateRequest", "Film stresses, their ratio and its sensitivity to the tumour."),
    "plan": CommandName(PREDICT, "evaluate:PlanRequest", "Which model reaches an accuracy, and what it neglects."),
    "curve": CommandName(PREDICT, "evaluate:CurveRequest", "Ratio and sensitivity over the tumour's Young's modulus."),
    "load": CommandName(PREDICT, "maps:LoadRequest", "Ratio and the gap between the blocks under rising loads."),
    "scan": CommandName(PREDICT, "maps:ScanRequest", "Readings of the probe along a line over the tissue."),
    "detectability": CommandName(PREDICT, "maps:DetectabilityRequest", "Which tumours are detected, over depth and diameter."),
    "estimate": CommandName(READINGS, "estimate:EstimateRequest", "Modulus, diameter or depth from readings."),
    "locate": CommandName(READINGS, "locate:LocateRequest", "Where tumours lie, how deep and how large, from a scan."),
    "survey": CommandName(READINGS, "survey:SurveyRequest", "Press after press: the map, where to press, when to stop."),
    "read": CommandName(BUILT_PROBE, "hardware:ReadRequest", "Read a built probe under a sinusoidal load."),
    "calibrate": CommandName(
        BUILT_PROBE, "hardware:CalibrateRequest", "Determine gains, cross-talk and offsets of a built probe."
    ),
    "check": CommandName(BUILT_PROBE, "hardware:CheckRequest", "Compare a built probe with its drawing."),
    "doctor": CommandName(BUILT_PROBE, "hardware:DoctorRequest", "What is installed, connected and permitted; test a probe."),
    "tissue": CommandName(DATA, "", "List and show built-in tissues."),
    "tissue list": CommandName("", "catalogue:TissueListRequest", "List the built-in tissues."),
    "tissue show": CommandName("", "catalogue:TissueShowRequest", "Print the [tissue] table of one for a scene file."),
    "material": CommandName(DATA, "", "List and show built-in materials and bonds; fit a law."),
    "material list": CommandName("", "catalogue:MaterialListRequest", "List the built-in materials and bonds."),
    "material show": CommandName("", "catalogue:MaterialShowRequest", "Print the table of one for a scene file."),
    "material fit": CommandName("", "material:MaterialFitRequest", "Fit a law that stiffens to a measured curve."),
    "rerun": CommandName(DATA, "catalogue:RerunRequest", "Repeat the command that made a file; compare the numbers."),
}
GROUP_HELP = {
    "tissue": """
    List and show built-in tissues: breast, forearm, a phantom; every number with its source.

    \b
    probe-design tissue list
    probe-design tissue show breast   the [tissue] table for a scene file
    """,
    "material": """
    List and show built-in materials: block elastomers, base plastics and metals, films, bonds, recipes; all with sources.

    \b
    probe-design material list
    probe-design material show dragon-skin-30   the [probe.inner] table
    probe-design material show tape-50um        the table of a bond
    probe-design material show ecoflex-00-10 --thinner 0.3
    probe-design material fit curve.csv --test tension
    """,
}

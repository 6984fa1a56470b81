"""Design, check and export tactile palpation probes, from Python as from the command line.

A ``Scene`` describes a probe and the tissue that it is pressed on. ``Scene.from_file`` reads one (docs/reference/scene-file.md),
``scene.replace({"probe.gap": "0.2 mm"})`` returns it with other values, ``scene.plot()`` draws it. Numbers are in SI units. The
public functions take a scene or the name of its file:

    evaluate       film stresses, their ratio and its sensitivity to the tumour's modulus
    evaluate_many  the same for many scenes, in order; designs that differ in moduli or loads share one curve
    plan           which evaluator reaches a given accuracy for a scene, and which features it neglects
    curve          ratio and log-sensitivity over the target's Young's modulus
    press          ratio, log-sensitivity and the gap between the blocks under rising loads
    scan           readings of the probe along a line over the tissue
    detectability  which tumours the probe detects, and which it resolves in stiffness
    estimate       modulus, diameter or depth from readings
    locate         number, place, depth and size of tumours from a scan
    Locator        the same while the scan goes on: the map after each reading, and where to press next
    optimize       search a better probe for a population of tumours, or for the tumour of a scene
    sweep          evaluate thousands of designs, each once
    tolerances     how manufacturing tolerances change the ratio, and which ones are needed
    tradeoff       time and error of every evaluator on your scenes
    fit_material   a law at finite strain from a measured curve of stress and stretch
    calibrate      gains, cross-talk and offsets of a built probe
    read           a reading of a built probe, compared with its prediction
    check          a built probe compared with its drawing
    survey         press after press: the map, where to press next, when to stop
    export         write the files for the workshop: STEP, drawings, film patterns, moulds, lists
    predict_readings  how tumours change the readings of a scan, for many candidates at once
    plot           draw the result of curve, press, scan or detectability

    >>> from probe_design import evaluate
    >>> evaluate("examples/scene.toml", evaluator="closed-form").ratio  # doctest: +SKIP

Results are immutable and print as short tables; ``to_frame()`` (pandas) and ``to_dataset()`` (xarray) return arrays with labels.
``virtual=True`` stands in for a built probe.
"""

# Imports inside functions: signals are heard before click and the commands load; public names load when they are used.

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # typing's, which takes longer to import than all that the program does before it listens to signals
if TYPE_CHECKING:
    from geometry.scenes.scene import Scene
    from probe_design.commands.built_probe import calibrate, check, read, survey
    from probe_design.commands.estimate import estimate
    from probe_design.commands.evaluate import tolerances
    from probe_design.commands.export import export
    from probe_design.commands.locate import locate
    from probe_design.commands.maps import detectability, scan
    from probe_design.commands.material import fit_material
    from probe_design.commands.optimize import optimize
    from probe_design.commands.plot import plot
    from probe_design.commands.sweep import tradeoff
    from probe_design.locating.locator import Locator
    from probe_design.sweeps.run import sweep
    from solver.batch import evaluate_many
    from solver.evaluation import curve, evaluate, plan, press
    from solver.reading_tables.predict import predict_readings

__all__ = [
    "Locator",
    "Scene",
    "calibrate",
    "check",
    "curve",
    "detectability",
    "estimate",
    "evaluate",
    "evaluate_many",
    "export",
    "fit_material",
    "locate",
    "optimize",
    "plan",
    "plot",
    "predict_readings",
    "press",
    "read",
    "scan",
    "survey",
    "sweep",
    "tolerances",
    "tradeoff",
]

_MODULE_NAMES = dict.fromkeys(("curve", "evaluate", "plan", "press"), "solver.evaluation")
_MODULE_NAMES |= dict.fromkeys(("detectability", "scan"), "probe_design.commands.maps")
_MODULE_NAMES |= {"fit_material": "probe_design.commands.material", "Scene": "geometry.scenes.scene"}
_MODULE_NAMES |= {name: f"probe_design.commands.{name}" for name in ("estimate", "export", "locate", "optimize")}
_MODULE_NAMES |= dict.fromkeys(("calibrate", "check", "read", "survey"), "probe_design.commands.built_probe")
_MODULE_NAMES |= {"tolerances": "probe_design.commands.evaluate", "tradeoff": "probe_design.commands.sweep"}
_MODULE_NAMES |= {"evaluate_many": "solver.batch", "sweep": "probe_design.sweeps.run", "plot": "probe_design.commands.plot"}
_MODULE_NAMES |= {"predict_readings": "solver.reading_tables.predict", "Locator": "probe_design.locating.locator"}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used; the help of the command line needs none of them."""
    if name in __all__:
        return getattr(import_module(_MODULE_NAMES[name]), name)
    if name == "__version__":
        return import_module("importlib.metadata").version(import_module("geometry.provenance.block").DISTRIBUTION)
    if name == "load":  # the name up to version 0.3; to be removed in 0.5
        import_module("warnings").warn("probe_design.load is called press", DeprecationWarning, stacklevel=2)
        return import_module("solver.evaluation").press
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names; subpackages are imported by their own names."""
    return sorted([*__all__, "__all__", "__doc__", "__file__", "__name__", "__path__", "__version__"])


if "IPython" in sys.modules:
    from probe_design.notebook import register_displays

    register_displays()

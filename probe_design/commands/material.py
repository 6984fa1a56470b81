"""The command `material fit`, and its function: a law at finite strain from a measured curve."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from geometry.common.errors import InputError, Words
from geometry.scenes.quantities import PoissonRatio
from probe_design.commands.fields import Picture
from probe_design.commands.output import print_json
from probe_design.commands.request import Number, Option, Request, is_positive, use_request
from probe_design.material_fit.kinds import LawChoice, StressKind, Test
from probe_design.reporting.picture_files import save_figure
from probe_design.terminal.console import warn, write_message

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from geometry.common.arrays import Floats
    from probe_design.material_fit.material_fit import MaterialFit

DEFAULT_POISSON_RATIO = 0.495  # of nearly incompressible elastomers and tissues, as the catalogue assumes


class MaterialFitRequest(Request):
    """Fit neo-Hookean and Yeoh's laws to CURVE, and print the table for a scene file.

    CURVE is a text file of columns with one row of names: "stretch" or "strain" (in simple shear "shear"), and "stress" with its
    unit, "nominal stress (kPa)" or "true stress (MPa)"; other columns are ignored. Commas, semicolons, tabs, decimal commas and
    files of spreadsheets are understood. Keep one loading branch.

    The law is the one of least misfit that its constants justify, stable over the curve's range by Drucker's condition; one that
    is stable at every strain is preferred where its misfit is good, because corners of blocks strain beyond any curve.

    \b
    probe-design material fit ecoflex.csv --test tension --max-strain 1
    probe-design material fit gland.csv --test compression --plot gland.png
    """  # noqa: D301

    curve: Annotated[
        Path | Any,
        Field(
            description="a file, or an array of shape (n, 2): stretches (in simple shear tangents of the angle), stresses in Pa"
        ),
        Option("File of the curve.", is_argument=True),
    ]
    test: Annotated[
        Test,
        Option("How the sample was loaded: uniaxial has both signs; compression is of a lubricated sample."),
    ]
    stress: Annotated[
        StressKind | None,
        Option("Force over the undeformed (nominal) or the deformed area.", left_out="as the column's name says"),
    ] = None
    law: Annotated[LawChoice, Option("Law to fit.")] = "auto"
    max_strain: Annotated[
        Annotated[float, Number("a number above 0, such as 0.5 or 50 %", is_positive, percent=True)] | None,
        Option("Largest strain to fit; points beyond it are left out.", left_out="all"),
    ] = None
    poisson_ratio: Annotated[PoissonRatio, Option("Poisson's ratio of the table; the curve does not determine it.")] = (
        DEFAULT_POISSON_RATIO
    )
    picture: Annotated[Picture, Option("Draw the curve and the laws to this .png, .svg or .pdf file.", "--plot")] = None

    def run(self) -> None:
        """Fit, and print the table."""
        result = self.call(fit_material)
        if self.picture is not None:
            from probe_design.material_fit.figure import draw_fit

            save_figure(draw_fit(result), self.picture)
        if self.as_json:
            print_json(result.as_dict())
            return
        print(result.to_toml(), end="")
        warn(result.warnings)
        if self.picture is not None:
            write_message(f"wrote {self.picture}")


@use_request(MaterialFitRequest)
def fit_material(
    curve: Path | str | ArrayLike, *, test: Test, stress: StressKind | None = None, law: LawChoice = "auto",
    max_strain: float | None = None, poisson_ratio: float = DEFAULT_POISSON_RATIO,
) -> MaterialFit:  # fmt: skip
    """Fit neo-Hookean and Yeoh's laws to a measured curve.

    Parameters
    ----------
    stress : "nominal" or "true"; default: as the column's name says
        Force over the undeformed or the deformed area; required beside points.

    Returns
    -------
    MaterialFit
        Constants with their covariance, range and misfit; ``to_toml()`` is a scene's table.

    Raises
    ------
    InputError
        The curve cannot be read, or is none of that test.

    Examples
    --------
    >>> from probe_design import fit_material
    >>> fit_material("ecoflex.csv", test="tension", max_strain=1.0).youngs_modulus  # doctest: +SKIP
    """
    from probe_design.material_fit.curve import build_curve
    from probe_design.material_fit.curve_file import read_curve_file
    from probe_design.material_fit.material_fit import build_fit

    if isinstance(curve, str | Path):
        deformation, values, kind = read_curve_file(Path(curve), test, stress)
        source = Path(curve).name
    else:
        deformation, values = _read_points(curve)
        if stress is None:
            raise InputError("stress", Words("missing"), "'nominal' or 'true' beside points")
        kind, source = stress, "points"
    return build_fit(build_curve(test, deformation, values, kind, max_strain), law, poisson_ratio, source)


def _read_points(points: ArrayLike) -> tuple[Floats, Floats]:
    """Return the columns of an array of shape (n, 2), or refuse it."""
    import numpy as np

    try:
        table = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.ndim != 2 or table.shape[1] != 2 or not table.size:
        raise InputError("curve", Words(f"an array of shape {table.shape}"), "shape (n, 2): stretches and stresses in Pa")
    return table[:, 0], table[:, 1]

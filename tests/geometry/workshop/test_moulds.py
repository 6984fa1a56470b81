"""The moulds: STEP files against volumes by quadrature, and what a cavity of that volume leaves when it has shrunk."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import pytest
from scipy.integrate import quad

from geometry.cad.stamp import build_stamp
from geometry.common.errors import ExportError, InputError
from geometry.workshop import moulds
from geometry.workshop.mould_sizes import (
    MouldSizes,
    choose_draft,
    compute_block_volume,
    compute_cavity_volume,
    compute_mould_sizes,
)
from tests.support.parts import make, read
from tests.support.workshop import EDGE, probe

OUTER = math.sqrt(5.1**2 + 25 / 3.7)


def lens(radius: float, a: float) -> float:
    """Area of a disc's strip |y| < a on the side x > 0."""
    return quad(lambda y: math.sqrt(radius**2 - y**2), -a, a)[0]


def cavity(mould: MouldSizes) -> float:
    """Volume of the cavity, slice by slice."""
    lean = math.tan(mould.draft)

    def ring(z: float) -> float:
        foot = max(z, mould.edge)
        cut = mould.edge - math.sqrt(max(mould.edge**2 - (mould.edge - min(z, mould.edge)) ** 2, 0.0))
        middle = mould.height / 2
        outer = sum(mould.outer) / 2 + (foot - middle) * lean - cut
        inner = sum(mould.inner) / 2 - (foot - middle) * lean + cut if mould.inner[0] else 0.0
        rib = lens(outer, mould.half_width) - lens(inner, mould.half_width) if z > mould.height - mould.depth else 0.0
        return math.pi * (outer**2 - inner**2) - rib

    stops = sorted({0.0, mould.edge, mould.height - mould.depth, mould.height})
    return sum(quad(ring, low, high, epsabs=0, epsrel=1e-9)[0] for low, high in pairwise(stops))


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("edge", [0.0, EDGE])
def test_volume_of_the_cavity(index: int, edge: float) -> None:
    mould = compute_mould_sizes(probe(), edge, shrinkage=0.02, draft=math.radians(1))[index]
    assert compute_cavity_volume(mould) == pytest.approx(cavity(mould), rel=1e-7)
    # draft aside the block that comes out is the scene's: each length has shrunk by 2 %
    straight = compute_mould_sizes(probe(), edge, shrinkage=0.02, draft=0.0)[index]
    block = compute_block_volume(probe(), mould.name, edge)
    assert compute_cavity_volume(straight) * 0.98**3 == pytest.approx(block, rel=1e-9)
    assert compute_cavity_volume(mould) * 0.98**3 == pytest.approx(block, rel=2e-3)


def test_files(package: Path) -> None:
    names = {path.name for path in package.glob("mould*")}
    assert names == {f"mould-{block}-{half}.step" for block in ("inner", "outer") for half in ("lower", "upper")}
    mould, _ = compute_mould_sizes(probe(), EDGE)
    lower, upper = (read(package / f"mould-inner-{half}.step") for half in ("lower", "upper"))
    assert (lower.ShapeType(), lower.isValid(), upper.isValid()) == ("Solid", True, True)
    body = math.pi * mould.outside**2 * (mould.height + 4) + math.pi * (1.5**2 + 1.0**2) * 3
    assert body - lower.Volume() == pytest.approx(cavity(mould), rel=1e-6)
    assert lower.intersect(upper).Volume() == pytest.approx(0, abs=1e-6)  # pins in their holes
    box = lower.BoundingBox(1e-6)
    assert (box.zmin, box.zmax) == pytest.approx((-4, mould.height + 3), abs=1e-5)


def test_the_lid_has_a_rib_a_pour_hole_and_vents(package: Path) -> None:
    _, mould = compute_mould_sizes(probe(), EDGE)
    lid = read(package / "mould-outer-upper.step")
    (solid,) = lid.Solids()
    from geometry.cad.solids import load_cadquery

    cq, middle = load_cadquery(), (5.1 + OUTER) / 2
    assert solid.isInside(cq.Vector(middle, 0, mould.height - 0.5))  # the rib hangs where the groove is
    assert not solid.isInside(cq.Vector(-middle, 0, mould.height + 3))  # and is poured on the other side
    holes = [face for face in solid.Faces() if face.geomType() == "CYLINDER" and face.BoundingBox().zmax > mould.height + 5.9]
    assert len(holes) == 4  # rim, pour hole, two vents


def test_the_gap_keeps_its_width() -> None:
    """Two walls that lean by less than a twentieth of the gap; where they may, by what is asked for."""
    probe = make()
    assert 5.0 * math.tan(choose_draft(probe)) == pytest.approx(0.05 * 0.1)
    assert choose_draft(make(gap=2e-3, height=1e-3, groove=None)) == pytest.approx(math.radians(0.5))


def test_a_mould_that_is_off_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mould, _ = compute_mould_sizes(probe())
    built = moulds.build_lower
    monkeypatch.setattr(moulds, "build_lower", lambda mould_size: built(mould_size).scale(1 + 1e-5))
    with pytest.raises(ExportError, match=r"^mould-inner-lower\.step: volume = "):
        moulds.write_half(mould, "lower", build_stamp(probe()), tmp_path / "mould-inner-lower.step")


@pytest.mark.parametrize(
    ("options", "key"), [({"shrinkage": 0.3}, "shrinkage"), ({"draft": 1.0}, "draft"), ({"shrinkage": math.nan}, "shrinkage")]
)
def test_impossible_castings_are_refused(options: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=rf"^{key} = ") as fault:
        compute_mould_sizes(probe(), **options)
    assert fault.value.exit_code == 2


@pytest.mark.slow
@pytest.mark.parametrize("radius", [1e-4, 5e-2])
@pytest.mark.parametrize(("slenderness", "ratio"), [(0.05, 0.1), (20, 20)])
@pytest.mark.parametrize("share", [0.1, 1.99])
def test_extremes(tmp_path: Path, radius: float, slenderness: float, ratio: float, share: float) -> None:
    gap, height = 0.05 * radius, slenderness * radius
    probe = make(radius, ratio, gap, height, groove=(share * (radius + gap), 0.6 * height))
    for mould in compute_mould_sizes(probe):
        for half in moulds.MOULD_HALVES:
            moulds.write_half(mould, half, build_stamp(probe), tmp_path / moulds.format_file_name(mould, half))
        assert compute_cavity_volume(mould) == pytest.approx(cavity(mould), rel=1e-6)

"""The fixture: what touches which block, what centres on what, and files that a plain reader finds as they should be."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from geometry.cad import fixture, solids
from geometry.common.errors import InputError
from geometry.scenes.base_sizes import find_base_sizes
from geometry.scenes.probe import Base
from tests.support.parts import FLANGE, make, read


@pytest.mark.parametrize("changes", [{}, {"base": FLANGE}])
def test_files_hold_closed_solids_of_the_volumes_written_out_here(tmp_path: Path, changes: dict[str, Any]) -> None:
    probe = make(**changes)
    sizes, rim = fixture.find_fixture_sizes(probe), 1e3 * find_base_sizes(probe).flange_radius
    carrier = math.pi * (rim**2 * sizes.sleeve + (rim + fixture.SLEEVE_WALL_MM) ** 2 * fixture.FOOT_HEIGHT_MM)
    inner, outer = sizes.ring
    expected = {
        "pin": carrier + math.pi * sizes.pin**2 * fixture.CARRIER_RISE_MM,
        "ring": carrier + math.pi * (outer**2 - inner**2) * fixture.CARRIER_RISE_MM,
    }
    for name, write in fixture.build_writers(probe).items():
        write(tmp_path / name)
        text = (tmp_path / name).read_text()
        assert "SI_UNIT(.MILLI.,.METRE.)" in text
        shape = solids.load_cadquery().importers.importStep(str(tmp_path / name)).val()
        if (part := name.removesuffix(".step")) in expected:
            assert shape.Volume() == pytest.approx(expected[part], rel=1e-9)


@pytest.mark.parametrize("changes", [{}, {"base": FLANGE}])
def test_pin_and_ring_touch_one_block_alone_though_misaligned(changes: dict[str, Any]) -> None:
    """Both, displaced by 0.05 mm, stay on their block; the sleeve grips carrier and rim, and parked it stays below the blocks."""
    probe = make(**changes)
    solid, scale = fixture.find_fixture_sizes(probe), 1e3
    assert solid.pin + fixture.RING_ALIGNMENT_MM < scale * probe.inner_radius
    assert solid.ring[0] - fixture.RING_ALIGNMENT_MM > scale * probe.hole_radius
    assert solid.ring[1] + fixture.RING_ALIGNMENT_MM < scale * probe.tube_radius
    assert 2 * (solid.bore - solid.carrier) + 2 * 0.01 <= fixture.RING_ALIGNMENT_MM + 1e-12
    sleeve, ring = (fixture.build_fixture(probe)[name].BoundingBox() for name in ("sleeve", "ring"))
    parts = solids.build_parts(probe)
    rim = parts["base"].BoundingBox().zmax - scale * find_base_sizes(probe).thickness
    assert sleeve.zmax == pytest.approx(rim + fixture.SLEEVE_GRIP_MM)
    assert sleeve.zmin == pytest.approx(-fixture.CARRIER_RISE_MM - fixture.SLEEVE_GRIP_MM)
    assert ring.zmax == pytest.approx(0.0)
    assert parts["base"].BoundingBox().xmax == pytest.approx(solid.carrier)
    parked = ring.zmin + fixture.FOOT_HEIGHT_MM + solid.sleeve  # where its upper end is when it stands on the foot
    assert parked <= -fixture.CARRIER_RISE_MM + 1e-9


def test_the_sleeve_is_clear_of_the_base_and_lets_the_leads_out() -> None:
    probe = make()
    sleeve, base = fixture.build_fixture(probe)["sleeve"], solids.build_parts(probe)["base"]
    assert sum(sizes.Volume() for sizes in sleeve.intersect(base).Solids()) == pytest.approx(0.0, abs=1e-9)
    cq, sizes = solids.load_cadquery(), fixture.find_fixture_sizes(probe)
    lead = cq.Solid.makeBox(2 * sizes.bore + 10, 1.0, 1.0, cq.Vector(0.0, -0.5, 1.0))  # 1 mm wide, along the groove
    assert sum(piece.Volume() for piece in sleeve.intersect(lead).Solids()) == pytest.approx(0.0, abs=1e-9)


def test_blocks_too_narrow_for_it_are_refused() -> None:
    with pytest.raises(InputError, match="wall"):
        fixture.find_fixture_sizes(make(outer_radius=5.35e-3))
    with pytest.raises(InputError, match="pin"):
        fixture.find_fixture_sizes(make(inner_radius=0.15e-3, groove=None))


def test_a_pin_of_any_length_is_measured_against_its_length(tmp_path: Path) -> None:
    """Its upper face lies at z = 0, which no size can be compared with."""
    base = Base(youngs_modulus=2e9, poisson_ratio=0.35)
    probe = make(4e-3, 1.2, groove=(1.5e-3, 1e-3), inner_height=3.4e-3, outer_height=3e-3, base=base)
    for name, write in fixture.build_writers(probe).items():
        write(tmp_path / name)
    assert read(tmp_path / "pin.step").isValid()

"""Charges of single blocks under punches and pressures: against independent codes, limits and finite differences."""

from __future__ import annotations

import pytest

from geometry.common.errors import InputError
from geometry.common.json_types import JsonObject
from geometry.scenes.film import Film
from geometry.scenes.probe import Material
from solver.axisymmetric.pressed_block import PressedBlock, press_block
from tests.support.film_scenes import build_stack, read_cases

SINGLE_BLOCKS = [name for name, case in read_cases().items() if not case["tissue"]]
# twice their own uncertainty: for one disc, glued rigidly, meshes ever finer here and there part by 1.5 times as much
REFERENCE_FACTOR = 2.0
SOFT, RUBBER = Material(youngs_modulus=1e6, poisson_ratio=0.48), Material(youngs_modulus=1e6, poisson_ratio=0.0)
TAPE = {"thickness": 5e-5, "youngs_modulus": 4e5, "poisson_ratio": 0.49}


def build_block(case: JsonObject) -> PressedBlock:
    """The block of a reference case: lengths in mm, moduli in MPa there."""
    (block,) = case["blocks"]
    return PressedBlock(
        1e-3 * block["inside"],
        1e-3 * block["outside"],
        1e-3 * block["height"],
        Material(youngs_modulus=1e6 * block["modulus"], poisson_ratio=block["nu"]),
        Film.model_validate(build_stack(case["stack"])),
        {"punch": "frictionless"}.get(case["load"], case["load"]),
        tuple(1e-3 * radius for radius in case["pressed"]) or None,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("name", SINGLE_BLOCKS)
def test_against_independent_codes(name: str) -> None:
    case = read_cases()[name]
    result = press_block(build_block(case))
    deviation = abs(result.charge_per_force / (1e-12 * case["charge_per_force"][0]) - 1)
    assert deviation <= 1e-3 + case["relative_uncertainty"]
    assert deviation <= result.charge_error + REFERENCE_FACTOR * case["relative_uncertainty"]
    assert result.charge_error < 1e-3


@pytest.mark.parametrize("load", ["frictionless", "stuck", "pressure"])
def test_bars_in_series(load: str) -> None:
    """Without lateral contraction block, film and tape are springs in series, and the film's charge per force is d33."""
    tape = {"thickness": 1e-4, "youngs_modulus": 2e6, "poisson_ratio": 0.0}
    film = Film.model_validate({"youngs_modulus": 3e6, "poisson_ratio": 0.0, "bond_to_base": tape})
    area = 3.141592653589793 * (4e-3**2 - 1e-3**2)
    result = press_block(PressedBlock(1e-3, 4e-3, 3e-3, RUBBER, film, load))  # type: ignore[arg-type]
    assert result.charge_per_force == pytest.approx(film.d33, rel=1e-9)
    assert result.stiffness == pytest.approx(area / (3e-3 / 1e6 + 110e-6 / 3e6 + 1e-4 / 2e6), rel=1e-9)
    assert result.bond_derivative == pytest.approx(0, abs=1e-9)


def test_a_punch_on_an_incompressible_half_space() -> None:
    """A narrow pin on a large block: stiffness 2 E a / (1 - nu^2), and more by the block's finite size."""
    pin = 1e-4
    block = PressedBlock(0.0, 1e-2, 1e-2, SOFT, Film(), "frictionless", (0.0, pin))
    assert press_block(block).stiffness == pytest.approx(2 * 1e6 * pin / (1 - 0.48**2), rel=0.012)


@pytest.mark.parametrize("load", ["frictionless", "stuck", "pressure"])
def test_derivative_by_the_bonds_modulus(load: str) -> None:
    def compute_charge(factor: float) -> float:
        """The charge per force with both tapes' modulus times a factor."""
        tape = TAPE | {"youngs_modulus": factor * TAPE["youngs_modulus"]}
        film = Film.model_validate({"bond_to_base": tape, "bond_to_block": tape})
        return press_block(PressedBlock(0.0, 4e-3, 3e-3, SOFT, film, load)).charge_per_force  # type: ignore[arg-type]

    film = Film.model_validate({"bond_to_base": TAPE, "bond_to_block": TAPE})
    exact = press_block(PressedBlock(0.0, 4e-3, 3e-3, SOFT, film, load)).bond_derivative  # type: ignore[arg-type]
    difference = (compute_charge(1.02) - compute_charge(1 / 1.02)) / (2 * 0.0198026 * compute_charge(1.0))
    assert exact == pytest.approx(difference, rel=2e-3)


def test_charges_scale_with_lengths_and_moduli() -> None:
    """No length or modulus but their ratios matters."""
    film = Film.model_validate({"bond_to_base": TAPE, "electrode_inset": 2e-4})
    large_tape = TAPE | {"thickness": 5e-4, "youngs_modulus": 4e6}
    large_film = Film.model_validate(
        {"thickness": 1.1e-3, "youngs_modulus": 2.5e10, "bond_to_base": large_tape, "electrode_inset": 2e-3}
    )
    small = press_block(PressedBlock(4e-3, 6e-3, 3e-3, SOFT, film, "stuck", (4.5e-3, 5.5e-3)))
    hard = Material(youngs_modulus=1e7, poisson_ratio=0.48)
    large = press_block(PressedBlock(4e-2, 6e-2, 3e-2, hard, large_film, "stuck", (4.5e-2, 5.5e-2)))
    assert large.charge_per_force == pytest.approx(small.charge_per_force, rel=1e-7)
    assert large.stiffness == pytest.approx(100 * small.stiffness, rel=1e-7)


def test_refusals() -> None:
    with pytest.raises(InputError, match="psi1"):
        press_block(PressedBlock(0.0, 4e-3, 3e-3, SOFT, Film(psi1=0.0)))
    with pytest.raises(InputError, match="pressed"):
        press_block(PressedBlock(4e-3, 6e-3, 3e-3, SOFT, Film(), pressed=(0.0, 3e-3)))

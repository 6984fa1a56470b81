"""Each default is stated once: what the built-in files write out for a reader is what is assumed where a file leaves it out."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel

from geometry.scenes.film import Film
from probe_design.built_probe.bench import Amplifier, Channels, ReferenceForce, Sampling, Shaker, Workshop, read_builtin_bench
from probe_design.data.builtin import read_builtin_scene
from probe_design.data.noise import DEFAULT_CHARGE_NOISE_C, DEFAULT_NOISE, find_charge_per_force
from probe_design.design_search.tumour_objective import Noise
from probe_design.populations.design_file import read_builtin_design
from probe_design.populations.tables import NoiseModel, Protocol

BENCH, DESIGN, SCENE = read_builtin_bench(), read_builtin_design(), read_builtin_scene()


def stated(part: BaseModel, *but: str) -> dict[str, Any]:
    """Return the values of a table but those of some keys."""
    return part.model_dump(exclude=set(but))


@pytest.mark.parametrize(
    ("written", "assumed"),
    [
        (BENCH.load, Shaker()),
        (BENCH.amplifier, Amplifier()),
        (BENCH.sampling, Sampling()),
        (BENCH.channels, Channels()),
        (BENCH.workshop, Workshop()),
        (DESIGN.noise, NoiseModel()),
        (SCENE.probe.film, Film()),
        (DESIGN.scene.probe.film, Film()),
    ],
)
def test_built_in_files_write_out_the_defaults(written: BaseModel, assumed: BaseModel) -> None:
    # what holds a film is unknown where it is left out
    unknown = ("bond_to_base", "bond_to_block", "psi1", "psi2") if isinstance(written, Film) else ()
    assert stated(written, *unknown) == stated(assumed, *unknown)


def test_the_built_in_probe_has_tape_on_both_sides_of_its_films() -> None:
    for film in (SCENE.probe.film, DESIGN.scene.probe.film):
        assert film is not None
        assert not film.uses_psi
        assert [bond and bond.name for bond in (film.bond_to_base, film.bond_to_block)] == ["tape-50um", "tape-50um"]


def test_built_in_protocol_and_force_sensor() -> None:
    assert BENCH.force is not None
    assert stated(BENCH.force) == stated(ReferenceForce(sensitivity=BENCH.force.sensitivity))
    assert stated(DESIGN.protocol, "positions") == stated(Protocol(positions=DESIGN.protocol.positions), "positions")


def test_both_searches_assume_the_same_noise() -> None:
    noise = Noise()
    assert (noise.ratio, noise.charge) == (DEFAULT_NOISE, DEFAULT_CHARGE_NOISE_C)
    assert (NoiseModel().gain, NoiseModel().charge) == (DEFAULT_NOISE, DEFAULT_CHARGE_NOISE_C)
    bare = SCENE.probe.model_copy(update={"film": None})
    powerless = SCENE.probe.model_copy(update={"film": Film(d33=0.0)})
    assert noise.charge_per_force == find_charge_per_force(bare) == find_charge_per_force(powerless) == 20e-12  # the paper's

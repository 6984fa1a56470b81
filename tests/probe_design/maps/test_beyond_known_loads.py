"""Maps at loads of which nothing is known, and what is reported of tumours that stay open."""

from __future__ import annotations

import re

import numpy as np
import pytest

from geometry import Refusal, read_scene
from geometry.scenes.scene_tables import Load
from probe_design.maps import detectability as module
from probe_design.maps.detectability import detectability
from solver import plan
from tests.support.paths import EXAMPLES

SCENE = read_scene(EXAMPLES / "scene.toml")
DEPTHS, DIAMETERS = np.array([9e-3]), np.array([8e-3])


def detect_under(force: float) -> object:
    scene = SCENE.model_copy(update={"load": Load(force=force)})
    return detectability(scene, DEPTHS, DIAMETERS, linear=True)


def test_nothing_is_computed_where_nothing_can_be_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence names the load up to which something is known, and a map under that load is computed."""
    with monkeypatch.context() as patch:
        patch.setattr(module, "compute_readings", lambda *_, **__: pytest.fail("spheres were computed"))
        with pytest.raises(Refusal, match=r"= 0\.3 N: allowed: up to .* N; larger loads have unknown effects") as refused:
            detect_under(0.3)
    named = re.search(r"up to ([\d.]+) N", str(refused.value))
    assert named is not None
    gap = plan(SCENE).load_limits.gap_closure
    assert gap is not None
    assert float(named[1]) == pytest.approx(gap.force, rel=0.01)
    detect_under(float(named[1]))


def test_what_is_said_speaks_of_tumours() -> None:
    scene = SCENE.model_copy(update={"load": Load(force=1e-4)})
    mapped = detectability(scene, np.array([25e-3]), np.array([1e-3, 2e-3]))
    assert mapped.warnings
    assert all("tumours" in note for note in mapped.warnings if "2" in note)
    assert not any(word in note for note in mapped.warnings for word in ("above_error", "null", "false"))

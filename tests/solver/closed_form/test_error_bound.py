"""The weights of the stated errors: data with an origin, of features that there are."""

from __future__ import annotations

import json
import math

import numpy as np

from geometry import read_scene
from solver.closed_form.error_bound import QUANTITIES, weights
from solver.closed_form.error_features import features
from tests.support.named import runs
from tests.support.paths import ROOT, SCENE


def test_weights_are_of_features_that_there_are() -> None:
    found = features(read_scene(SCENE), np.ones((4, 2, 2)), np.ones((4, 2, 2)), sided=True)
    assert tuple(weights()) == QUANTITIES
    for kind, part in zip(QUANTITIES, found, strict=True):
        assert weights()[kind].keys() <= part.keys()
        assert all(0 < weight < math.inf for weight in weights()[kind].values())


def test_weights_tell_where_they_come_from() -> None:
    origin = json.loads((ROOT / "solver" / "closed_form" / "error_weights.json").read_text(encoding="utf-8"))["origin"]
    assert runs(origin["script"].split()[2])
    assert origin["margin"] > 1
    assert {"date", "scenes", "seeds", "references"} <= origin.keys()

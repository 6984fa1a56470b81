"""Name the tests and stresses of measured curves and the laws to fit, for help texts that need no arrays."""

from __future__ import annotations

from typing import Literal

Test = Literal["tension", "compression", "uniaxial", "equibiaxial", "shear", "bonded-compression"]
StressKind = Literal["nominal", "true"]
LawChoice = Literal["auto", "neo-hookean", "yeoh"]

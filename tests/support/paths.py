"""Where things lie in the repository."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
EXAMPLES = ROOT / "examples"
REFERENCE = ROOT / "tests" / "reference"
MESHES = ROOT / "tests" / "meshes"
SCENE = EXAMPLES / "scene.toml"

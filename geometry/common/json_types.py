"""Types of JSON objects and TOML tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

JsonObject = dict[str, Any]
"""A JSON object or a TOML table: values by key, nested to any depth."""
JsonMapping = Mapping[str, Any]
"""The same, read only."""

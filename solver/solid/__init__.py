"""Level 5: tetrahedra, the difference between a scene and its symmetric reference."""

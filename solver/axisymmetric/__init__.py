"""Level 3, and the finite elements of the meridian plane that level 2 stands on."""

"""Level 3, and the systems of the meridian plane that level 2 stands on."""

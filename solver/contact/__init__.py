"""Level 4: finite strain and contact in the meridian plane: loads that a hand makes, gaps that close."""

"""CadQuery solids, STEP files out and back, drawings."""

"""CadQuery solids, STEP files written and read back, drawings."""

"""CadQuery solids, STEP files written and read back, drawings."""

# Imports inside functions: cadquery, its OCP and vtkmodules load only where solids are built, read or written.

"""The meridian section and its quadrilateral mesh, smooth in the design."""

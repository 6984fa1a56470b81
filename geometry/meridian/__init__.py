"""The meridian section and its quadrilateral mesh, whose nodes are smooth functions of the design."""

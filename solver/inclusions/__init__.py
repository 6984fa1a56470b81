"""Elasticity of one sphere or ellipsoid in an unbounded body; arrays of tumours. Knows no mesh and no probe."""

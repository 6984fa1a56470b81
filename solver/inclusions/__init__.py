"""Elasticity of one sphere or ellipsoid in an unbounded body, and arrays of tumours; independent of meshes and probes."""

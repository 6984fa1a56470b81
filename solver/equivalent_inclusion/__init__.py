"""Level 2: many tumours under one solved probe; first order, bounds, ellipsoids, readings, gradients."""

"""The scene: models, units, TOML, refusals, the check that bodies fit, numbers by name."""

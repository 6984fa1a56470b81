"""The scene: models, units, TOML, refusals, whether bodies fit, numbers by name."""

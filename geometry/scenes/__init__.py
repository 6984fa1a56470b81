"""The scene: models, units, TOML, refusals, the check that bodies fit, numbers by name."""

# Imports inside functions: few scenes need numpy and scipy (thinned rubber), pint (rare units), tomli_w (writing)
# or matplotlib (plots).

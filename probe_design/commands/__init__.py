"""The commands: each is one frozen request, from which its options, its Python keywords, their checks and help follow."""

# Imports inside functions: --help needs click and the models of scenes; numpy, importlib.metadata and ours load in a run.

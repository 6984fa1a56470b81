"""The explorer: a local page on which a designer sees what each dimension does; needs the extra ``explore``."""

# Imports inside functions: NiceGUI is an extra, and CAD is loaded by the worker that needs it alone.

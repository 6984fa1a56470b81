"""The explorer: a local page on which a designer sees what each dimension does; needs the extra ``explore``."""

# Imports inside functions: uvicorn loads while browsers wait at the address, and CAD in the worker that needs it alone.

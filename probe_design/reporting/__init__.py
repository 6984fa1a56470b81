"""Tables, figures and pages: what results look like on a terminal, in a report, a picture or a file."""

# Imports inside functions: jinja2 loads only where a page is written.

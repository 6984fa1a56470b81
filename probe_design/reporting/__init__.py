"""Tables, figures and pages: what results look like on a terminal, in a report, a picture or a file."""

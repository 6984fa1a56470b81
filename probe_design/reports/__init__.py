"""The report: one self-contained HTML file, for every verb that writes one."""

"""Reports: one self-contained HTML file, for every command that writes one."""

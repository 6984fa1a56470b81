"""``python -m probe_design``."""

from probe_design.cli import main

main()

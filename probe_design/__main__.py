"""``python -m probe_design``."""

from probe_design.cli.main import main

main()

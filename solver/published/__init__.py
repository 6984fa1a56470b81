"""Level 0: the paper's equations as printed, mended, and its Table 3."""

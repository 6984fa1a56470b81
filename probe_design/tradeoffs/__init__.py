"""``tradeoff``: every level timed and judged on scenes."""

"""``optimize DESIGN``: variables, materials, limits, search, judgement on unseen tumours, what it leaves behind."""

"""Level contact beside other codes, and references by one of them."""

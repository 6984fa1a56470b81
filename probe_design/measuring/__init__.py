"""A session at the bench: the page to print, samples as they come, the prediction beside them."""

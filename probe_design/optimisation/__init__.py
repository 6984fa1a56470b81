"""``optimize``: objective, design space, global search, polish, report."""

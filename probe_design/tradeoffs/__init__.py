"""Command ``tradeoff``: time every evaluator on scenes and compare its errors with a reference."""

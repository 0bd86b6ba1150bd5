"""Checks against the paper, other tools and measured speed."""

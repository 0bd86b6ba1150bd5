"""Sizing: the sizes, ratios and thresholds with which a goal is least while every limit holds."""

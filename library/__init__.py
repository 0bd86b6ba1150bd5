"""The library: components in groups, one physical component a file, and their data."""

"""Blocks: one physical component a file, with ports, parameters, tables and component data."""

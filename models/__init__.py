"""Powertrains: parts and connections, assembled into a step and into a forward-facing model."""

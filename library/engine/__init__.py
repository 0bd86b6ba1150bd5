"""The combustion engine and what it drives."""

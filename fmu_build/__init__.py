"""Functional mock-up units: a model as C, and the C as an FMU."""

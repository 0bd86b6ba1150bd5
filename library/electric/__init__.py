"""Machines, stores and loads on the electric bus."""

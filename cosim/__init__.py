"""Runs: cycles, results, test procedures, studies and the command line."""

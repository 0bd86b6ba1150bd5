"""Runs: cycles, results, accounts, pictures, and FMUs of whole vehicles."""

"""Studies of vehicles: batches of runs, tests, sweeps and sizing."""

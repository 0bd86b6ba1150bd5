"""A propeller shaft, and the electric car with one."""

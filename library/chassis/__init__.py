"""Body, wheels and brakes."""

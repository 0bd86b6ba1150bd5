"""Calibration: numbers of a vehicle from measured series, and road load from a coast-down or from published coefficients."""

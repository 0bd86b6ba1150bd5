"""Controls: which gear, when the engine runs, who gives the torque."""

"""What turns between engine or motor and the wheels."""

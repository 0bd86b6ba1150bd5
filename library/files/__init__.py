"""Files of components: what a user writes, read with one error for all that is wrong, and written back."""

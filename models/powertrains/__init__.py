"""The powertrains, one in a file; what stands here is found, and need not be listed anywhere."""

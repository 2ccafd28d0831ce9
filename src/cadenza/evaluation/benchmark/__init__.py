"""The benchmark: its frozen tasks, verifiable entries, and the table of entries."""

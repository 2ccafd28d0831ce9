"""The benchmark: its frozen tasks, entries that anybody can verify, and the table of them."""

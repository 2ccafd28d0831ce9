"""Has an agent play a song, and writes the files of a performance or a plan."""

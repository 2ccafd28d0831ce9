"""Files of music: how they are read and written."""

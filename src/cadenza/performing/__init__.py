"""From a song and an agent to a performance or a plan, and the files that they leave."""

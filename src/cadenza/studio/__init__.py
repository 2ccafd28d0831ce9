"""A page on which songs are dropped and played live: the server, and the processes that play."""

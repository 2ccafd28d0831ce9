"""The Allegro Hand on a seven-joint arm, which stands beside the keyboard and does not slide."""

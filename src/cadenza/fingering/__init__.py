"""The search for fingers: which finger plays which note; and how hard a score is."""

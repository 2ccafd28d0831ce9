"""MusicXML, plain or compressed, as notation programs export it: from its tree to a score."""

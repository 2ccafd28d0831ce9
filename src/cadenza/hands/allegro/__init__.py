"""The Allegro Hand: four fingers of four joints each, larger than a human hand, without a wrist."""

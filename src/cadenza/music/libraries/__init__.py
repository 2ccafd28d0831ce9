"""Songs by name: the bundled pieces, imported libraries, folders of music."""

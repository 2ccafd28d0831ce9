"""Songs x agents x seeds: runs that are planned, carried out and read again."""

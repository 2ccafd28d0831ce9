"""Which finger plays which note, where a score does not say."""

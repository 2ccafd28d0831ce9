"""The Shadow Dexterous Hand: five fingers, of which four have their last joints coupled."""

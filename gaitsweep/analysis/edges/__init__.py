"""Edge states between basins of attraction."""

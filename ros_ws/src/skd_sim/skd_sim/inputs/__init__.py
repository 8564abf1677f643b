"""Reading what others wrote, and printing what it says of itself."""

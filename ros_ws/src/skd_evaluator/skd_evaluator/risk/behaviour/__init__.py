"""What people who were tracked tell of how they deviate from the way that they intend: fits, and whether they hold."""

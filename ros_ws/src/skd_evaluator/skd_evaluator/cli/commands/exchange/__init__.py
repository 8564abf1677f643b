"""Commands that give what SKD has to other tools, and take what they have."""

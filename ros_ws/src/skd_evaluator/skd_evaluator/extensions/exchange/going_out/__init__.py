"""What a result holds, in the formats of others."""

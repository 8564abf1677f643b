"""How people deviate from the way that they intend: models as data, and their fit to people who were tracked."""

"""Which episodes an assessment is made of, how they are run in process, and what comes of them."""

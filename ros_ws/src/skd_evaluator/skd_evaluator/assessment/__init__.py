"""Which episodes an assessment has, how they are run in process, and which figures follow from them."""

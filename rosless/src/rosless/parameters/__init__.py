"""Parameters: values and their types, YAML, a node's parameters, and the services that serve them."""

"""How likely the moving car hits a person who walks a safe trajectory as people do: behaviour models, and the risk."""

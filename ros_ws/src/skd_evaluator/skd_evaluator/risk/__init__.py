"""How likely the moving car hits somebody who walks a safe trajectory as people do: behaviour models, and the risk."""
